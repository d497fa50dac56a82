#pragma once

#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// G stored as a sparse matrix, both triangles.
class SparseDelassus final : public DelassusOperator {
 public:
  /// matrix: n x n; its symmetric part is used. Raises InvalidInput("delassus", ...) when not square or not finite.
  explicit SparseDelassus(const SparseMatrix& matrix);

  Index size() const override { return matrix_.rows(); }
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  void diagonal(VectorRef diagonal) const override;
  SparseMatrix matrix() const override { return matrix_; }
  double asymmetry() const override { return asymmetry_; }
  std::vector<int> islands(const ConstraintSets& sets) const override;
  std::shared_ptr<const DelassusOperator> restrict(const std::vector<Index>& rows) const override;
  void prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
               std::unique_ptr<ScaledDelassus>& system) const override;

 private:
  SparseMatrix matrix_;
  double asymmetry_ = 0.0;
};

}  // namespace signorini
