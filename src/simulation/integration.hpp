#pragma once

#include "signorini/model/world.hpp"

namespace signorini {

/// Advances q along v, and writes v, which counts in the frames of the free joints' bodies as they stood at the start
/// of the step, in the frames as they stand at its end (docs/simulation.md, S3 to S5). Free bodies keep momentum
/// exactly.
void advance(const World& world, double time_step, VectorRef q, VectorRef v);

/// The inverse of what advance() does to v, in place. False where a free body turns so far in one step that it is not
/// found (more than about 1 rad).
bool turn_back(const World& world, double time_step, VectorRef v);

}  // namespace signorini
