#pragma once

#include <vector>

#include "signorini/solver/block_sweeps.hpp"
#include "signorini/solver/interior_point.hpp"
#include "signorini/solver/newton.hpp"
#include "signorini/solver/patch_sweeps.hpp"

namespace signorini {

struct AutoWorkspace {
  ScaledProblem problem;
  BlockSweeps sweeps;
  PatchSweeps patches;
  InteriorPoint interior_point;
  NewtonMemory newton;
  GrowVector best, ray, near, start, impulse, scratch;
  std::vector<int> labels, first, members, part;  ///< of the sets: island; islands' first members; sets by island
};

/// The default method: nobody should have to choose (docs/auto.md).
void solve_auto(const ContactProblem& problem, const Settings& settings, AutoWorkspace& workspace, const Guess* guess,
                Solution& solution);

}  // namespace signorini
