#pragma once

#include <memory>

#include "signorini/delassus/delassus_operator.hpp"
#include "signorini/problem/constraint_set.hpp"

namespace signorini {

/// Find the impulse lambda with
///     lambda in K,   sigma = (G + R) lambda + g,   -(sigma + Gamma(sigma)) in N_K(lambda),
/// which for friction cones is the NCP (27) of Carpentier et al. 2024, for Law::Ccp its convex relaxation
/// (docs/theory.md, T1, T6 to T8).
/// Constant once built or assigned; safe to solve from several threads (one Workspace each).
class ContactProblem {
 public:
  /// No rows, until assign().
  ContactProblem();

  /// delassus: G = J M^-1 J^T [1/kg], symmetric positive semidefinite, n x n; not null.
  /// free_velocity: g [m/s], n. sets: product of constraint sets with n rows.
  /// compliance: diagonal of R [1/kg], n values >= 0, or empty for rigid.
  /// Raises InvalidInput naming the field, the value and the allowed range: sizes, NaN, infinities, magnitudes beyond
  /// 1e100, negative compliance or diagonal. Definiteness costs a factorisation: see check_definite().
  ContactProblem(std::shared_ptr<const DelassusOperator> delassus, const ConstVectorRef& free_velocity,
                 const ConstraintSets& sets, const ConstVectorRef& compliance = Vector());

  /// A move copies: what was moved from would be left with some of its parts.
  ContactProblem(const ContactProblem&) = default;
  ContactProblem& operator=(const ContactProblem&) = default;

  /// The same in place, for a stepping loop: allocates nothing for sizes already seen. Where it raises, the problem is
  /// left without rows. The operator may be the one of before, with new values in it.
  /// reference: for a problem that is part of a larger one, max |g| / sqrt(d) over the sets that are not in it, which
  /// then counts in the certificate as if they were.
  void assign(std::shared_ptr<const DelassusOperator> delassus, const ConstVectorRef& free_velocity,
              const ConstraintSets& sets, const ConstVectorRef& compliance = Vector(), double reference = 0.0);

  /// Finite; the caller's business.
  void set_free_velocity(Index row, double value) { free_velocity_[row] = value; }

  Index size() const { return free_velocity_.size(); }
  Index num_sets() const { return sets_.num_sets(); }
  Index num_contacts() const { return sets_.num_contacts(); }
  const DelassusOperator& delassus() const { return *delassus_; }
  const std::shared_ptr<const DelassusOperator>& delassus_ptr() const { return delassus_; }
  const GrowVector& free_velocity() const { return free_velocity_; }
  const GrowVector& compliance() const { return compliance_; }  ///< always n values
  const ConstraintSets& sets() const { return sets_; }
  /// d_i = trace(G_ii + R_ii) / rows of set i, repeated on its rows; 1 where that is 0. Impulses times sqrt(d) and
  /// velocities over sqrt(d) are in sqrt(J), whatever the masses and units.
  const GrowVector& scale() const { return scale_; }

  double reference() const { return reference_; }

  /// velocity = (G + R) impulse + g (T1).
  void velocity(const ConstVectorRef& impulse, VectorRef velocity) const;

  /// Raises InvalidInput("delassus", ...) when G + R is not positive semidefinite beyond rounding and beyond what its
  /// asymmetry explains. One sparse factorisation.
  void check_definite() const;

 private:
  void take(std::shared_ptr<const DelassusOperator> delassus, const ConstVectorRef& free_velocity,
            const ConstraintSets& sets, const ConstVectorRef& compliance);

  std::shared_ptr<const DelassusOperator> delassus_;
  GrowVector free_velocity_;
  ConstraintSets sets_;
  GrowVector compliance_;
  GrowVector scale_;
  double reference_ = 0.0;
};

}  // namespace signorini
