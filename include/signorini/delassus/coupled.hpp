#pragma once

#include <vector>

#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// G as a dense matrix, filled in place step after step, of sets that all act on each other, directly or through
/// others: one island. Sizes already seen allocate nothing.
class CoupledDelassus final : public DelassusOperator {
 public:
  /// rows x rows values, column-major, for the caller to fill, both triangles.
  double* reset(Index rows);

  Index size() const override { return size_; }
  void check(const ConstraintSets& sets) const override;
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  void diagonal(VectorRef diagonal) const override;
  SparseMatrix matrix() const override;
  std::vector<int> islands(const ConstraintSets& sets) const override;
  void label_islands(const ConstraintSets& sets, std::vector<int>& labels) const override;
  std::shared_ptr<const DelassusOperator> restrict(const std::vector<Index>& rows) const override;
  void prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
               std::unique_ptr<ScaledDelassus>& system) const override;

 private:
  Eigen::Map<const Matrix> dense() const { return {values_.data(), size_, size_}; }

  std::vector<double> values_;
  Index size_ = 0;
};

}  // namespace signorini
