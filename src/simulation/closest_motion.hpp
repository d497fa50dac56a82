#pragma once

#include <cstdint>
#include <vector>

#include "signorini/problem/constraint_set.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

/// Find the velocity change of least kinetic energy, 1/2 change^T M change, such that the law of contact holds and no
/// force is needed where nothing is actuated (docs/simulation.md, S13 to S15):
///     U^T M change = J_u^T impulse - missing,   velocities c + J change, impulse obey the law.
struct ClosestProblem {
  struct Tie {
    Index contact, moment;  ///< sets: cones
    double factor;          ///< load of the moment over the normal impulse of the contact (S16)
  };
  Matrix mass;                          ///< M^, nv x nv
  Matrix jacobian;                      ///< J, n x nv
  Vector velocity, compliance, guess;   ///< c, R, where to start; n values
  std::vector<std::uint8_t> kinematic;  ///< by set: rigid, and so a limit to motions themselves
  ConstraintSets sets;
  std::vector<Tie> ties;
  std::vector<Index> unactuated;  ///< velocities
  Vector missing;                 ///< impulse that they lack without contact [N s, N m s]
  Settings solver;                ///< its law too
  double allowed = 0.0;           ///< violation of the law that counts as none [m/s]
};

struct ClosestMotion {
  Status status = Status::Invalid;
  Vector change;                      ///< nv
  Vector impulse;                     ///< n; of the settled sets
  std::vector<std::uint8_t> settled;  ///< by set: its impulse is part of the answer; others do not feel `unactuated`
};

ClosestMotion closest_motion(const ClosestProblem& problem);

}  // namespace signorini
