#pragma once

#include <array>
#include <memory>
#include <vector>

#include "signorini/model/placement.hpp"

namespace signorini {

enum class ShapeType { Sphere, Box, Capsule, Cylinder, Ellipsoid, HalfSpace, Convex };

/// A closed convex polyhedron about any origin; the vertices are those of its hull, the triangles wind outwards.
struct ConvexMesh {
  std::vector<Vector3> vertices;  ///< [m]
  std::vector<std::array<int, 3>> triangles;
};

/// What can collide. `size` [m]: Sphere (radius, -, -); Box half extents; Capsule and Cylinder (radius, half length of
/// the axis, -) along z, the capsule's without its caps; Ellipsoid radii; HalfSpace unused: solid where z <= 0; Convex
/// unused.
struct Shape {
  ShapeType type = ShapeType::Sphere;
  Vector3 size = Vector3::Zero();
  std::shared_ptr<const ConvexMesh> mesh;  ///< Convex only

  static Shape sphere(double radius);
  static Shape box(const Vector3& half_extents);
  static Shape capsule(double radius, double half_length);
  static Shape cylinder(double radius, double half_length);
  static Shape ellipsoid(const Vector3& radii);
  static Shape half_space();
  static Shape convex(ConvexMesh mesh);

  /// Radius of a ball about the origin that holds the shape; infinite for a half space.
  double bounding_radius() const;
  /// Raises InvalidInput naming `field`, the value and the allowed range: sizes not in (0, 1e6], fewer than 4 vertices,
  /// entries not finite, a triangle with an index out of range, all vertices in one plane.
  void validate(const char* field) const;
};

}  // namespace signorini
