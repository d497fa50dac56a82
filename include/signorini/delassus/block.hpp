#pragma once

#include <utility>
#include <vector>

#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// G as dense blocks, one for each pair of sets that act on each other: what a simulator assembles in place, step after
/// step. Reset to sizes already seen, and everything that a solver asks of it, allocate nothing.
class BlockDelassus final : public DelassusOperator {
 public:
  /// The sets (i, j), i > j, of a block.
  using Pair = std::pair<int, int>;

  /// Takes the pattern and sets all values to zero. blocks: pairs of sets (i, j), i > j, in ascending order; the
  /// diagonal blocks are there anyway. Raises InvalidInput("blocks[k]", ...).
  void reset(const ConstraintSets& sets, const std::vector<Pair>& blocks);

  Index num_sets() const { return static_cast<Index>(offsets_.size()) - 1; }
  Index num_blocks() const { return static_cast<Index>(pairs_.size()); }
  Pair pair(Index k) const { return pairs_[static_cast<std::size_t>(k)]; }

  /// G(rows of set i, rows of set j) of the k-th pair (i, j), column-major.
  double* block(Index k) { return values_.data() + starts_[static_cast<std::size_t>(k)]; }
  const double* block(Index k) const { return values_.data() + starts_[static_cast<std::size_t>(k)]; }
  /// G(rows of set i, rows of set i), column-major; only its lower triangle is read.
  double* diagonal_block(Index i) { return values_.data() + diagonal_starts_[static_cast<std::size_t>(i)]; }
  const double* diagonal_block(Index i) const { return values_.data() + diagonal_starts_[static_cast<std::size_t>(i)]; }

  Index size() const override { return offsets_.back(); }
  void check(const ConstraintSets& sets) const override;
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  void diagonal(VectorRef diagonal) const override;
  SparseMatrix matrix() const override;
  std::vector<int> islands(const ConstraintSets& sets) const override;
  void label_islands(const ConstraintSets& sets, std::vector<int>& labels) const override;
  std::shared_ptr<const DelassusOperator> restrict(const std::vector<Index>& rows) const override;
  void prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
               std::unique_ptr<ScaledDelassus>& system) const override;
  void prepare_part(const ConstraintSets& sets, const std::vector<int>& part, const ConstraintSets& part_sets,
                    const ConstVectorRef& scale, const ConstVectorRef& compliance,
                    std::unique_ptr<ScaledDelassus>& system) const override;

 private:
  int size_of(int i) const { return offsets_[static_cast<std::size_t>(i) + 1] - offsets_[static_cast<std::size_t>(i)]; }

  std::vector<int> offsets_ = {0};  ///< first row of each set, and the number of rows
  std::vector<Pair> pairs_;
  std::vector<int> first_pair_;                  ///< of each set i, in pairs_; and their number
  std::vector<Index> starts_, diagonal_starts_;  ///< in values_
  std::vector<double> values_;
};

}  // namespace signorini
