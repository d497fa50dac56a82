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

/// The same in the labels themselves, which allocates nothing for sizes already seen: each set points at one of lower
/// number, or at itself, until finish() numbers the trees.
class IslandForest {
 public:
  IslandForest(int count, std::vector<int>& labels);
  bool joined(int i, int j) { return root(i) == root(j); }
  void join(int i, int j);
  int trees() const { return trees_; }
  void finish();

 private:
  int root(int i) {
    while (labels_[i] != i) i = labels_[i] = labels_[labels_[i]];
    return i;
  }

  std::vector<int>& labels_;
  int trees_;
};

/// Connected components of the sets under the symmetric matrix G.
std::vector<int> islands_of(const SparseMatrix& matrix, const ConstraintSets& sets);

/// matrix(rows, columns) of a compressed matrix; rows must ascend.
SparseMatrix select(const SparseMatrix& matrix, const std::vector<Index>& rows, const std::vector<Index>& columns);

}  // namespace signorini
