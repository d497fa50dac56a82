#pragma once

#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// G = J M^-1 J^T kept as J and M. Systems are solved in the space of the nv generalised velocities (Woodbury), which
/// is the smaller one in piles and stacks, where contacts are many and redundant. Where velocities that M ties together
/// are ill-conditioned, M^-1 J^T is computed in twice the working precision: what is certified is true of M and J.
class MassSpaceDelassus final : public DelassusOperator {
 public:
  /// mass: M, nv x nv, symmetric positive definite, both triangles [kg, kg m, kg m^2]. jacobian: J, n x nv.
  /// Raises InvalidInput naming `mass` or `jacobian`: shapes, non-finite entries, M not symmetric to 1e-6 or
  /// not positive definite, M with a condition number above 1e15 (rows scaled to diagonal 1).
  MassSpaceDelassus(const SparseMatrix& mass, const SparseMatrix& jacobian);

  Index size() const override { return jacobian_.rows(); }
  Index num_velocities() const { return mass_.rows(); }
  const SparseMatrix& mass() const { return mass_; }
  const SparseMatrix& jacobian() const { return jacobian_; }
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  void diagonal(VectorRef diagonal) const override;
  SparseMatrix matrix() const override;
  bool definite_by_construction() const override { return true; }
  double asymmetry() const override { return asymmetry_; }
  std::vector<int> islands(const ConstraintSets& sets) const override;
  std::shared_ptr<const DelassusOperator> restrict(const std::vector<Index>& rows) const override;
  void prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
               std::unique_ptr<ScaledDelassus>& system) const override;

 private:
  void invert_mass();

  SparseMatrix mass_, jacobian_;
  SparseMatrix transpose_;                // of J
  std::vector<int> group_of_;             // of each velocity: those that M ties together are one
  std::vector<std::vector<int>> groups_;  // their velocities, ascending
  SparseMatrix inverse_mass_jacobian_;    // M^-1 J^T, nv x n
  double asymmetry_ = 0.0;
};

}  // namespace signorini
