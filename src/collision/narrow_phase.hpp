#pragma once

#include "convex_pair.hpp"
#include "height_field.hpp"

namespace signorini {

/// Contact points of two shapes by the method that suits the pair: docs/collision.md. Holds work space: one a thread.
class NarrowPhase {
 public:
  /// At most four points, eight on a height field; none that is not finite.
  void collide(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b, double margin,
               PairMemory& memory, Manifold& out);

 private:
  ConvexPair convex_pair_;
  FieldContacts field_contacts_;
};

}  // namespace signorini
