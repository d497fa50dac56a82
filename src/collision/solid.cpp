#include "solid.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace signorini {
namespace {

constexpr double kFaceCosine = 0.9;   // a face this near to a direction is tried as the exact normal
constexpr double kEdgeSine = 0.1;     // so is what is normal to an edge
constexpr double kSegmentSine = 0.3;  // an edge no steeper than this touches along its length
constexpr double kCornerSine = 1e-4;  // an edge this flat touches with all its length
constexpr int kRimPoints = 16;        // of the polygon inside a cylinder's cap; a multiple of 4

/// Unit vector across the axis nearest to `direction`.
Vector3 radial(const Vector3& direction) {
  const double length = std::hypot(direction[0], direction[1]);
  return length > 0.0 ? Vector3(direction[0] / length, direction[1] / length, 0.0) : Vector3(Vector3::UnitX());
}

int largest(const Vector3& v) {
  int index = 0;
  v.cwiseAbs().maxCoeff(&index);
  return index;
}

void box_face(const Vector3& half, int axis, double side, Feature& out) {
  const int i = (axis + 1) % 3, j = (axis + 2) % 3;
  static constexpr double kSide[4][2] = {{1, 1}, {-1, 1}, {-1, -1}, {1, -1}};
  for (const auto& corner : kSide) {
    Vector3 point;
    point[axis] = side * half[axis];
    point[i] = corner[0] * half[i];
    point[j] = corner[1] * half[j];
    out.add(point);
  }
  out.normal = side * Vector3::Unit(axis);
}

void box_feature(const Vector3& half, const Vector3& direction, double face_cosine, Feature& out) {
  const int axis = largest(direction);
  if (std::abs(direction[axis]) >= face_cosine) return box_face(half, axis, sign(direction[axis]), out);
  int along = 0;
  const double sine = direction.cwiseAbs().minCoeff(&along);
  Vector3 corner(sign(direction[0]) * half[0], sign(direction[1]) * half[1], sign(direction[2]) * half[2]);
  out.add(corner);
  if (sine > kSegmentSine) return;
  corner[along] = -corner[along];
  out.add(corner);
}

void cylinder_feature(double radius, double half, const Vector3& direction, double face_cosine, Feature& out) {
  const double end = sign(direction[2]) * half;
  if (std::abs(direction[2]) >= face_cosine) {
    static const auto kCircle = [] {
      std::array<std::array<double, 2>, kRimPoints> circle;
      const double step = 2.0 * 3.14159265358979323846 / kRimPoints;
      for (int k = 0; k < kRimPoints; ++k) circle[k] = {std::cos(k * step), std::sin(k * step)};
      return circle;
    }();
    for (const auto& [x, y] : kCircle) out.add({radius * x, radius * y, end});
    out.normal = sign(direction[2]) * Vector3::UnitZ();
    return;
  }
  const Vector3 side = radius * radial(direction);
  out.add(side + Vector3(0.0, 0.0, end));
  if (std::abs(direction[2]) <= kSegmentSine) out.add(side - Vector3(0.0, 0.0, end));
}

/// Calls visit(other end) for each edge at a vertex, each edge once.
template <typename Visit>
void for_each_edge(const Hull& hull, int vertex, const Visit& visit) {
  for (int c = hull.corner_begin[vertex]; c < hull.corner_begin[vertex + 1]; ++c)
    visit(hull.after(hull.corner_faces[c], hull.corner_places[c]));
}

void hull_feature(const Hull& hull, const Vector3& direction, int vertex, double face_cosine, Feature& out) {
  int flat_end = -1;
  double flat_sine = kSegmentSine;
  const Vector3& corner = hull.vertices[vertex];
  for_each_edge(hull, vertex, [&](int end) {
    const Vector3 edge = hull.vertices[end] - corner;
    const double sine = std::abs(edge.dot(direction)) / edge.norm();
    if (sine < flat_sine) flat_sine = sine, flat_end = end;
  });
  int best = -1;
  double best_cosine = face_cosine;
  // A face that has the whole of an edge that touches goes before one that merely looks the right way.
  for (const bool with_edge : {true, false}) {
    if (best >= 0 || (with_edge && !(flat_end >= 0 && flat_sine < kCornerSine))) continue;
    for (int c = hull.corner_begin[vertex]; c < hull.corner_begin[vertex + 1]; ++c) {
      const int face = hull.corner_faces[c], place = hull.corner_places[c];
      if (with_edge && hull.before(face, place) != flat_end && hull.after(face, place) != flat_end) continue;
      const double cosine = hull.face_normals[face].dot(direction);
      if (cosine >= best_cosine) best = face, best_cosine = cosine;
    }
  }
  if (best >= 0) {
    // A polygon inside the face where it has too many corners: what is found with it still lies on the face.
    const int size = hull.face_size(best), first = hull.face_begin[best];
    const int kept = std::min(size, Feature::kMost);
    for (int k = 0; k < kept; ++k) out.add(hull.vertices[hull.face_vertices[first + k * size / kept]]);
    out.normal = hull.face_normals[best];
    return;
  }
  out.add(corner);
  if (flat_end >= 0) out.add(hull.vertices[flat_end]);
}

}  // namespace

Solid::Solid(const Shape& shape, std::shared_ptr<const Hull> its_hull)
    : type(shape.type), size(shape.size), hull(std::move(its_hull)), height_grid(shape.height_grid) {
  switch (type) {
    case ShapeType::Sphere:
      rounding = size[0];
      half_extents.setConstant(size[0]);
      break;
    case ShapeType::Capsule:
      rounding = size[0];
      half_extents << size[0], size[0], size[0] + size[1];
      break;
    case ShapeType::Cylinder:
      half_extents << size[0], size[0], size[1];
      break;
    case ShapeType::Box:
    case ShapeType::Ellipsoid:
      half_extents = size;
      break;
    case ShapeType::HalfSpace:
      return;
    case ShapeType::Convex: {
      Vector3 lower = hull->vertices[0], upper = lower;
      for (const Vector3& v : hull->vertices) lower = lower.cwiseMin(v), upper = upper.cwiseMax(v);
      centre = 0.5 * (lower + upper);
      half_extents = 0.5 * (upper - lower);
      for (const Vector3& v : hull->vertices) radius = std::max(radius, (v - centre).norm());
      return;
    }
    case ShapeType::HeightField: {
      const auto& heights = height_grid->heights;
      const double top = *std::max_element(heights.begin(), heights.end());
      centre[2] = 0.5 * (top - height_grid->base);
      half_extents << height_grid->half_x, height_grid->half_y, 0.5 * (top + height_grid->base);
      radius = half_extents.norm();
      return;
    }
  }
  radius = shape.bounding_radius();
}

Vector3 Solid::support(const Vector3& direction, int& hint) const {
  switch (type) {
    case ShapeType::Sphere:
    case ShapeType::HalfSpace:
    case ShapeType::HeightField:
      break;
    case ShapeType::Box:
      return {sign(direction[0]) * size[0], sign(direction[1]) * size[1], sign(direction[2]) * size[2]};
    case ShapeType::Capsule:
      return {0.0, 0.0, sign(direction[2]) * size[1]};
    case ShapeType::Cylinder:
      return size[0] * radial(direction) + Vector3(0.0, 0.0, sign(direction[2]) * size[1]);
    case ShapeType::Ellipsoid: {
      const Vector3 scaled = size.cwiseProduct(direction);
      const double length = scaled.norm();
      return length > 0.0 ? Vector3(size.cwiseProduct(scaled) / length) : Vector3(0.0, 0.0, size[2]);
    }
    case ShapeType::Convex:
      return hull->vertices[hull->support(direction, hint)];
  }
  return Vector3::Zero();
}

Matrix3 Solid::curvature(const Vector3& direction) const {
  Matrix3 result = Matrix3::Zero();
  if (type == ShapeType::Ellipsoid) {
    const double height = size.cwiseProduct(direction).norm();
    const Vector3 point = size.cwiseAbs2().cwiseProduct(direction) / height;
    result = (Matrix3(size.cwiseAbs2().asDiagonal()) - point * point.transpose()) / height;
  } else if (type == ShapeType::Cylinder) {
    const double across = std::hypot(direction[0], direction[1]);
    if (across > 1e-9) {
      const Vector3 tangent(-direction[1] / across, direction[0] / across, 0.0);
      result = size[0] / across * tangent * tangent.transpose();
    }
  }
  return result;
}

bool Solid::face_normal(const Vector3& direction, int hint, Vector3& normal) const {
  if (type == ShapeType::Box) {
    const int axis = largest(direction);
    normal = sign(direction[axis]) * Vector3::Unit(axis);
  } else if (type == ShapeType::Cylinder) {
    normal = sign(direction[2]) * Vector3::UnitZ();
  } else if (type == ShapeType::Convex) {
    const int vertex = hull->support(direction, hint);
    double best = -1.0;
    for (int c = hull->corner_begin[vertex]; c < hull->corner_begin[vertex + 1]; ++c) {
      const Vector3& candidate = hull->face_normals[hull->corner_faces[c]];
      if (candidate.dot(direction) > best) best = candidate.dot(direction), normal = candidate;
    }
    if (best < 0.0) return false;
  } else {
    return false;
  }
  return normal.dot(direction) >= kFaceCosine;
}

int Solid::edges(const Vector3& direction, int hint, std::array<Vector3, 4>& out) const {
  int count = 0;
  if (type == ShapeType::Box) {
    for (int axis = 0; axis < 3; ++axis)
      if (std::abs(direction[axis]) < kEdgeSine) out[count++] = Vector3::Unit(axis);
  } else if (type == ShapeType::Capsule || type == ShapeType::Cylinder) {
    if (std::abs(direction[2]) < kEdgeSine) out[count++] = Vector3::UnitZ();
  } else if (type == ShapeType::Convex) {
    const int vertex = hull->support(direction, hint);
    std::array<double, 4> sines;
    for_each_edge(*hull, vertex, [&](int end) {
      const Vector3 edge = (hull->vertices[end] - hull->vertices[vertex]).normalized();
      const double sine = std::abs(edge.dot(direction));
      if (sine >= kEdgeSine) return;
      int place = std::min(count, 3);
      if (count == 4 && sine >= sines[3]) return;
      for (; place > 0 && sines[place - 1] > sine; --place)
        sines[place] = sines[place - 1], out[place] = out[place - 1];
      sines[place] = sine, out[place] = edge;
      count = std::min(count + 1, 4);
    });
  }
  return count;
}

void Solid::feature(const Vector3& direction, int hint, double face_cosine, Feature& out) const {
  out.count = 0;
  out.rounding = 0.0;
  switch (type) {
    case ShapeType::Box:
      return box_feature(size, direction, face_cosine, out);
    case ShapeType::Cylinder:
      return cylinder_feature(size[0], size[1], direction, face_cosine, out);
    case ShapeType::Capsule:
      if (std::abs(direction[2]) > kSegmentSine) break;
      out.add({0.0, 0.0, size[1]});
      out.add({0.0, 0.0, -size[1]});
      out.rounding = rounding;
      return;
    case ShapeType::Convex:
      return hull_feature(*hull, direction, hull->support(direction, hint), face_cosine, out);
    case ShapeType::Sphere:
    case ShapeType::Ellipsoid:
    case ShapeType::HalfSpace:
    case ShapeType::HeightField:
      break;
  }
  out.add(support(direction, hint) + rounding * direction);
}

}  // namespace signorini
