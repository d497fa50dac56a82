#include "closed_forms.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace signorini {
namespace {

// Tilt of a cylinder on a plane [rad] above which its lowest point takes part: below, four fixed points of the rim are
// as low to rounding, and they stay put.
constexpr double kStandingTilt = 1e-5;
// A hull on a plane: vertices this much above the lowest one touch too, relative to its size; so many are looked at.
constexpr double kBottom = 0.01;
constexpr int kBottomVertices = 48;
constexpr double kAsDeep = 1e-6;
// Capsules at less than this angle touch along their length: the points farther apart than the margin fall away, and
// those within it keep spinning capsules from turning into each other.
constexpr double kParallelSine = 0.3;

Vector3 any_normal_to(const Vector3& axis) {
  Vector3 first, second;
  complete_frame(axis, first, second);
  return first;
}

/// A plane through `origin`, solid below; points of b that touch it.
struct Plane {
  Vector3 normal, origin;
  double margin;
  Manifold& out;

  double height(const Vector3& point) const { return normal.dot(point - origin); }
  SurfacePair above(const Vector3& point, double gap) const { return {point - gap * normal, point, normal, gap}; }
  void touch(const Vector3& point) const {
    const double gap = height(point);
    if (gap <= margin && out.count < Manifold::kMost) out.add(above(point, gap));
  }
};

void plane_box(const Plane& plane, const Vector3& half, const Placement& place) {
  const Vector3 direction = place.rotation.transpose() * plane.normal;
  // The face whose four corners are the lowest.
  const Vector3 reach = direction.cwiseAbs().cwiseProduct(half);
  int axis = 0;
  reach.maxCoeff(&axis);
  const int i = (axis + 1) % 3, j = (axis + 2) % 3;
  const Vector3 face = place * Vector3(-sign(direction[axis]) * half[axis] * Vector3::Unit(axis));
  const Vector3 along_i = half[i] * place.rotation.col(i), along_j = half[j] * place.rotation.col(j);
  plane.touch(face + along_i + along_j);
  plane.touch(face - along_i + along_j);
  plane.touch(face - along_i - along_j);
  plane.touch(face + along_i - along_j);
}

void plane_capsule(const Plane& plane, double radius, double half, const Placement& place) {
  const Vector3 axis = place.rotation.col(2);
  const double slope = axis.dot(plane.normal);
  const Vector3 lower_end = place.translation - sign(slope) * half * axis;
  plane.touch(lower_end - radius * plane.normal);
  // The upper end touches with the straight side, which reaches a little lower than its cap.
  const Vector3 across = plane.normal - slope * axis;
  const double length = across.norm();
  const Vector3 upper_end = place.translation + sign(slope) * half * axis;
  plane.touch(length > 0.5 ? Vector3(upper_end - radius / length * across)
                           : Vector3(upper_end - radius * plane.normal));
}

void plane_cylinder(const Plane& plane, double radius, double half, const Placement& place) {
  const Vector3 axis = place.rotation.col(2);
  const double slope = axis.dot(plane.normal);
  const Vector3 lower_cap = place.translation - sign(slope) * half * axis;
  const Vector3 across = slope * axis - plane.normal;  // downhill in the plane of the cap
  const double tilt = across.norm();
  const Vector3 downhill = tilt > 0.0 ? Vector3(across / tilt) : Vector3(place.rotation.col(0));
  if (std::abs(slope) * half < tilt * radius) {
    plane.touch(lower_cap + radius * downhill);
    plane.touch(place.translation + sign(slope) * half * axis + radius * downhill);
    return;
  }
  // Four points of the rim at the axes of the body; the lowest one takes the place of that next to it.
  const Vector3 x = place.rotation.col(0), y = place.rotation.col(1);
  const std::array<Vector3, 4> fixed = {x, y, -x, -y};
  int nearest = -1;
  if (tilt > kStandingTilt) {
    nearest = 0;
    for (int k = 1; k < 4; ++k)
      if (fixed[k].dot(downhill) > fixed[nearest].dot(downhill)) nearest = k;
  }
  for (int k = 0; k < 4; ++k) plane.touch(lower_cap + radius * (k == nearest ? downhill : fixed[k]));
}

void plane_hull(const Plane& plane, const Solid& solid, const Placement& place, int& hint) {
  const Hull& hull = *solid.hull;
  const Vector3 down = -(place.rotation.transpose() * plane.normal);
  const int lowest = hull.support(down, hint);
  const double least = plane.height(place * hull.vertices[lowest]);
  if (!(least <= plane.margin)) return;
  // The vertices below a level are connected by edges, so a walk from the lowest one meets all of them. To these come
  // those of the face that looks down most.
  const double level = std::min(plane.margin, least + std::min(plane.margin, kBottom * solid.radius));
  std::array<int, kBottomVertices> seen;
  int count = 0;
  const auto visit = [&](int vertex) {
    if (count < kBottomVertices && std::find(seen.begin(), seen.begin() + count, vertex) == seen.begin() + count)
      seen[count++] = vertex;
  };
  int face = -1;
  double best = 0.0;
  for (int c = hull.corner_begin[lowest]; c < hull.corner_begin[lowest + 1]; ++c) {
    const double cosine = hull.face_normals[hull.corner_faces[c]].dot(down);
    if (cosine > best) best = cosine, face = hull.corner_faces[c];
  }
  visit(lowest);
  if (face >= 0)
    for (int k = hull.face_begin[face]; k < hull.face_begin[face + 1]; ++k) visit(hull.face_vertices[k]);
  for (int next = 0; next < count; ++next) {
    const int from = seen[next];
    if (next > 0 && plane.height(place * hull.vertices[from]) > level) continue;
    for (int k = hull.neighbour_begin[from]; k < hull.neighbour_begin[from + 1] && count < kBottomVertices; ++k)
      if (plane.height(place * hull.vertices[hull.neighbours[k]]) <= level) visit(hull.neighbours[k]);
  }
  // Sorted, so that rounding in the walk does not choose among equals.
  std::sort(seen.begin(), seen.begin() + count);
  Candidates candidates;
  for (int k = 0; k < count; ++k) {
    const Vector3 point = place * hull.vertices[seen[k]];
    const double gap = plane.height(point);
    if (gap <= plane.margin) candidates.add(plane.above(point, gap));
  }
  reduce(candidates, kAsDeep * solid.radius, plane.out);
}

/// Signed distance of a point to a surface and the outward normal there, in the shape's frame.
struct Nearest {
  double distance;
  Vector3 normal;
};

Nearest nearest_on_box(const Vector3& half, const Vector3& point) {
  const Vector3 excess = point.cwiseAbs() - half;
  const Vector3 outside = excess.cwiseMax(0.0);
  const double distance = outside.norm();
  if (distance > 1e-12 * half.maxCoeff()) {
    Vector3 normal = outside / distance;
    for (int k = 0; k < 3; ++k) normal[k] *= sign(point[k]);
    return {distance, normal};
  }
  int axis = 0;
  const double depth = excess.maxCoeff(&axis);
  return {depth, sign(point[axis]) * Vector3::Unit(axis)};
}

Nearest nearest_on_segment(double half, const Vector3& point) {
  const Vector3 offset = point - Vector3(0.0, 0.0, std::clamp(point[2], -half, half));
  const double distance = offset.norm();
  if (distance > 1e-14 * half) return {distance, offset / distance};
  return {0.0, Vector3::UnitX()};
}

Nearest nearest_on_cylinder(double radius, double half, const Vector3& point) {
  const double across = std::hypot(point[0], point[1]);
  const Vector3 side =
      across > 1e-14 * radius ? Vector3(point[0] / across, point[1] / across, 0.0) : Vector3(Vector3::UnitX());
  const Vector3 end = sign(point[2]) * Vector3::UnitZ();
  const double beyond_side = across - radius, beyond_end = std::abs(point[2]) - half;
  const double distance = std::hypot(std::max(beyond_side, 0.0), std::max(beyond_end, 0.0));
  if (beyond_side > 0.0 && beyond_end > 0.0 && distance > 1e-12 * radius)
    return {distance, (beyond_side * side + beyond_end * end) / distance};
  if (beyond_end >= beyond_side) return {beyond_end, end};
  return {beyond_side, side};
}

}  // namespace

void half_space_against(const Placement& half_space, const Solid& b, const Placement& place_b, double margin, int& hint,
                        Manifold& out) {
  out.count = 0;
  const Plane plane{half_space.rotation.col(2), half_space.translation, margin, out};
  switch (b.type) {
    case ShapeType::Sphere:
      return plane.touch(place_b.translation - b.size[0] * plane.normal);
    case ShapeType::Box:
      return plane_box(plane, b.size, place_b);
    case ShapeType::Capsule:
      return plane_capsule(plane, b.size[0], b.size[1], place_b);
    case ShapeType::Cylinder:
      return plane_cylinder(plane, b.size[0], b.size[1], place_b);
    case ShapeType::Ellipsoid:
      return plane.touch(place_b * b.support(-(place_b.rotation.transpose() * plane.normal), hint));
    case ShapeType::Convex:
      return plane_hull(plane, b, place_b, hint);
    case ShapeType::HalfSpace:
    case ShapeType::HeightField:
      return;
  }
}

void sphere_against(double radius, const Vector3& centre, const Solid& b, const Placement& place_b, double margin,
                    Manifold& out) {
  out.count = 0;
  const Vector3 offset = centre - place_b.translation;
  Nearest nearest{};
  if (b.type == ShapeType::Sphere) {
    const double distance = offset.norm();
    const bool apart = distance > 1e-14 * (radius + b.size[0]);
    nearest = {distance, apart ? Vector3(offset / distance) : Vector3(Vector3::UnitZ())};
  } else {
    const Vector3 point = place_b.rotation.transpose() * offset;
    nearest = b.type == ShapeType::Box       ? nearest_on_box(b.size, point)
              : b.type == ShapeType::Capsule ? nearest_on_segment(b.size[1], point)
                                             : nearest_on_cylinder(b.size[0], b.size[1], point);
    nearest.normal = place_b.rotation * nearest.normal;
  }
  const double to_surface = nearest.distance - b.rounding, gap = to_surface - radius;
  if (!(gap <= margin)) return;
  const Vector3 normal = -nearest.normal;  // from the sphere to b
  out.add({centre + radius * normal, centre + to_surface * normal, normal, gap});
}

void capsule_capsule(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b, double margin,
                     Manifold& out) {
  out.count = 0;
  const double radius_a = a.size[0], radius_b = b.size[0], half_a = a.size[1], half_b = b.size[1];
  const Vector3 axis_a = place_a.rotation.col(2), axis_b = place_b.rotation.col(2);
  const Vector3 offset = place_b.translation - place_a.translation;
  const double aligned = axis_a.dot(axis_b), along_a = axis_a.dot(offset), along_b = axis_b.dot(offset);
  const Vector3 twist = axis_a.cross(axis_b);
  const double sine_squared = twist.squaredNorm();
  const double reach = margin + radius_a + radius_b;

  const auto add = [&](double s, double t) {
    const Vector3 on_axis_a = place_a.translation + s * axis_a, on_axis_b = place_b.translation + t * axis_b;
    const Vector3 between = on_axis_b - on_axis_a;
    const double distance = between.norm();
    if (!(distance <= reach)) return;
    Vector3 normal;
    if (distance > 1e-12 * (radius_a + radius_b))
      normal = between / distance;
    else if (sine_squared > 1e-12)
      normal = twist / std::sqrt(sine_squared);
    else
      normal = any_normal_to(axis_a);
    out.add({on_axis_a + radius_a * normal, on_axis_b - radius_b * normal, normal, distance - radius_a - radius_b});
  };

  // Closest points of the two axes: of the lines, then pushed to the ends that stop them.
  double s = sine_squared > 1e-12 ? (along_a - aligned * along_b) / sine_squared : 0.0;
  s = std::clamp(s, -half_a, half_a);
  double t = aligned * s - along_b;
  if (std::abs(t) > half_b) {
    t = std::clamp(t, -half_b, half_b);
    s = std::clamp(along_a + aligned * t, -half_a, half_a);
  }
  if (sine_squared >= kParallelSine * kParallelSine) return add(s, t);

  // Nearly parallel: the ends of the stretch where they run side by side, and between them the closest point if it is
  // clearly closer.
  const double first = along_a - aligned * half_b, second = along_a + aligned * half_b;
  const double lower = std::max(-half_a, std::min(first, second)), upper = std::min(half_a, std::max(first, second));
  const double smaller = std::min(radius_a, radius_b);
  if (!(upper - lower > 1e-3 * smaller)) return add(s, t);
  for (const double end : {lower, upper}) add(end, std::clamp(aligned * end - along_b, -half_b, half_b));
  const Vector3 closest = offset + t * axis_b - s * axis_a;
  double least = std::numeric_limits<double>::infinity();
  for (int k = 0; k < out.count; ++k) least = std::min(least, out.points[k].gap);
  if (closest.norm() - radius_a - radius_b < least - kAsDeep * smaller) add(s, t);
}

}  // namespace signorini
