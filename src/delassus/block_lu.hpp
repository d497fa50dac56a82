#pragma once

#include <vector>

#include "signorini/types.hpp"

namespace signorini {

/// Multifrontal LU of a square matrix of small dense blocks with a symmetric pattern and unsymmetric values: an
/// approximate-minimum-degree order of the block graph, relaxed supernodes, dense fronts, row pivoting inside a
/// supernode. After analyze(), factor() and solve() allocate nothing.
/// Reference: Duff and Reid 1983; Liu 1992 for the elimination tree and the stack of updates.
class BlockLu {
 public:
  /// A pair of blocks (i, j) and (j, i), i >= j; for i = j one block.
  struct Pair {
    int i, j;
    Index lower;  ///< where block (i, j), size_i x size_j column-major, starts in values()
    Index upper;  ///< where block (j, i) starts; equal to lower for i = j
  };

  /// block_sizes: rows of each diagonal block. neighbours: for each block j the sorted blocks i > j that it shares an
  /// entry with.
  void analyze(const std::vector<int>& block_sizes, const std::vector<std::vector<int>>& neighbours);

  Index size() const { return size_; }
  const std::vector<Pair>& pairs() const { return pairs_; }
  /// Entries of the matrix, to be filled before factor().
  std::vector<double>& values() { return values_; }
  const std::vector<double>& values() const { return values_; }

  bool factor();
  int determinant_sign() const { return sign_; }
  void solve(VectorRef rhs) const;
  /// Entries of L and U.
  Index num_factor_entries() const { return static_cast<Index>(factors_.size()); }

 private:
  struct Supernode {
    int pivots = 0, updates = 0;  // p, u in rows
    int first = 0;                // first pivot, in elimination order
    int parent = -1;
    Index lower = 0, upper = 0;  // where L (n x p) and U (p x u) start in factors_
    Index rows = 0;              // where the u update rows (elimination order) start in rows_
    Index relative = 0;          // the same rows' positions in the parent's front, in relative_
    Index entries_begin = 0, entries_end = 0;
  };
  /// Copies one block of values_ into a front.
  struct Entry {
    Index value;
    Index target;  // in factors_
    int rows, columns, stride;
  };

  Index size_ = 0;
  int sign_ = 0;
  std::vector<Pair> pairs_;
  std::vector<double> values_;
  std::vector<int> permutation_;  // row in the matrix of each row in elimination order
  std::vector<Supernode> supernodes_;
  std::vector<std::vector<int>> children_;
  std::vector<Entry> entries_;
  std::vector<int> rows_, relative_, pivots_;
  std::vector<double> factors_;
  std::vector<double> stack_, schur_;
  mutable std::vector<double> x_, update_;
};

}  // namespace signorini
