#pragma once

#include <array>
#include <memory>
#include <vector>

#include "signorini/model/placement.hpp"

namespace signorini {

enum class ShapeType { Sphere, Box, Capsule, Cylinder, Ellipsoid, HalfSpace, Convex, HeightField };

/// A closed convex polyhedron about any origin; the vertices are those of its hull, the triangles wind outwards.
struct ConvexMesh {
  std::vector<Vector3> vertices;  ///< [m]
  std::vector<std::array<int, 3>> triangles;
};

/// Heights over the rectangle [-half_x, half_x] x [-half_y, half_y], solid from z = -base up to the surface: rows along
/// y, columns along x. Between four samples it is two triangles, which meet in the diagonal from (row, column) to (row
/// + 1, column + 1).
struct HeightGrid {
  int rows = 0, columns = 0;
  double half_x = 1.0, half_y = 1.0, base = 1.0;  ///< [m]
  std::vector<double> heights;                    ///< [m], one row after the other
};

/// What can collide. `size` [m]: Sphere (radius, -, -); Box half extents; Capsule and Cylinder (radius, half length of
/// the axis, -) along z, the capsule's without its caps; Ellipsoid radii; HalfSpace unused: solid where z <= 0; Convex
/// and HeightField unused.
struct Shape {
  ShapeType type = ShapeType::Sphere;
  Vector3 size = Vector3::Zero();
  std::shared_ptr<const ConvexMesh> mesh;         ///< Convex only
  std::shared_ptr<const HeightGrid> height_grid;  ///< HeightField only

  static Shape sphere(double radius);
  static Shape box(const Vector3& half_extents);
  static Shape capsule(double radius, double half_length);
  static Shape cylinder(double radius, double half_length);
  static Shape ellipsoid(const Vector3& radii);
  static Shape half_space();
  static Shape convex(ConvexMesh mesh);
  static Shape height_field(HeightGrid grid);

  /// Radius of a ball about the origin that holds the shape; infinite for a half space.
  double bounding_radius() const;
  /// Raises InvalidInput naming `field`, the value and the allowed range: sizes not in (0, 1e6], fewer than 4 vertices,
  /// entries not finite, a triangle with an index out of range, all vertices in one plane; of a height field, rows or
  /// columns not in [2, 4096], a count of heights that is not rows x columns, heights not within +-1e6 or not above
  /// -base.
  void validate(const char* field) const;
};

}  // namespace signorini
