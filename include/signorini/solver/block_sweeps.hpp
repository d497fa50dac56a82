#pragma once

#include <vector>

#include "signorini/solver/scaled_problem.hpp"

namespace signorini {

/// What the visits of one set need.
struct SweptSet {
  Eigen::Matrix3d block;  ///< of A
  double normal = 0.0;    ///< 1 / normal diagonal entry; of a one-row set, 1 / its entry
  double tangent = 0.0;   ///< 1 / largest eigenvalue of the tangential block

  int steps = 3;  ///< at each visit

  SweptSet() = default;
  SweptSet(const ConstraintSet& set, const Eigen::Matrix3d& block);
  /// One step where it is exact but for rounding: its rows do not act on each other, and its tangents are alike, as for
  /// a sphere.
  void take_one_step_if_exact();
};
using SweptSets = std::vector<SweptSet, Eigen::aligned_allocator<SweptSet>>;

/// One visit: Signorini and Coulomb in turn, as solve_pgs() does, a few times on the set's own block before the others
/// hear of it. l, t: the set's own rows of impulse and velocity; l is replaced. change: by what. False when by nothing.
/// slips: whether a contact does.
bool visit_set(const ConstraintSet& set, const SweptSet& swept, double* l, const double* t, double* change,
               bool& slips);

/// Projected Gauss-Seidel on a scaled problem of the NCP (ScaledDelassus::reduces), a set at a time, with a few steps
/// at each visit: cheap first steps for `auto`, a tenth of a Newton iteration each, and between those of proximal
/// Newton (docs/auto.md). The velocity is kept up to date, so that the certificate costs no product. Nothing allocates
/// for sizes already seen where ScaledDelassus::cheap_columns().
class BlockSweeps {
 public:
  /// From `start`, projected on K; from 0 without one. centre: of the problem with A + weight I and b - weight centre.
  void start(const ScaledProblem& problem, const GrowVector* start, double weight = 0.0,
             const GrowVector* centre = nullptr);
  void sweep(const ScaledProblem& problem);
  /// The certificate of impulse().
  double relative(const ScaledProblem& problem);
  const GrowVector& impulse() const { return l_; }
  const GrowVector& velocity() const { return t_; }  ///< A impulse() + b + weight (impulse() - centre)
  /// Whether a contact slipped in the last sweep.
  bool slips() const { return slipping_ > 0; }
  /// How many contacts pressed in it.
  int pressing() const { return pressing_; }
  /// Whether at most a quarter of those that pressed did.
  bool mostly_sticks() const { return 4 * slipping_ <= pressing_; }

 private:
  GrowVector l_, t_, natural_;  ///< impulse, its velocity, residual
  double weight_ = 0.0;
  int slipping_ = 0, pressing_ = 0;
  SweptSets sets_;
};

}  // namespace signorini
