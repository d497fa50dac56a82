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

IslandForest::IslandForest(int count, std::vector<int>& labels) : labels_(labels), trees_(count) {
  labels_.resize(static_cast<std::size_t>(count));
  std::iota(labels_.begin(), labels_.end(), 0);
}

void IslandForest::join(int i, int j) {
  if (labels_[i] == labels_[j]) return;
  i = root(i), j = root(j);
  if (i == j) return;
  labels_[i > j ? i : j] = i > j ? j : i;
  --trees_;
}

void IslandForest::finish() {
  // Roots first: a set's root has a lower number, and so has its label by the time it is asked for.
  int next = 0;
  for (int& label : labels_) label = &label - labels_.data() == label ? next++ : labels_[label];
}

std::vector<int> islands_of(const SparseMatrix& matrix, const ConstraintSets& sets) {
  std::vector<int> set_of(static_cast<std::size_t>(sets.size()));
  int index = 0;
  for (const ConstraintSet& set : sets) {
    for (Index k = 0; k < set.size(); ++k) set_of[set.offset + k] = index;
    ++index;
  }
  std::vector<int> labels;
  IslandForest forest(static_cast<int>(sets.num_sets()), labels);
  const int *outer = matrix.outerIndexPtr(), *inner = matrix.innerIndexPtr();
  for (Index c = 0; c < matrix.outerSize() && forest.trees() > 1; ++c) {
    const int own = set_of[c];
    int last = own;  // rows of a set follow each other
    for (int q = outer[c]; q < outer[c + 1] && inner[q] < c; ++q) {
      const int set = set_of[inner[q]];
      if (set != last) forest.join(set, own);
      last = set;
    }
  }
  forest.finish();
  return labels;
}

SparseMatrix select(const SparseMatrix& matrix, const std::vector<Index>& rows, const std::vector<Index>& columns) {
  // Where each row goes, -1 between the calls: a small part of a large matrix, of which there may be many, costs
  // little.
  thread_local std::vector<int> position;
  if (position.size() < static_cast<std::size_t>(matrix.rows())) position.resize(matrix.rows(), -1);
  SparseMatrix out(static_cast<Index>(rows.size()), static_cast<Index>(columns.size()));
  Index count = 0;
  for (const Index c : columns) count += matrix.outerIndexPtr()[c + 1] - matrix.outerIndexPtr()[c];
  out.reserve(count);
  for (std::size_t r = 0; r < rows.size(); ++r) position[rows[r]] = static_cast<int>(r);
  for (std::size_t c = 0; c < columns.size(); ++c) {
    out.startVec(static_cast<Index>(c));
    for (SparseMatrix::InnerIterator it(matrix, columns[c]); it; ++it)
      if (position[it.row()] >= 0) out.insertBack(position[it.row()], static_cast<Index>(c)) = it.value();
  }
  for (const Index r : rows) position[r] = -1;
  out.finalize();
  return out;
}

}  // namespace signorini
