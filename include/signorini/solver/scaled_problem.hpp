#pragma once

#include <memory>
#include <vector>

#include "signorini/problem/contact_problem.hpp"
#include "signorini/problem/residual.hpp"

namespace signorini {

/// A contact problem in a solver's own units: one positive scale per set and a right-hand side of unit size, so that
/// masses of 1 to 1e4 and impulses of 1e-3 live on one scale (docs/theory.md, T13 and T14).
///     impulse = unit S l,   velocity = unit S^-1 t,   t = A l + b,   A = S (G + R) S,   b = S g / unit
/// with S = diag(1 / sqrt(d)). One factor per set keeps friction cones; interval bounds are scaled along.
struct ScaledProblem {
  ConstraintSets sets;
  GrowVector scale;  ///< diagonal of S
  GrowVector b;
  double unit = 1.0;
  double reference = 0.0;  ///< max over the sets of |b_i|: the certificate's scale when impulses are smaller
  /// What natural_residual adds to the relative residual so that both tests of Residual::solves are one: the residual
  /// over `reference` times this.
  double share_weight = 0.0;
  std::unique_ptr<ScaledDelassus> system;

  /// Sizes and fills everything. tolerance: what the caller will compare natural_residual with.
  /// scaled = false: S = I, unit = 1.
  void setup(const ContactProblem& problem, double tolerance, bool scaled = true);
  /// The same of some of the problem's sets, given by their numbers, ascending: a whole island.
  void setup_part(const ContactProblem& problem, const std::vector<int>& part, double tolerance);

  /// Makes A stand for A + weight I: a compliance of `weight` times the diagonal. 0: the problem itself again.
  void regularize(const ContactProblem& problem, double weight);

  Index size() const { return b.size(); }
  void to_impulse(const ConstVectorRef& l, VectorRef impulse) const { impulse = unit * scale.cwiseProduct(l); }
  void from_impulse(const ConstVectorRef& impulse, VectorRef l) const { l = impulse.cwiseQuotient(scale) / unit; }

 private:
  void take(const ContactProblem& problem, const std::vector<int>* part, double tolerance, bool scaled);
  GrowVector compliance_;
};

/// The certificate's relative residual of l (T15), or the residual over `reference` times share_weight if larger, from
/// its velocity t = A l + b (without Gamma), when scaled with S. natural, n values, receives l - P_K(l - (t +
/// Gamma(t))). Allocates nothing.
double natural_residual(const ScaledProblem& problem, Law law, const ConstVectorRef& l, const ConstVectorRef& t,
                        VectorRef natural);

}  // namespace signorini
