#pragma once

#include <array>

#include "signorini/model/placement.hpp"
#include "solid.hpp"

namespace signorini {

/// A point on each of two surfaces, and the gap between them along the normal (from a to b); world frame.
struct SurfacePair {
  Vector3 on_a, on_b, normal;
  double gap;
  bool spare = false;  ///< beyond the four that hold the pair apart as a rule
};

/// The contact of one pair of shapes.
struct Manifold {
  static constexpr int kMost = 16;    // with spare ones: as many as a rim has
  static constexpr int kOnField = 8;  // of a height field
  static constexpr int kPatch = 4;    // of two convex shapes, without spare ones
  int count = 0;
  std::array<SurfacePair, kMost> points;

  void add(const SurfacePair& point) { points[count++] = point; }
  /// Spare ones come last.
  void drop_spare() {
    while (count > 0 && points[count - 1].spare) --count;
  }
  /// The same seen from the other shape.
  void swap_sides() {
    for (int k = 0; k < count; ++k) {
      std::swap(points[k].on_a, points[k].on_b);
      points[k].normal = -points[k].normal;
    }
  }
};

/// Candidates for a manifold, more than it may keep.
struct Candidates {
  static constexpr int kMost = 2 * Feature::kMost + 8;
  int count = 0;
  std::array<SurfacePair, kMost> points;

  void add(const SurfacePair& point) {
    if (count < kMost) points[count++] = point;
  }
};

/// Keeps four: the deepest, then those that span the largest area; then, as spare ones, the lowest of the others. Where
/// several are as good to within `tolerance` [m] the first one is taken, so that rounding does not choose.
void reduce(const Candidates& candidates, double tolerance, Manifold& out);

/// Where the projections of two features along the normal of `deepest` overlap, with the gap at each corner, up to
/// `margin`; `deepest` is among the points, or one as deep. `scale` [m]: size of the smaller shape. False if `deepest`
/// had to be added: the overlap does not reach as deep, or there is none.
bool clip_features(const Feature& a, const Feature& b, const SurfacePair& deepest, double margin, double scale,
                   Manifold& out);

/// From the frame of a shape to the world.
void move(const Placement& place, Feature& feature);

/// Two unit vectors that complete a unit vector to a right-handed frame.
void complete_frame(const Vector3& normal, Vector3& first, Vector3& second);

}  // namespace signorini
