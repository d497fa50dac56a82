#pragma once

#include "signorini/problem/constraint_set.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

struct InverseSettings {
  Law law = Law::Ncp;
  double proximal_weight = 1e-8;  ///< rho [1/kg], in (0, 1e6]; takes the place of a compliance that is 0
  double tolerance = 1e-6;        ///< on InverseSolution::relative, in (0, 1)
  int max_iterations = 100;       ///< at least 1
  /// A set whose answer is far from the guess keeps the guess, and is not solved: for a guess that is certified
  /// already.
  bool keep = false;

  /// Raises InvalidInput naming the field, its value and the allowed range.
  void validate() const;
};

/// Complete also when there is no solution: the impulse is then the start, or the last iterate where
/// that is much nearer to one.
struct InverseSolution {
  /// Solved, MaxIterations, Infeasible: no impulse allows the velocity; Invalid: the impulse is too large for a number.
  Status status = Status::Invalid;
  GrowVector impulse;   ///< lambda [N s]
  GrowVector velocity;  ///< sigma = R lambda + c [m/s], without Gamma
  /// max over the sets of dist(-(sigma + Gamma(sigma)), N_K(lambda)): how far the velocity is from one that the law
  /// allows with this impulse [m/s, rad/s].
  double residual = 0.0;
  double relative = 0.0;  ///< the same over the speed given or found
  Index worst = -1;       ///< the set with the largest residual; -1 without sets
  int iterations = 0;
};

/// The impulse behind a contact velocity (docs/theory.md, section 13; Carpentier et al. 2024, section IV):
///     lambda in K,   sigma = R lambda + c,   -(sigma + Gamma(sigma)) in N_K(lambda).
/// Where R = 0 there are many or none: the answer is the one next to the guess, by proximal steps.
/// velocity: c = J v + corrections [m/s]. compliance: diagonal of R [1/kg] >= 0, equal for the two tangents of a
/// contact. guess: an impulse, in K or not, or null for 0. speed: what `relative` is relative to [m/s]; 0: the largest
/// |c| or |R guess| of a set. Allocates nothing for sizes already seen. Raises InvalidInput naming the field, the value
/// and the allowed range.
void solve_inverse(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets,
                   const InverseSettings& settings, InverseSolution& solution, const ConstVectorRef* guess = nullptr,
                   double speed = 0.0);

/// Residual, relative and worst of solution.impulse, whoever computed it, and its velocity; the rest stays. It has to
/// be in K: the distance to normals means nothing elsewhere.
void judge_inverse(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets,
                   Law law, double speed, InverseSolution& solution);

}  // namespace signorini
