#pragma once

#include <vector>

#include "convex_pair.hpp"

namespace signorini {

/// Contacts of a height field with a convex shape: the points that a half space would give, for each triangle under the
/// shape, as far as they lie over that triangle; and those of ridges, of the border and of the walls below it.
/// Edges that do not stick out have none, so nothing is felt of edges inside a plane. Holds work space: one a thread.
class FieldContacts {
 public:
  FieldContacts();

  /// At most eight points; the height field is a in the result. `hint`: support vertex of b.
  void collide(const HeightGrid& grid, const Placement& place_field, const Solid& b, const Placement& place_b,
               double margin, ConvexPair& convex_pair, int& hint, Manifold& out);

 private:
  struct Query;
  Solid segment_;  // an edge of the field
  std::vector<SurfacePair> candidates_;
};

}  // namespace signorini
