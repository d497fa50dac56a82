#pragma once

#include "manifold.hpp"

namespace signorini {

/// Two boxes, by separating axes and clipping. False, and nothing decided, if they are apart and closest at a corner or
/// an edge, where the distance is that along no such axis.
bool box_box(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b, double margin,
             Manifold& out);

}  // namespace signorini
