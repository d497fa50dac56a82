#pragma once

#include "block_lu.hpp"
#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// ScaledDelassus of an operator whose matrix G is at hand: blocks of A stored, X + Y A factored by BlockLu.
class ExplicitSystem final : public ScaledDelassus {
 public:
  /// matrix: G, symmetric, both triangles, compressed.
  void setup(const SparseMatrix& matrix, const ConstraintSets& sets, const ConstVectorRef& scale,
             const ConstVectorRef& compliance);

  Index size() const override { return lu_.size(); }
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  bool factor(const BlockDiagonal& x, const BlockDiagonal& y) override;
  bool factor(const BlockDiagonal& x) override;
  int determinant_sign() const override { return lu_.determinant_sign(); }
  void solve(VectorRef rhs) const override { lu_.solve(rhs); }

 private:
  bool same_pattern(const SparseMatrix& matrix, const ConstraintSets& sets) const;
  void analyze(const SparseMatrix& matrix, const ConstraintSets& sets);

  BlockLu lu_;
  std::vector<int> sizes_, offsets_;
  std::vector<double> a_;       ///< values of A, laid out as lu_.values()
  std::vector<Index> targets_;  ///< for each stored entry of G, where it goes in a_; the sum of what lands there
  std::vector<int> outer_, inner_;
};

/// Shared by the operators: max |G - G^T| / max |G|.
double asymmetry_of(const SparseMatrix& matrix);

}  // namespace signorini
