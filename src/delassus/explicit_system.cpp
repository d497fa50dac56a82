#include "explicit_system.hpp"

#include <algorithm>

namespace signorini {

bool ExplicitSystem::same_pattern(const SparseMatrix& matrix, const ConstraintSets& sets) const {
  if (static_cast<Index>(sizes_.size()) != sets.num_sets() || static_cast<Index>(inner_.size()) != matrix.nonZeros())
    return false;
  for (Index i = 0; i < sets.num_sets(); ++i)
    if (sizes_[i] != sets[i].size()) return false;
  return std::equal(outer_.begin(), outer_.end(), matrix.outerIndexPtr()) &&
         std::equal(inner_.begin(), inner_.end(), matrix.innerIndexPtr());
}

void ExplicitSystem::analyze(const SparseMatrix& matrix, const ConstraintSets& sets) {
  const Index n = matrix.rows();
  sizes_.clear();
  offsets_.clear();
  std::vector<int> set_of(static_cast<std::size_t>(n));
  for (const ConstraintSet& set : sets) {
    for (Index k = 0; k < set.size(); ++k) set_of[set.offset + k] = static_cast<int>(sizes_.size());
    sizes_.push_back(static_cast<int>(set.size()));
    offsets_.push_back(static_cast<int>(set.offset));
  }
  std::vector<std::vector<int>> neighbours(sizes_.size());
  std::vector<int> mark(sizes_.size(), -1);
  for (int j = 0; j < static_cast<int>(sizes_.size()); ++j) {
    mark[j] = j;
    for (int c = offsets_[j]; c < offsets_[j] + sizes_[j]; ++c)
      for (SparseMatrix::InnerIterator it(matrix, c); it; ++it) {
        const int i = set_of[it.row()];
        if (i > j && mark[i] != j) mark[i] = j, neighbours[j].push_back(i);
      }
    std::sort(neighbours[j].begin(), neighbours[j].end());
  }
  lu_.analyze(sizes_, neighbours);

  // Where each entry of G lands.
  outer_.assign(matrix.outerIndexPtr(), matrix.outerIndexPtr() + n + 1);
  inner_.assign(matrix.innerIndexPtr(), matrix.innerIndexPtr() + matrix.nonZeros());
  targets_.assign(inner_.size(), -1);
  // Pairs by their smaller block are contiguous; by their larger one they are chained.
  const auto& pairs = lu_.pairs();
  const auto num_pairs = static_cast<int>(pairs.size());
  std::vector<int> first(sizes_.size(), -1), next(pairs.size(), -1);
  for (int k = num_pairs - 1; k >= 0; --k) {
    next[k] = first[pairs[k].i];
    first[pairs[k].i] = k;
  }
  std::vector<Index> base(sizes_.size());  // where block (i, j) starts, for the j at hand
  int pair = 0;
  for (int j = 0; j < static_cast<int>(sizes_.size()); ++j) {
    for (int k = first[j]; k >= 0; k = next[k]) base[pairs[k].j] = pairs[k].upper;
    for (; pair < num_pairs && pairs[pair].j == j; ++pair) base[pairs[pair].i] = pairs[pair].lower;
    for (int c = 0; c < sizes_[j]; ++c)
      for (int q = outer_[offsets_[j] + c]; q < outer_[offsets_[j] + c + 1]; ++q) {
        const int i = set_of[inner_[q]];
        targets_[q] = base[i] + static_cast<Index>(c) * sizes_[i] + (inner_[q] - offsets_[i]);
      }
  }
}

void ExplicitSystem::setup(const SparseMatrix& matrix, const ConstraintSets& sets, const ConstVectorRef& scale,
                           const ConstVectorRef& compliance) {
  if (!same_pattern(matrix, sets)) analyze(matrix, sets);
  a_.assign(lu_.values().size(), 0.0);
  const double* values = matrix.valuePtr();
  for (Index c = 0; c < matrix.cols(); ++c)
    for (int q = outer_[c]; q < outer_[c + 1]; ++q) a_[targets_[q]] = values[q] * scale[inner_[q]] * scale[c];
  for (const BlockLu::Pair& pair : lu_.pairs()) {
    if (pair.i != pair.j) continue;
    const int size = sizes_[pair.i], o = offsets_[pair.i];
    for (int k = 0; k < size; ++k) a_[pair.lower + k * size + k] += compliance[o + k] * scale[o + k] * scale[o + k];
  }
}

void ExplicitSystem::apply(const ConstVectorRef& x, VectorRef y) const {
  y.setZero();
  for (const BlockLu::Pair& pair : lu_.pairs()) {
    const double* a = a_.data() + pair.lower;
    const int ni = sizes_[pair.i], nj = sizes_[pair.j];
    const double* xi = x.data() + offsets_[pair.i];
    const double* xj = x.data() + offsets_[pair.j];
    double* yi = y.data() + offsets_[pair.i];
    double* yj = y.data() + offsets_[pair.j];
    if (ni == 3 && nj == 3) {
      yi[0] += a[0] * xj[0] + a[3] * xj[1] + a[6] * xj[2];
      yi[1] += a[1] * xj[0] + a[4] * xj[1] + a[7] * xj[2];
      yi[2] += a[2] * xj[0] + a[5] * xj[1] + a[8] * xj[2];
      if (pair.i == pair.j) continue;
      yj[0] += a[0] * xi[0] + a[1] * xi[1] + a[2] * xi[2];
      yj[1] += a[3] * xi[0] + a[4] * xi[1] + a[5] * xi[2];
      yj[2] += a[6] * xi[0] + a[7] * xi[1] + a[8] * xi[2];
      continue;
    }
    for (int c = 0; c < nj; ++c)
      for (int r = 0; r < ni; ++r) {
        yi[r] += a[c * ni + r] * xj[c];
        if (pair.i != pair.j) yj[c] += a[c * ni + r] * xi[r];
      }
  }
}

namespace {

/// to (rows x columns) = Y from, where Y acts on the block row.
inline void multiply(const Eigen::Matrix3d& y, const double* from, double* to, int rows, int columns) {
  if (rows == 3) {
    for (int c = 0; c < columns; ++c, from += 3, to += 3) {
      const double f0 = from[0], f1 = from[1], f2 = from[2];
      to[0] = y(0, 0) * f0 + y(0, 1) * f1 + y(0, 2) * f2;
      to[1] = y(1, 0) * f0 + y(1, 1) * f1 + y(1, 2) * f2;
      to[2] = y(2, 0) * f0 + y(2, 1) * f1 + y(2, 2) * f2;
    }
  } else {
    for (int c = 0; c < columns; ++c) to[c] = y(0, 0) * from[c];
  }
}

inline void add_block(const Eigen::Matrix3d& x, double* to, int size) {
  for (int c = 0; c < size; ++c)
    for (int r = 0; r < size; ++r) to[c * size + r] += x(r, c);
}

}  // namespace

bool ExplicitSystem::factor(const BlockDiagonal& x, const BlockDiagonal& y) {
  double* k = lu_.values().data();
  for (const BlockLu::Pair& pair : lu_.pairs()) {
    const int ni = sizes_[pair.i], nj = sizes_[pair.j];
    multiply(y[pair.i], a_.data() + pair.lower, k + pair.lower, ni, nj);
    if (pair.i == pair.j)
      add_block(x[pair.i], k + pair.lower, ni);
    else
      multiply(y[pair.j], a_.data() + pair.upper, k + pair.upper, nj, ni);
  }
  return lu_.factor();
}

bool ExplicitSystem::factor(const BlockDiagonal& x) {
  std::copy(a_.begin(), a_.end(), lu_.values().begin());
  for (const BlockLu::Pair& pair : lu_.pairs())
    if (pair.i == pair.j) add_block(x[pair.i], lu_.values().data() + pair.lower, sizes_[pair.i]);
  return lu_.factor();
}

double asymmetry_of(const SparseMatrix& matrix) {
  double largest = 0.0, difference = 0.0;
  const SparseMatrix transpose = matrix.transpose();
  const SparseMatrix odd = matrix - transpose;
  for (Index c = 0; c < matrix.outerSize(); ++c) {
    for (SparseMatrix::InnerIterator it(matrix, c); it; ++it) largest = std::max(largest, std::abs(it.value()));
    for (SparseMatrix::InnerIterator it(odd, c); it; ++it) difference = std::max(difference, std::abs(it.value()));
  }
  return largest > 0.0 ? difference / largest : 0.0;
}

}  // namespace signorini
