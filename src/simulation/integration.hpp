#pragma once

#include <vector>

#include "model/world_impl.hpp"

namespace signorini {

/// Advances q along v, and writes v, which counts in the frames of the free joints' bodies as they stood at the start
/// of the step, in the frames as they stand at its end (docs/simulation.md, S3 to S5). Free bodies keep momentum
/// exactly. shares: of the step that free bodies go, by frame; none: all of it.
void advance(const World& world, double time_step, VectorRef q, VectorRef v, const std::vector<double>& shares = {});

/// The constant angular velocity by which advance() turns a free body, in its frame (S5).
Vector3 mean_angular_velocity(const FreeBody& body, double time_step, const Vector3& angular);

/// The inverse of what advance() does to v, in place. False where a free body turns so far in one step that it is not
/// found (about 20 rad, of a thin one less).
bool turn_back(const World& world, double time_step, VectorRef v);

}  // namespace signorini
