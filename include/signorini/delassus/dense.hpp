#pragma once

#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// G stored as a dense matrix. Blocks that are zero are skipped when factoring.
class DenseDelassus final : public DelassusOperator {
 public:
  /// matrix: n x n; its symmetric part is used. Raises InvalidInput("delassus", ...) when not square or not finite.
  explicit DenseDelassus(const Eigen::Ref<const Matrix>& matrix);

  Index size() const override { return matrix_.rows(); }
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  void diagonal(VectorRef diagonal) const override;
  SparseMatrix matrix() const override;
  double asymmetry() const override { return asymmetry_; }
  std::vector<int> islands(const ConstraintSets& sets) const override;
  void label_islands(const ConstraintSets& sets, std::vector<int>& labels) const override;
  std::shared_ptr<const DelassusOperator> restrict(const std::vector<Index>& rows) const override;
  void prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
               std::unique_ptr<ScaledDelassus>& system) const override;
  void prepare_part(const ConstraintSets& sets, const std::vector<int>& part, const ConstraintSets& part_sets,
                    const ConstVectorRef& scale, const ConstVectorRef& compliance,
                    std::unique_ptr<ScaledDelassus>& system) const override;

 private:
  Matrix matrix_;
  double asymmetry_ = 0.0;
};

}  // namespace signorini
