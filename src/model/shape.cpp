#include "signorini/model/shape.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "require.hpp"
#include "signorini/errors.hpp"

namespace signorini {
namespace {

Shape make(ShapeType type, const Vector3& size) {
  Shape shape;
  shape.type = type;
  shape.size = size;
  return shape;
}

constexpr double kLargest = 1e6;
constexpr int kMostSamples = 4096;  // a side of a height field

void validate_mesh(const ConvexMesh* mesh, const std::string& field) {
  if (!mesh) throw InvalidInput(field + ".mesh", "is missing");
  const std::size_t count = mesh->vertices.size();
  if (count < 4)
    throw InvalidInput(field + ".mesh", "has " + std::to_string(count) + " vertices, must have at least 4");
  for (std::size_t i = 0; i < count; ++i)
    for (int k = 0; k < 3; ++k)
      if (!(std::abs(mesh->vertices[i][k]) <= kLargest))
        throw InvalidInput(field + ".mesh.vertices[" + std::to_string(i) + "]",
                           "is " + in_full(mesh->vertices[i][k]) + ", must be within +-1e6 m");
  for (std::size_t i = 0; i < mesh->triangles.size(); ++i)
    for (const int k : mesh->triangles[i])
      if (k < 0 || static_cast<std::size_t>(k) >= count)
        throw InvalidInput(field + ".mesh.triangles[" + std::to_string(i) + "]",
                           "is " + std::to_string(k) + ", must be in [0, " + std::to_string(count - 1) + "]");
  Vector3 mean = Vector3::Zero();
  for (const Vector3& v : mesh->vertices) mean += v / static_cast<double>(count);
  Matrix3 spread = Matrix3::Zero();
  for (const Vector3& v : mesh->vertices) spread += (v - mean) * (v - mean).transpose();
  const double size = spread.trace();
  if (!(spread.determinant() > 1e-18 * size * size * size))
    throw InvalidInput(field + ".mesh", "has all its vertices in one plane (or nearly), must have a volume");
}

void validate_grid(const HeightGrid* grid, const std::string& field) {
  if (!grid) throw InvalidInput(field + ".height_grid", "is missing");
  for (const auto& [name, count] : {std::make_pair(".rows", grid->rows), std::make_pair(".columns", grid->columns)})
    if (count < 2 || count > kMostSamples)
      throw InvalidInput(field + name, "is " + std::to_string(count) + ", must be in [2, 4096]");
  for (const auto& [name, length] : {std::make_pair(".half_x", grid->half_x), std::make_pair(".half_y", grid->half_y),
                                     std::make_pair(".base", grid->base)})
    if (!(length > 0.0 && length <= kLargest))
      throw InvalidInput(field + name, "is " + in_full(length) + ", must be in (0, 1e6] m");
  const std::size_t count = static_cast<std::size_t>(grid->rows) * static_cast<std::size_t>(grid->columns);
  if (grid->heights.size() != count)
    throw InvalidInput(field + ".heights", "are " + std::to_string(grid->heights.size()) +
                                               ", must be rows x columns = " + std::to_string(count));
  for (std::size_t i = 0; i < count; ++i)
    if (!(std::abs(grid->heights[i]) <= kLargest && grid->heights[i] > -grid->base))
      throw InvalidInput(field + ".heights[" + std::to_string(i) + "]",
                         "is " + in_full(grid->heights[i]) + ", must be within +-1e6 m and above -base");
}

}  // namespace

Shape Shape::sphere(double radius) { return make(ShapeType::Sphere, {radius, 0.0, 0.0}); }
Shape Shape::box(const Vector3& half_extents) { return make(ShapeType::Box, half_extents); }
Shape Shape::capsule(double radius, double half_length) { return make(ShapeType::Capsule, {radius, half_length, 0.0}); }
Shape Shape::cylinder(double radius, double half_length) {
  return make(ShapeType::Cylinder, {radius, half_length, 0.0});
}
Shape Shape::ellipsoid(const Vector3& radii) { return make(ShapeType::Ellipsoid, radii); }
Shape Shape::half_space() { return make(ShapeType::HalfSpace, Vector3::Zero()); }
Shape Shape::convex(ConvexMesh mesh) {
  Shape shape = make(ShapeType::Convex, Vector3::Zero());
  shape.mesh = std::make_shared<const ConvexMesh>(std::move(mesh));
  return shape;
}
Shape Shape::height_field(HeightGrid grid) {
  Shape shape = make(ShapeType::HeightField, Vector3::Zero());
  shape.height_grid = std::make_shared<const HeightGrid>(std::move(grid));
  return shape;
}

double Shape::bounding_radius() const {
  switch (type) {
    case ShapeType::Sphere:
      return size[0];
    case ShapeType::Box:
      return size.norm();
    case ShapeType::Capsule:
      return size[0] + size[1];
    case ShapeType::Cylinder:
      return std::hypot(size[0], size[1]);
    case ShapeType::Ellipsoid:
      return size.maxCoeff();
    case ShapeType::HalfSpace:
      break;
    case ShapeType::Convex: {
      double radius = 0.0;
      for (const Vector3& v : mesh->vertices) radius = std::max(radius, v.norm());
      return radius;
    }
    case ShapeType::HeightField: {
      double tallest = height_grid->base;
      for (const double z : height_grid->heights) tallest = std::max(tallest, z);
      return Vector3(height_grid->half_x, height_grid->half_y, tallest).norm();
    }
  }
  return std::numeric_limits<double>::infinity();
}

void Shape::validate(const char* field) const {
  static constexpr int kSizes[] = {1, 3, 2, 2, 3, 0, 0, 0};
  for (int k = 0; k < kSizes[static_cast<int>(type)]; ++k)
    if (!(size[k] > 0.0 && size[k] <= kLargest))
      throw InvalidInput(std::string(field) + ".size[" + std::to_string(k) + "]",
                         "is " + in_full(size[k]) + ", must be in (0, 1e6] m");
  if (type == ShapeType::Convex) validate_mesh(mesh.get(), field);
  if (type == ShapeType::HeightField) validate_grid(height_grid.get(), field);
}

}  // namespace signorini
