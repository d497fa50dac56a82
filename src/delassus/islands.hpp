#pragma once

#include <vector>

#include "signorini/problem/constraint_set.hpp"

namespace signorini {

/// Disjoint sets with path halving; labels() numbers them by first appearance.
class UnionFind {
 public:
  explicit UnionFind(std::size_t count);
  int find(int i);
  void join(int i, int j);
  std::vector<int> labels();

 private:
  std::vector<int> parent_;
};

/// Connected components of the sets under the symmetric matrix G.
std::vector<int> islands_of(const SparseMatrix& matrix, const ConstraintSets& sets);

/// matrix(rows, columns) of a compressed matrix; rows must ascend.
SparseMatrix select(const SparseMatrix& matrix, const std::vector<Index>& rows, const std::vector<Index>& columns);

}  // namespace signorini
