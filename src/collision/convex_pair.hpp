#pragma once

#include <array>
#include <memory>

#include "closest_search.hpp"
#include "manifold.hpp"

namespace signorini {

/// Closest or deepest points of two convex shapes, by Coal's GJK and EPA, then polished to rounding: whatever normal
/// those return is only a start for candidates (face normals, products of edges, Newton's method where surfaces are
/// curved) of which the one that separates most is taken. Holds work space: one a thread.
class ConvexPair {
 public:
  ConvexPair();
  ~ConvexPair();

  /// Leaves no point if the shapes are more than `margin` apart. likely: two normals (world)
  /// between which that of an overlap is expected; then it is looked for there, not everywhere.
  void collide(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b, double margin,
               PairMemory& memory, Manifold& out, const std::array<Vector3, 2>* likely = nullptr);

 private:
  struct Search;
  std::unique_ptr<Search> search_;
};

}  // namespace signorini
