#include "explicit_system.hpp"

#include <algorithm>
#include <numeric>

#include "dense_kernels.hpp"

namespace signorini {
namespace {

constexpr int kDenseRows = 36;          // up to this size a dense factorisation is as fast as any
constexpr double kDenseShare = 0.6;     // of the blocks that are there, beyond which G is called dense
constexpr std::size_t kAnalyses = 16;   // patterns remembered
constexpr Index kFewEntries = 1 << 17;  // of L and U, up to which A is kept assembled in their place

}  // namespace

void ExplicitSystem::take_sizes(const ConstraintSets& sets) {
  sizes_.resize(static_cast<std::size_t>(sets.num_sets()));
  offsets_.resize(sizes_.size());
  for (Index i = 0; i < sets.num_sets(); ++i) {
    sizes_[i] = static_cast<int>(sets[i].size());
    offsets_[i] = static_cast<int>(sets[i].offset);
  }
  size_ = sets.size();
  active_.reserve(sizes_.size());  // what factor_reduced needs at most
  reduced_sizes_.reserve(sizes_.size());
  columns_.reserve(static_cast<std::size_t>(2 * size_));
  x_.reserve(static_cast<std::size_t>(size_));
  assembled_ = false;
  pivots_.reserve(static_cast<std::size_t>(size_));
}

void ExplicitSystem::reserve_fronts() {
  const Index count = analysis_->lu.num_factor_entries();
  if (count <= kFewEntries) fronts_.resize(static_cast<std::size_t>(count));
}

bool ExplicitSystem::same_pattern(const SparseMatrix& matrix, const ConstraintSets& sets) const {
  if (!sparse_ || static_cast<Index>(sparse_->sizes.size()) != sets.num_sets() ||
      static_cast<Index>(inner_.size()) != matrix.nonZeros())
    return false;
  for (Index i = 0; i < sets.num_sets(); ++i)
    if (sparse_->sizes[i] != sets[i].size()) return false;
  return std::equal(outer_.begin(), outer_.end(), matrix.outerIndexPtr()) &&
         std::equal(inner_.begin(), inner_.end(), matrix.innerIndexPtr());
}

void ExplicitSystem::analyze(const SparseMatrix& matrix, const ConstraintSets& sets) {
  const Index n = matrix.rows();
  if (!sparse_) sparse_ = std::make_unique<Analysis>();
  sparse_->sizes = sizes_;
  BlockLu& lu = sparse_->lu;
  std::vector<int> set_of(static_cast<std::size_t>(n));
  for (Index i = 0; i < sets.num_sets(); ++i)
    for (Index k = 0; k < sets[i].size(); ++k) set_of[sets[i].offset + k] = static_cast<int>(i);
  const int *outer = matrix.outerIndexPtr(), *inner = matrix.innerIndexPtr();
  BlockLists neighbours;
  neighbours.first.reserve(sizes_.size() + 1);
  neighbours.items.reserve(static_cast<std::size_t>(matrix.nonZeros() / 18));
  std::vector<int> mark(sizes_.size(), -1);
  for (int j = 0; j < static_cast<int>(sizes_.size()); ++j) {
    const int end = offsets_[j] + sizes_[j];
    for (int c = offsets_[j]; c < end; ++c)
      for (int q = outer[c + 1] - 1; q >= outer[c] && inner[q] >= end; --q) {
        const int i = set_of[inner[q]];
        if (mark[i] != j) mark[i] = j, neighbours.items.push_back(i);
      }
    std::sort(neighbours.items.begin() + neighbours.first[j], neighbours.items.end());
    neighbours.first.push_back(static_cast<int>(neighbours.items.size()));
  }
  lu.analyze(sizes_, neighbours);
  sparse_->find_columns();

  // Where the entries of G land.
  outer_.assign(outer, outer + n + 1);
  inner_.assign(inner, inner + matrix.nonZeros());
  runs_.clear();
  runs_.reserve(inner_.size() / 2);
  std::vector<Index> start(sizes_.size());  // of block (i, j), for the j at hand
  for (int j = 0; j < static_cast<int>(sizes_.size()); ++j) {
    for (int k = sparse_->first_column_block[j]; k < sparse_->first_column_block[j + 1]; ++k)
      start[sparse_->column_blocks[k].i] = sparse_->column_blocks[k].start;
    for (int c = 0; c < sizes_[j]; ++c)
      for (int q = outer_[offsets_[j] + c], last = outer_[offsets_[j] + c + 1]; q < last;) {
        const int row = inner_[q], i = set_of[row], end = offsets_[i] + sizes_[i];
        int count = 1;
        while (q + count < last && row + count < end && inner_[q + count] == row + count) ++count;
        Run& run = runs_.emplace_back();
        run.target = start[i] + static_cast<Index>(c) * sizes_[i] + (row - offsets_[i]);
        run.count = count;
        q += count;
      }
  }
}

void ExplicitSystem::setup(const SparseMatrix& matrix, const ConstraintSets& sets, const ConstVectorRef& scale,
                           const ConstVectorRef& compliance) {
  take_sizes(sets);
  if (!same_pattern(matrix, sets)) analyze(matrix, sets);
  dense_ = false;
  analysis_ = sparse_.get();
  reserve_fronts();
  a_.resize(analysis_->lu.values().size());
  std::fill(a_.begin(), a_.end(), 0.0);
  const double* values = matrix.valuePtr();
  const Run* run = runs_.data();
  for (Index c = 0; c < matrix.cols(); ++c)
    for (int q = outer_[c]; q < outer_[c + 1]; q += run++->count) {
      const double factor = scale[inner_[q]] * scale[c], *from = values + q;
      double* to = a_.data() + run->target;
      if (run->count == 3)  // by far the most
        to[0] = factor * from[0], to[1] = factor * from[1], to[2] = factor * from[2];
      else
        for (int k = 0; k < run->count; ++k) to[k] = factor * from[k];
    }
  for (const BlockLu::Pair& pair : analysis_->lu.pairs()) {
    if (pair.i != pair.j) continue;
    const int size = sizes_[pair.i], o = offsets_[pair.i];
    for (int k = 0; k < size; ++k) a_[pair.lower + k * size + k] += compliance[o + k] * scale[o + k] * scale[o + k];
  }
}

void ExplicitSystem::setup(const double* matrix, const ConstraintSets& sets, const ConstVectorRef& scale,
                           const ConstVectorRef& compliance) {
  take_sizes(sets);
  dense_ = true;
  const Index n = size_;
  a_.resize(static_cast<std::size_t>(n * n));
  k_.reserve(a_.size());
  double* to = a_.data();
  for (Index c = 0; c < n; ++c, matrix += n, to += n) {
    const double factor = scale[c];
    for (Index r = 0; r < n; ++r) to[r] = matrix[r] * (factor * scale[r]);
    to[c] += compliance[c] * factor * factor;
  }
}

void ExplicitSystem::Analysis::find_columns() {
  first_column_block.assign(sizes.size() + 1, 0);
  for (const BlockLu::Pair& pair : lu.pairs()) {
    ++first_column_block[pair.j + 1];
    if (pair.i != pair.j) ++first_column_block[pair.i + 1];
  }
  for (std::size_t k = 0; k < sizes.size(); ++k) first_column_block[k + 1] += first_column_block[k];
  column_blocks.resize(static_cast<std::size_t>(first_column_block.back()));
  row_blocks.resize(column_blocks.size());
  std::vector<int> next(first_column_block.begin(), first_column_block.end() - 1);
  for (const BlockLu::Pair& pair : lu.pairs()) {
    row_blocks[next[pair.j]] = {3 * pair.i, pair.upper};
    column_blocks[next[pair.j]++] = {pair.i, pair.lower};
    if (pair.i == pair.j) continue;
    row_blocks[next[pair.i]] = {3 * pair.j, pair.lower};
    column_blocks[next[pair.i]++] = {pair.j, pair.upper};
  }
  if (std::any_of(sizes.begin(), sizes.end(), [](int size) { return size != 3; })) row_blocks.clear();
}

void ExplicitSystem::find_analysis() {
  const auto matches = [this](const Analysis& analysis) {
    if (analysis.sizes != sizes_ || analysis.pattern.size() != 2 * blocks.size()) return false;
    for (std::size_t k = 0; k < blocks.size(); ++k)
      if (analysis.pattern[2 * k] != blocks[k].i || analysis.pattern[2 * k + 1] != blocks[k].j) return false;
    return true;
  };
  ++uses_;
  if (analysis_ && analysis_ != sparse_.get() && matches(*analysis_)) {
    analysis_->last_use = uses_;
    return;
  }
  Analysis* oldest = nullptr;
  for (const auto& analysis : analyses_) {
    if (matches(*analysis)) {
      analysis_ = analysis.get();
      analysis_->last_use = uses_;
      return;
    }
    if (!oldest || analysis->last_use < oldest->last_use) oldest = analysis.get();
  }
  if (analyses_.size() < kAnalyses) {
    analyses_.push_back(std::make_unique<Analysis>());
    oldest = analyses_.back().get();
  }
  analysis_ = oldest;
  analysis_->last_use = uses_;
  analysis_->sizes = sizes_;
  analysis_->pattern.clear();
  BlockLists neighbours;
  neighbours.first.assign(sizes_.size() + 1, 0);
  for (const Block& block : blocks) {
    analysis_->pattern.push_back(block.i);
    analysis_->pattern.push_back(block.j);
    ++neighbours.first[block.j + 1];
  }
  std::partial_sum(neighbours.first.begin(), neighbours.first.end(), neighbours.first.begin());
  neighbours.items.resize(blocks.size());
  std::vector<int> next(neighbours.first.begin(), neighbours.first.end() - 1);
  for (const Block& block : blocks) neighbours.items[next[block.j]++] = block.i;
  BlockLu& lu = analysis_->lu;
  lu.analyze(sizes_, neighbours);
  analysis_->find_columns();
  // lu.pairs() goes by j, then i; blocks by i, then j.
  analysis_->diagonal_place.resize(sizes_.size());
  for (std::size_t k = 0; k < lu.pairs().size(); ++k)
    if (lu.pairs()[k].i == lu.pairs()[k].j) {
      analysis_->diagonal_place[lu.pairs()[k].j] = static_cast<int>(k);
      next[lu.pairs()[k].j] = static_cast<int>(k) + 1;
    }
  analysis_->place.resize(blocks.size());
  for (std::size_t k = 0; k < blocks.size(); ++k) analysis_->place[k] = next[blocks[k].j]++;
}

bool ExplicitSystem::is_dense(Index rows, Index num_sets, std::size_t num_blocks) {
  const auto count = static_cast<double>(num_sets);
  return rows <= kDenseRows || static_cast<double>(num_blocks) >= kDenseShare * 0.5 * count * (count - 1.0);
}

void ExplicitSystem::setup(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance) {
  take_sizes(sets);
  dense_ = is_dense(size_, sets.num_sets(), blocks.size());
  if (dense_) {
    const auto count = static_cast<double>(sizes_.size());
    const auto n = static_cast<int>(size_);
    a_.resize(static_cast<std::size_t>(n) * n);
    k_.reserve(a_.size());
    if (static_cast<double>(blocks.size()) < 0.5 * count * (count - 1.0)) std::fill(a_.begin(), a_.end(), 0.0);
    for (std::size_t i = 0; i < sizes_.size(); ++i) {
      const int o = offsets_[i], size = sizes_[i];
      const double factor = scale[o] * scale[o];
      double* to = a_.data() + static_cast<std::size_t>(o) * n + o;
      const double* from = diagonal[i];
      const int step = stride ? stride : size;
      for (int c = 0; c < size; ++c) {
        for (int r = c; r < size; ++r) to[c * n + r] = to[r * n + c] = factor * from[c * step + r];
        to[c * n + c] += factor * compliance[o + c];
      }
    }
    for (const Block& block : blocks) {
      const int oi = offsets_[block.i], oj = offsets_[block.j], ni = sizes_[block.i], nj = sizes_[block.j];
      const double factor = scale[oi] * scale[oj];
      double* lower = a_.data() + static_cast<std::size_t>(oj) * n + oi;
      double* upper = a_.data() + static_cast<std::size_t>(oi) * n + oj;
      const int step = stride ? stride : ni;
      for (int c = 0; c < nj; ++c)
        for (int r = 0; r < ni; ++r) lower[c * n + r] = upper[r * n + c] = factor * block.values[c * step + r];
    }
    return;
  }
  find_analysis();
  reserve_fronts();
  const std::vector<BlockLu::Pair>& pairs = analysis_->lu.pairs();
  a_.resize(analysis_->lu.values().size());
  for (std::size_t i = 0; i < sizes_.size(); ++i) {
    const int o = offsets_[i], size = sizes_[i];
    const double factor = scale[o] * scale[o];
    double* to = a_.data() + pairs[analysis_->diagonal_place[i]].lower;
    const int step = stride ? stride : size;
    for (int c = 0; c < size; ++c) {
      for (int r = c; r < size; ++r) to[c * size + r] = to[r * size + c] = factor * diagonal[i][c * step + r];
      to[c * size + c] += factor * compliance[o + c];
    }
  }
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    const Block& block = blocks[k];
    const BlockLu::Pair& pair = pairs[analysis_->place[k]];
    const int ni = sizes_[block.i], nj = sizes_[block.j];
    const double factor = scale[offsets_[block.i]] * scale[offsets_[block.j]];
    double *lower = a_.data() + pair.lower, *upper = a_.data() + pair.upper;
    const int step = stride ? stride : ni;
    for (int c = 0; c < nj; ++c)
      for (int r = 0; r < ni; ++r) lower[c * ni + r] = upper[r * nj + c] = factor * block.values[c * step + r];
  }
}

void ExplicitSystem::apply(const ConstVectorRef& x, VectorRef y) const {
  if (dense_) {
    const auto n = static_cast<int>(size_);
    dense_kernels().multiply(n, n, a_.data(), n, x.data(), y.data());
    return;
  }
  if (!analysis_->row_blocks.empty()) {
    dense_kernels().multiply_blocks(static_cast<int>(sizes_.size()), analysis_->first_column_block.data(),
                                    analysis_->row_blocks.data(), a_.data(), x.data(), y.data());
    return;
  }
  y.setZero();
  for (const BlockLu::Pair& pair : analysis_->lu.pairs()) {
    const double* a = a_.data() + pair.lower;
    const int ni = sizes_[pair.i], nj = sizes_[pair.j];
    const double* xi = x.data() + offsets_[pair.i];
    double* yi = y.data() + offsets_[pair.i];
    if (pair.i != pair.j) {
      add_block_products(ni, nj, a, xi, x.data() + offsets_[pair.j], yi, y.data() + offsets_[pair.j]);
      continue;
    }
    add_block_product(ni, nj, a, xi, yi);
  }
}

namespace {

/// to = Y from, both rows x columns with the given strides between columns, where Y acts on the block row.
inline void multiply(const Eigen::Matrix3d& y, const double* from, double* to, int rows, int columns, int stride) {
  if (rows == 3) {
    for (int c = 0; c < columns; ++c, from += stride, to += stride) {
      const double f0 = from[0], f1 = from[1], f2 = from[2];
      to[0] = y(0, 0) * f0 + y(0, 1) * f1 + y(0, 2) * f2;
      to[1] = y(1, 0) * f0 + y(1, 1) * f1 + y(1, 2) * f2;
      to[2] = y(2, 0) * f0 + y(2, 1) * f1 + y(2, 2) * f2;
    }
  } else {
    for (int c = 0; c < columns; ++c) to[c * stride] = y(0, 0) * from[c * stride];
  }
}

inline void add_block(const Eigen::Matrix3d& x, double* to, int size, int stride) {
  for (int c = 0; c < size; ++c)
    for (int r = 0; r < size; ++r) to[c * stride + r] += x(r, c);
}

}  // namespace

Eigen::Matrix3d ExplicitSystem::diagonal_block(Index set) const {
  const int size = sizes_[set];
  const double* a = a_.data();
  int step = size;
  if (dense_) {
    step = static_cast<int>(size_);
    a += static_cast<std::size_t>(offsets_[set]) * (step + 1);
  } else {
    for (int k = analysis_->first_column_block[set];; ++k)
      if (analysis_->column_blocks[k].i == set) {
        a += analysis_->column_blocks[k].start;
        break;
      }
  }
  Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
  for (int c = 0; c < size; ++c)
    for (int r = 0; r < size; ++r) block(r, c) = a[c * step + r];
  return block;
}

bool ExplicitSystem::list_columns(std::vector<int>& first, std::vector<ColumnBlock>& columns) const {
  if (dense_) return false;
  first = analysis_->first_column_block;
  columns.clear();
  for (const Analysis::Place& place : analysis_->column_blocks) columns.push_back({place.i, a_.data() + place.start});
  return true;
}

void ScaledDelassus::extract(const std::vector<int>& first, const std::vector<ColumnBlock>& blocks,
                             const std::vector<int>& part, const ConstraintSets& part_sets,
                             std::unique_ptr<ScaledDelassus>& system) {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->stride = 0;
  known->local.resize(first.size());
  known->diagonal.resize(part.size());
  known->blocks.clear();
  const auto count = static_cast<int>(part.size());
  for (int j = 0; j < count; ++j) known->local[part[j]] = j;
  for (int j = 0; j < count; ++j)
    for (int c = first[part[j]]; c < first[part[j] + 1]; ++c) {
      const ColumnBlock& block = blocks[c];
      const int i = known->local[block.set];  // which an earlier part may have left
      if (i < 0 || i >= count || part[i] != block.set) continue;
      if (i == j) known->diagonal[j] = block.values;
      if (i > j) known->blocks.push_back({i, j, block.values});
    }
  std::sort(known->blocks.begin(), known->blocks.end(),
            [](const ExplicitSystem::Block& a, const ExplicitSystem::Block& b) {
              return a.i != b.i ? a.i < b.i : a.j < b.j;
            });
  known->setup(part_sets, Vector::Ones(part_sets.size()), Vector::Zero(part_sets.size()));
}

void ExplicitSystem::add_columns(Index set, const double* x, double* y) const {
  if (dense_) {
    const auto n = static_cast<int>(size_);
    const double* a = a_.data() + static_cast<std::size_t>(offsets_[set]) * n;
    if (sizes_[set] == 3) return dense_kernels().add_three(n, a, n, x, y);
    for (int r = 0; r < n; ++r) y[r] += a[r] * x[0];
    return;
  }
  const Analysis::Place* end = analysis_->column_blocks.data() + analysis_->first_column_block[set + 1];
  for (const Analysis::Place* b = analysis_->column_blocks.data() + analysis_->first_column_block[set]; b != end; ++b)
    add_block_product(sizes_[b->i], sizes_[set], a_.data() + b->start, x, y + offsets_[b->i]);
}

bool ExplicitSystem::factor_dense() {
  symmetric_ = false;
  pivots_.resize(static_cast<std::size_t>(rows_));
  x_.resize(static_cast<std::size_t>(std::max(rows_, size_)));
  sign_ = rows_ == 0 ? 1
                     : dense_kernels().factor_front(static_cast<int>(rows_), 0, k_.data(), nullptr, nullptr,
                                                    pivots_.data(), false);
  return sign_ != 0;
}

bool ExplicitSystem::factor(const BlockDiagonal& x, const BlockDiagonal& y) {
  if (dense_) {
    const auto n = static_cast<int>(size_);
    k_.resize(a_.size());
    for (std::size_t i = 0; i < sizes_.size(); ++i) {
      const int o = offsets_[i];
      multiply(y[i], a_.data() + o, k_.data() + o, sizes_[i], n, n);
      add_block(x[i], k_.data() + static_cast<std::size_t>(o) * n + o, sizes_[i], n);
    }
    rows_ = size_;
    return factor_dense();
  }
  BlockLu& lu = analysis_->lu;
  lu.set_sizes(sizes_);
  double* k = lu.values().data();
  for (const BlockLu::Pair& pair : lu.pairs()) {
    const int ni = sizes_[pair.i], nj = sizes_[pair.j];
    multiply(y[pair.i], a_.data() + pair.lower, k + pair.lower, ni, nj, ni);
    if (pair.i == pair.j)
      add_block(x[pair.i], k + pair.lower, ni, ni);
    else
      multiply(y[pair.j], a_.data() + pair.upper, k + pair.upper, nj, ni, nj);
  }
  return lu.factor();
}

bool ExplicitSystem::factor(const BlockDiagonal& x, bool rough) {
  if (dense_) {
    const auto n = static_cast<int>(size_);
    k_.resize(a_.size());
    std::copy(a_.begin(), a_.end(), k_.begin());
    for (std::size_t i = 0; i < sizes_.size(); ++i)
      add_block(x[i], k_.data() + static_cast<std::size_t>(offsets_[i]) * n + offsets_[i], sizes_[i], n);
    rows_ = size_;
    return factor_dense();
  }
  BlockLu& lu = analysis_->lu;
  lu.set_sizes(sizes_);
  if (lu.num_factor_entries() <= kFewEntries) {
    if (!assembled_) {
      lu.assemble(a_.data(), fronts_.data());
      assembled_ = true;
    }
    return lu.factor(fronts_.data(), x, rough);
  }
  std::copy(a_.begin(), a_.end(), lu.values().begin());
  for (const BlockLu::Pair& pair : lu.pairs())
    if (pair.i == pair.j) add_block(x[pair.i], lu.values().data() + pair.lower, sizes_[pair.i], sizes_[pair.i]);
  return lu.factor();
}

void ExplicitSystem::solve(VectorRef rhs) const {
  if (!dense_) return analysis_->lu.solve(rhs);
  if (size_ == 0) return;
  const auto n = static_cast<int>(size_);
  const DenseKernels& kernels = dense_kernels();
  kernels.forward(n, 0, k_.data(), pivots_.data(), rhs.data(), nullptr);
  kernels.backward(n, 0, k_.data(), nullptr, rhs.data(), nullptr);
}

// The reduced matrix E^T A F + delta I + weights (T35). Across a slip in direction u, E and F keep v = (-u1, u0); of
// the normal, E keeps the row, F the column plus friction times the column along u.

namespace {

/// to (ri x rj) = E_i^T a F_j, for the block a, ni x nj, of two sets that keep ri and rj rows; the columns of
/// `to` are `stride` apart.
inline void reduce_block(const ReducedSet& left, const ReducedSet& right, int rj, const double* a, int ni, double* to,
                         int stride) {
  using Kind = ReducedSet::Kind;
  double across[3], normal[3];
  const double* columns[3] = {a, a + ni, a + 2 * ni};
  if (right.kind == Kind::Slip) {
    for (int r = 0; r < ni; ++r) {
      across[r] = right.u0 * a[ni + r] - right.u1 * a[r];
      normal[r] = right.friction * (right.u0 * a[r] + right.u1 * a[ni + r]) + a[2 * ni + r];
    }
    columns[0] = across, columns[1] = normal;
  } else if (right.kind == Kind::Normal) {
    columns[0] = a + 2 * ni;
  }
  for (int c = 0; c < rj; ++c, to += stride) {
    const double* from = columns[c];
    switch (left.kind) {
      case Kind::Stick:
        to[0] = from[0], to[1] = from[1], to[2] = from[2];
        break;
      case Kind::Slip:
        to[0] = left.u0 * from[1] - left.u1 * from[0], to[1] = from[2];
        break;
      case Kind::Normal:
        to[0] = from[2];
        break;
      default:
        to[0] = from[0];
    }
  }
}

}  // namespace

bool ExplicitSystem::factor_reduced(const std::vector<ReducedSet>& sets, double delta) {
  using Kind = ReducedSet::Kind;
  active_.clear();
  reduced_sizes_.resize(sets.size());
  int row = 0;
  bool symmetric = true;
  for (std::size_t i = 0; i < sets.size(); ++i) {
    const ReducedSet& set = sets[i];
    const int size = set.kind == Kind::Stick ? 3 : set.kind == Kind::Slip ? 2 : set.kind == Kind::Fixed ? 0 : 1;
    reduced_sizes_[i] = size;
    if (size == 0) continue;
    if (set.kind == Kind::Slip && set.friction != 0.0) symmetric = false;
    active_.push_back({set.kind, offsets_[i], row, set.u0, set.u1, set.friction, set.weight});
    row += size;
  }
  rows_ = row;
  if (dense_) {
    const auto n = static_cast<int>(rows_);
    reduce_dense(delta);
    if (n == 0) return true;
    symmetric_ = symmetric && dense_kernels().factor_symmetric_front(n, 0, k_.data(), nullptr, nullptr) != 0;
    if (symmetric_) {
      x_.resize(static_cast<std::size_t>(n));
      return true;
    }
    if (symmetric) reduce_dense(delta);
    return factor_dense();
  }
  BlockLu& lu = analysis_->lu;
  lu.set_sizes(reduced_sizes_);
  const auto write = [&](int i, int j, Index from, double* to, int n) {
    const ReducedSet& left = sets[i];
    reduce_block(left, sets[j], reduced_sizes_[j], a_.data() + from, sizes_[i], to, n);
    if (i != j) return;
    for (int r = 0; r < reduced_sizes_[i]; ++r) to[r * (n + 1)] += delta;
    if (left.kind == Kind::Slip) to[0] += left.weight;
  };
  return (symmetric && lu.factor_symmetric(write)) || lu.factor(write);
}

void ExplicitSystem::solve_reduced(VectorRef rhs) const {
  if (rows_ == 0) return;
  if (!dense_) return analysis_->lu.solve(rhs);
  const auto n = static_cast<int>(rows_);
  double* x = x_.data();
  for (const Active& s : active_)
    for (int r = 0; r < s.size(); ++r) x[s.row + r] = rhs[s.offset + r];
  const DenseKernels& kernels = dense_kernels();
  kernels.forward(n, 0, k_.data(), symmetric_ ? nullptr : pivots_.data(), x, nullptr);
  kernels.backward(n, 0, k_.data(), nullptr, x, nullptr);
  for (const Active& s : active_)
    for (int r = 0; r < s.size(); ++r) rhs[s.offset + r] = x[s.row + r];
}

void ExplicitSystem::reduce_dense(double delta) {
  const auto n = static_cast<int>(size_), m = static_cast<int>(rows_);
  k_.resize(static_cast<std::size_t>(m) * m);
  columns_.resize(static_cast<std::size_t>(2 * n));
  double* to = k_.data();
  const auto add_column = [&](const double* from) {
    for (const Active& s : active_) {
      const double* a = from + s.offset;
      switch (s.kind) {
        case ReducedSet::Kind::Stick:
          to[0] = a[0], to[1] = a[1], to[2] = a[2];
          to += 3;
          break;
        case ReducedSet::Kind::Slip:
          to[0] = s.u0 * a[1] - s.u1 * a[0], to[1] = a[2];
          to += 2;
          break;
        case ReducedSet::Kind::Normal:
          *to++ = a[2];
          break;
        default:
          *to++ = a[0];
      }
    }
  };
  for (const Active& s : active_) {
    const double* a = a_.data() + static_cast<std::size_t>(s.offset) * n;
    switch (s.kind) {
      case ReducedSet::Kind::Stick:
        add_column(a), add_column(a + n), add_column(a + 2 * n);
        break;
      case ReducedSet::Kind::Slip: {
        double *across = columns_.data(), *normal = across + n;
        const double f0 = s.friction * s.u0, f1 = s.friction * s.u1;
        for (int r = 0; r < n; ++r) {
          across[r] = s.u0 * a[n + r] - s.u1 * a[r];
          normal[r] = f0 * a[r] + f1 * a[n + r] + a[2 * n + r];
        }
        add_column(across), add_column(normal);
        k_[static_cast<std::size_t>(s.row) * m + s.row] += s.weight;
        break;
      }
      case ReducedSet::Kind::Normal:
        add_column(a + 2 * n);
        break;
      default:
        add_column(a);
    }
  }
  for (int r = 0; r < m; ++r) k_[static_cast<std::size_t>(r) * m + r] += delta;
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
