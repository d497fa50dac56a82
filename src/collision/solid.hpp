#pragma once

#include <array>
#include <memory>

#include "hull.hpp"
#include "signorini/model/shape.hpp"

namespace signorini {

/// -1 or 1.
inline double sign(double x) { return x < 0.0 ? -1.0 : 1.0; }

/// What other shapes can touch, but not another of its kind.
inline bool is_ground(ShapeType type) { return type == ShapeType::HalfSpace || type == ShapeType::HeightField; }

/// A piece of a surface: a point, a segment (of a capsule: the axis, with the radius in `rounding`), or a flat convex
/// polygon.
struct Feature {
  static constexpr int kMost = 32;
  int count = 0;
  std::array<Vector3, kMost> points;
  Vector3 normal = Vector3::UnitZ();  ///< of a polygon, outward
  double rounding = 0.0;

  void add(const Vector3& point) { points[count++] = point; }
};

/// A shape ready for queries: a core (a point for a sphere, a segment for a capsule, else the shape itself) swept by a
/// ball of radius `rounding`, so that round shapes are polyhedra to whoever looks for closest points. All in the
/// shape's own frame; directions are unit vectors. A half space and a height field have no core.
struct Solid {
  ShapeType type;
  Vector3 size;
  double rounding = 0.0;
  std::shared_ptr<const Hull> hull;
  std::shared_ptr<const HeightGrid> height_grid;
  Vector3 centre = Vector3::Zero(), half_extents = Vector3::Zero();  ///< of a box that holds the shape
  double radius = 0.0;                                               ///< of a ball about `centre` that does

  Solid(const Shape& shape, std::shared_ptr<const Hull> its_hull);

  /// The point of the core farthest along `direction` (of any length); `hint` is where a hull starts looking.
  Vector3 support(const Vector3& direction, int& hint) const;
  /// Second derivative of the core's support function; zero where the core has a corner.
  Matrix3 curvature(const Vector3& direction) const;
  /// Normal of the flat face that looks nearest along `direction`; false if none within about 25 degrees.
  bool face_normal(const Vector3& direction, int hint, Vector3& normal) const;
  /// Directions of up to four straight edges (or generators) at the support point that are nearly normal to
  /// `direction`.
  int edges(const Vector3& direction, int hint, std::array<Vector3, 4>& out) const;
  /// The piece of the surface that looks along `direction`: a face if within `face_cosine`, else an edge, else a point.
  void feature(const Vector3& direction, int hint, double face_cosine, Feature& out) const;
};

}  // namespace signorini
