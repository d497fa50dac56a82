#include "islands.hpp"

#include <numeric>

namespace signorini {

UnionFind::UnionFind(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0); }

int UnionFind::find(int i) {
  while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
  return i;
}

void UnionFind::join(int i, int j) {
  i = find(i), j = find(j);
  if (i != j) parent_[i > j ? i : j] = i > j ? j : i;
}

std::vector<int> UnionFind::labels() {
  std::vector<int> out(parent_.size()), label(parent_.size(), -1);
  int next = 0;
  for (std::size_t i = 0; i < parent_.size(); ++i) {
    int& known = label[find(static_cast<int>(i))];
    if (known < 0) known = next++;
    out[i] = known;
  }
  return out;
}

std::vector<int> islands_of(const SparseMatrix& matrix, const ConstraintSets& sets) {
  std::vector<int> set_of(static_cast<std::size_t>(sets.size()));
  int index = 0;
  for (const ConstraintSet& set : sets) {
    for (Index k = 0; k < set.size(); ++k) set_of[set.offset + k] = index;
    ++index;
  }
  UnionFind components(static_cast<std::size_t>(sets.num_sets()));
  for (Index c = 0; c < matrix.outerSize(); ++c)
    for (SparseMatrix::InnerIterator it(matrix, c); it && it.row() < c; ++it)
      components.join(set_of[it.row()], set_of[c]);
  return components.labels();
}

SparseMatrix select(const SparseMatrix& matrix, const std::vector<Index>& rows, const std::vector<Index>& columns) {
  std::vector<int> position(static_cast<std::size_t>(matrix.rows()), -1);
  for (std::size_t r = 0; r < rows.size(); ++r) position[rows[r]] = static_cast<int>(r);
  SparseMatrix out(static_cast<Index>(rows.size()), static_cast<Index>(columns.size()));
  Index count = 0;
  for (const Index c : columns) count += matrix.outerIndexPtr()[c + 1] - matrix.outerIndexPtr()[c];
  out.reserve(count);
  for (std::size_t c = 0; c < columns.size(); ++c) {
    out.startVec(static_cast<Index>(c));
    for (SparseMatrix::InnerIterator it(matrix, columns[c]); it; ++it)
      if (position[it.row()] >= 0) out.insertBack(position[it.row()], static_cast<Index>(c)) = it.value();
  }
  out.finalize();
  return out;
}

}  // namespace signorini
