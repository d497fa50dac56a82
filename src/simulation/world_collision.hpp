#pragma once

#include <vector>

#include "signorini/collision/detector.hpp"
#include "signorini/model/world.hpp"
#include "signorini/simulation/simulator.hpp"

namespace signorini {

std::vector<CollisionGeometry> collision_geometries(const World& world);

/// World::may_touch for a detector, without a list of all pairs.
CollisionFilter collision_filter(const World& world);

DetectorSettings detector_settings(const SimulatorSettings& settings);
CorrectionSettings correction_settings(const SimulatorSettings& settings);

}  // namespace signorini
