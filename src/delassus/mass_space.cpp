#include "signorini/delassus/mass_space.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "block_lu.hpp"
#include "explicit_system.hpp"
#include "islands.hpp"
#include "require.hpp"
#include "twofold_cholesky.hpp"

namespace signorini {
namespace {

constexpr double kUnsymmetric = 1e-6;  // |M - M^T| over the root of the two entries of the diagonal
// Reciprocal condition of M scaled to diagonal 1: below the first the rounding of M itself would decide G; below the
// second M^-1 J^T would be off by more than 1e-12 of itself.
constexpr double kSingular = 1e-15, kIllConditioned = 1e-4;

/// Half a matrix is never meant, but easily passed.
void require_symmetric(const SparseMatrix& mass, const SparseMatrix& transpose) {
  const Vector diagonal = mass.diagonal();
  const SparseMatrix odd = mass - transpose;
  for (Index c = 0; c < odd.cols(); ++c)
    for (SparseMatrix::InnerIterator it(odd, c); it; ++it) {
      const double allowed = kUnsymmetric * std::sqrt(std::abs(diagonal[it.row()] * diagonal[c]));
      if (std::abs(it.value()) <= allowed) continue;
      const std::string i = std::to_string(it.row()), k = std::to_string(c);
      throw InvalidInput("mass", "has M[" + i + ", " + k + "] = " + in_full(mass.coeff(it.row(), c)) + " and M[" + k +
                                     ", " + i + "] = " + in_full(transpose.coeff(it.row(), c)) +
                                     ", must be symmetric, to 1e-6 of the root of their diagonal entries");
    }
}

/// Of m scaled to diagonal 1, as a free body's metres and radians do not matter.
double reciprocal_condition(Matrix m) {
  const Vector root = m.diagonal().cwiseSqrt().cwiseInverse();
  m = root.asDiagonal() * m * root.asDiagonal();
  const Eigen::LLT<Matrix> cholesky(m);
  return cholesky.info() == Eigen::Success ? cholesky.rcond() : 0.0;
}

int num_rows(ReducedSet::Kind kind) {
  using Kind = ReducedSet::Kind;
  return kind == Kind::Stick ? 3 : kind == Kind::Slip ? 2 : kind == Kind::Fixed ? 0 : 1;
}

/// With Js = S J and X' = X + Y S R S, the solution d of (X + Y A) d = r is (Woodbury; docs/theory.md, T38)
///     N w = Js' X'^-1 r,   d = X'^-1 (r - Y Js w),   N = M + Js' X'^-1 Y Js,
/// and the reduced system (T35) likewise, with E, F and its diagonal for Y and X'.
class MassSpaceSystem final : public ScaledDelassus {
 public:
  void setup(const SparseMatrix& mass, const SparseMatrix& jacobian, const SparseMatrix& inverse_mass_jacobian,
             const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance);

  Index size() const override { return damping_.size(); }
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  bool factor(const BlockDiagonal& x, const BlockDiagonal& y) override { return factor(x, &y); }
  bool factor(const BlockDiagonal& x, bool /*rough*/ = false) override { return factor(x, nullptr); }
  int determinant_sign() const override { return sign_; }
  void solve(VectorRef rhs) const override;
  bool reduces() const override { return true; }
  bool factor_reduced(const std::vector<ReducedSet>& sets, double delta) override;
  void solve_reduced(VectorRef rhs) const override;
  Eigen::Matrix3d diagonal_block(Index set) const override;
  void add_columns(Index set, const double* x, double* y) const override;
  bool list_columns(std::vector<int>& first, std::vector<ColumnBlock>& blocks) const override;

 private:
  /// Rows of one set times the columns of one block of velocities: a dense piece of Js.
  struct Piece {
    int set, block;
    std::size_t values;  // rows x columns, column-major
  };
  /// N_ab += J_a' C J_b for two pieces of one set.
  struct Product {
    std::size_t a, b;
    Index value;
  };

  /// A block of A in the columns of one set.
  struct Place {
    int set;             // of its rows
    std::size_t values;  // column-major
  };

  /// A set of the reduced system: its kind and the inverse of its block of D, damping + delta + weight.
  struct Reduced {
    ReducedSet::Kind kind;
    double u0, u1, friction, weight;
    double inverse[4];  // Stick, Normal, Line: of the diagonal; Slip: 2 x 2, column-major
  };

  bool factor(const BlockDiagonal& x, const BlockDiagonal* y);
  void assemble();
  void make_columns() const;
  void multiply_transposed(const Vector& r, Vector& w) const;  // w = Js' r
  void add_product(const Vector& w, VectorRef y) const;        // y += Js w
  void solve_reduced_once(const Vector& r, Vector& x) const;
  void reduce(const Vector& y, Vector& r) const;  // r = E' y
  void expand(const Vector& x, Vector& y) const;  // y = F x
  void divide(const Vector& r, Vector& x) const;  // x = D^-1 r
  bool same_pattern(const SparseMatrix& mass, const SparseMatrix& jacobian, const ConstraintSets& sets) const;
  void analyze(const SparseMatrix& mass, const SparseMatrix& jacobian, const ConstraintSets& sets);

  BlockLu lu_;
  Vector damping_;  // S R S
  std::vector<int> set_sizes_, set_offsets_, block_sizes_, block_offsets_;
  std::vector<Piece> pieces_;
  std::vector<Product> products_;
  std::vector<double> js_;                    // values of the pieces
  std::vector<std::size_t> jacobian_target_;  // for each entry of J, where it goes in js_
  std::vector<double> mass_values_;           // M laid out as lu_.values()
  std::vector<Index> mass_target_;
  std::vector<int> mass_outer_, mass_inner_, jacobian_outer_, jacobian_inner_;
  SparseMatrix inverse_;  // M^-1 Js'
  // A, set by set, made when asked for.
  mutable std::vector<Place> column_blocks_;
  mutable std::vector<std::size_t> first_column_block_;
  mutable std::vector<double> column_values_;
  BlockDiagonal x_inverse_, y_, c_;
  int sign_ = 0;
  std::vector<Reduced> reduced_;
  double delta_ = 0.0;
  mutable Vector w_, r_, y_rows_, x_rows_, rhs_rows_, correction_;
};

bool MassSpaceSystem::same_pattern(const SparseMatrix& mass, const SparseMatrix& jacobian,
                                   const ConstraintSets& sets) const {
  const auto same = [](const SparseMatrix& m, const std::vector<int>& outer, const std::vector<int>& inner) {
    return static_cast<Index>(outer.size()) == m.cols() + 1 && static_cast<Index>(inner.size()) == m.nonZeros() &&
           std::equal(outer.begin(), outer.end(), m.outerIndexPtr()) &&
           std::equal(inner.begin(), inner.end(), m.innerIndexPtr());
  };
  if (static_cast<Index>(set_sizes_.size()) != sets.num_sets()) return false;
  for (Index i = 0; i < sets.num_sets(); ++i)
    if (set_sizes_[i] != sets[i].size()) return false;
  return same(mass, mass_outer_, mass_inner_) && same(jacobian, jacobian_outer_, jacobian_inner_);
}

void MassSpaceSystem::analyze(const SparseMatrix& mass, const SparseMatrix& jacobian, const ConstraintSets& sets) {
  const int nv = static_cast<int>(mass.rows());
  set_sizes_.clear(), set_offsets_.clear(), block_sizes_.clear(), block_offsets_.clear();
  std::vector<int> set_of(static_cast<std::size_t>(sets.size()));
  for (const ConstraintSet& set : sets) {
    for (Index k = 0; k < set.size(); ++k) set_of[set.offset + k] = static_cast<int>(set_sizes_.size());
    set_sizes_.push_back(static_cast<int>(set.size()));
    set_offsets_.push_back(static_cast<int>(set.offset));
  }
  // Blocks of velocities: neighbours on which the same sets act, the six of a free body for instance.
  std::vector<int> block_of(static_cast<std::size_t>(nv));
  std::vector<std::vector<int>> touched;  // by block
  for (int c = 0; c < nv; ++c) {
    std::vector<int> list;
    for (SparseMatrix::InnerIterator it(jacobian, c); it; ++it)
      if (list.empty() || list.back() != set_of[it.row()]) list.push_back(set_of[it.row()]);
    const bool joins = c > 0 && !list.empty() && list == touched.back() && block_sizes_.back() < 6;
    if (!joins) {
      block_offsets_.push_back(c);
      block_sizes_.push_back(0);
      touched.push_back(std::move(list));
    }
    ++block_sizes_.back();
    block_of[c] = static_cast<int>(block_sizes_.size()) - 1;
  }
  const int num_blocks = static_cast<int>(block_sizes_.size());

  // Pieces, set by set.
  std::vector<std::vector<int>> blocks_of_set(set_sizes_.size());
  for (int b = 0; b < num_blocks; ++b)
    for (const int s : touched[b]) blocks_of_set[s].push_back(b);
  pieces_.clear();
  std::vector<std::size_t> first_piece(set_sizes_.size() + 1, 0);
  std::size_t num_values = 0;
  for (std::size_t s = 0; s < set_sizes_.size(); ++s) {
    first_piece[s] = pieces_.size();
    for (const int b : blocks_of_set[s]) {
      pieces_.push_back({static_cast<int>(s), b, num_values});
      num_values += static_cast<std::size_t>(set_sizes_[s]) * block_sizes_[b];
    }
  }
  first_piece[set_sizes_.size()] = pieces_.size();
  js_.assign(num_values, 0.0);
  const auto piece_at = [&](int s, int b) {
    const auto& list = blocks_of_set[s];
    return first_piece[s] + static_cast<std::size_t>(std::lower_bound(list.begin(), list.end(), b) - list.begin());
  };
  jacobian_target_.clear();
  for (int c = 0; c < nv; ++c)
    for (SparseMatrix::InnerIterator it(jacobian, c); it; ++it) {
      const int s = set_of[it.row()], b = block_of[c];
      jacobian_target_.push_back(pieces_[piece_at(s, b)].values +
                                 static_cast<std::size_t>(c - block_offsets_[b]) * set_sizes_[s] +
                                 (it.row() - set_offsets_[s]));
    }

  // Pattern of N: M, and a clique of blocks per set.
  std::vector<std::vector<int>> lists(block_sizes_.size());
  for (int c = 0; c < nv; ++c)
    for (SparseMatrix::InnerIterator it(mass, c); it; ++it)
      if (block_of[it.row()] > block_of[c]) lists[block_of[c]].push_back(block_of[it.row()]);
  for (const auto& list : blocks_of_set)
    for (const int a : list)
      for (const int b : list)
        if (a > b) lists[b].push_back(a);
  BlockLists neighbours;
  for (auto& list : lists) {
    std::sort(list.begin(), list.end());
    neighbours.items.insert(neighbours.items.end(), list.begin(), std::unique(list.begin(), list.end()));
    neighbours.first.push_back(static_cast<int>(neighbours.items.size()));
  }
  lu_.analyze(block_sizes_, neighbours);
  std::vector<std::size_t> first_pair(block_sizes_.size() + 1, 0);
  for (int b = 0; b < num_blocks; ++b) first_pair[b + 1] = first_pair[b] + 1 + neighbours[b].size();
  const auto value_of = [&](int a, int b) {  // where block (a, b) starts
    const int low = std::min(a, b), high = std::max(a, b);
    const auto begin = lu_.pairs().begin() + static_cast<std::ptrdiff_t>(first_pair[low]);
    const auto end = lu_.pairs().begin() + static_cast<std::ptrdiff_t>(first_pair[low + 1]);
    const auto pair = std::lower_bound(begin, end, high, [](const BlockLu::Pair& p, int i) { return p.i < i; });
    return a >= b ? pair->lower : pair->upper;
  };
  mass_target_.clear();
  for (int c = 0; c < nv; ++c)
    for (SparseMatrix::InnerIterator it(mass, c); it; ++it) {
      const int a = block_of[it.row()], b = block_of[c];
      mass_target_.push_back(value_of(a, b) + static_cast<Index>(c - block_offsets_[b]) * block_sizes_[a] +
                             (it.row() - block_offsets_[a]));
    }
  products_.clear();
  for (std::size_t s = 0; s < set_sizes_.size(); ++s)
    for (std::size_t p = first_piece[s]; p < first_piece[s + 1]; ++p)
      for (std::size_t q = first_piece[s]; q < first_piece[s + 1]; ++q)
        products_.push_back({p, q, value_of(pieces_[p].block, pieces_[q].block)});

  mass_outer_.assign(mass.outerIndexPtr(), mass.outerIndexPtr() + nv + 1);
  mass_inner_.assign(mass.innerIndexPtr(), mass.innerIndexPtr() + mass.nonZeros());
  jacobian_outer_.assign(jacobian.outerIndexPtr(), jacobian.outerIndexPtr() + nv + 1);
  jacobian_inner_.assign(jacobian.innerIndexPtr(), jacobian.innerIndexPtr() + jacobian.nonZeros());
  w_.resize(nv);
  for (Vector* v : {&r_, &y_rows_, &x_rows_, &rhs_rows_, &correction_}) v->setZero(sets.size());
  reduced_.resize(set_sizes_.size());
  for (BlockDiagonal* blocks : {&x_inverse_, &y_, &c_}) blocks->assign(set_sizes_.size(), Eigen::Matrix3d::Identity());
}

void MassSpaceSystem::setup(const SparseMatrix& mass, const SparseMatrix& jacobian,
                            const SparseMatrix& inverse_mass_jacobian, const ConstraintSets& sets,
                            const ConstVectorRef& scale, const ConstVectorRef& compliance) {
  if (!same_pattern(mass, jacobian, sets)) analyze(mass, jacobian, sets);
  std::fill(js_.begin(), js_.end(), 0.0);
  std::size_t k = 0;
  for (Index c = 0; c < jacobian.cols(); ++c)
    for (SparseMatrix::InnerIterator it(jacobian, c); it; ++it)
      js_[jacobian_target_[k++]] = it.value() * scale[it.row()];
  mass_values_.assign(lu_.values().size(), 0.0);
  k = 0;
  for (Index c = 0; c < mass.cols(); ++c)
    for (SparseMatrix::InnerIterator it(mass, c); it; ++it) mass_values_[mass_target_[k++]] = it.value();
  inverse_ = inverse_mass_jacobian * scale.asDiagonal();
  damping_ = compliance.cwiseProduct(scale).cwiseProduct(scale);
  first_column_block_.clear();
}

void MassSpaceSystem::apply(const ConstVectorRef& x, VectorRef y) const {
  w_.noalias() = inverse_ * x;
  y = damping_.cwiseProduct(x);
  add_product(w_, y);
}

void MassSpaceSystem::make_columns() const {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(js_.size());
  for (const Piece& piece : pieces_) {
    const double* j = js_.data() + piece.values;
    for (int c = 0; c < block_sizes_[piece.block]; ++c)
      for (int r = 0; r < set_sizes_[piece.set]; ++r)
        entries.emplace_back(set_offsets_[piece.set] + r, block_offsets_[piece.block] + c, *j++);
  }
  SparseMatrix js(size(), inverse_.rows());
  js.setFromTriplets(entries.begin(), entries.end());
  const SparseMatrix a = js * inverse_;
  std::vector<int> set_of(static_cast<std::size_t>(size())), last(set_sizes_.size(), -1);
  std::vector<std::size_t> place(set_sizes_.size());
  for (std::size_t i = 0; i < set_sizes_.size(); ++i)
    for (int r = 0; r < set_sizes_[i]; ++r) set_of[set_offsets_[i] + r] = static_cast<int>(i);
  column_blocks_.clear(), first_column_block_.clear(), column_values_.clear();
  for (int i = 0; i < static_cast<int>(set_sizes_.size()); ++i) {
    first_column_block_.push_back(column_blocks_.size());
    last[i] = i, place[i] = column_values_.size();  // R, also where no velocity moves the row
    column_blocks_.push_back({i, place[i]});
    column_values_.resize(place[i] + static_cast<std::size_t>(set_sizes_[i]) * set_sizes_[i], 0.0);
    for (int r = 0; r < set_sizes_[i]; ++r)
      column_values_[place[i] + static_cast<std::size_t>(r * set_sizes_[i] + r)] = damping_[set_offsets_[i] + r];
    for (int c = 0; c < set_sizes_[i]; ++c)
      for (SparseMatrix::InnerIterator it(a, set_offsets_[i] + c); it; ++it) {
        const int k = set_of[it.row()];
        if (last[k] != i) {
          last[k] = i;
          place[k] = column_values_.size();
          column_blocks_.push_back({k, place[k]});
          column_values_.resize(place[k] + static_cast<std::size_t>(set_sizes_[k]) * set_sizes_[i], 0.0);
        }
        const int r = static_cast<int>(it.row()) - set_offsets_[k];
        column_values_[place[k] + static_cast<std::size_t>(c * set_sizes_[k] + r)] += it.value();
      }
  }
  first_column_block_.push_back(column_blocks_.size());
}

Eigen::Matrix3d MassSpaceSystem::diagonal_block(Index set) const {
  if (first_column_block_.empty()) make_columns();
  Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
  const int size = set_sizes_[set];
  for (std::size_t k = first_column_block_[set]; k < first_column_block_[set + 1]; ++k) {
    if (column_blocks_[k].set != set) continue;
    const double* a = column_values_.data() + column_blocks_[k].values;
    for (int c = 0; c < size; ++c)
      for (int r = 0; r < size; ++r) block(r, c) = *a++;
  }
  return block;
}

void MassSpaceSystem::add_columns(Index set, const double* x, double* y) const {
  if (first_column_block_.empty()) make_columns();
  for (std::size_t k = first_column_block_[set]; k < first_column_block_[set + 1]; ++k) {
    const Place& block = column_blocks_[k];
    add_block_product(set_sizes_[block.set], set_sizes_[set], column_values_.data() + block.values, x,
                      y + set_offsets_[block.set]);
  }
}

bool MassSpaceSystem::list_columns(std::vector<int>& first, std::vector<ColumnBlock>& blocks) const {
  if (first_column_block_.empty()) make_columns();
  first.assign(first_column_block_.begin(), first_column_block_.end());
  blocks.clear();
  for (const Place& place : column_blocks_) blocks.push_back({place.set, column_values_.data() + place.values});
  return true;
}

void MassSpaceSystem::add_product(const Vector& w, VectorRef y) const {
  for (const Piece& piece : pieces_) {
    const int rows = set_sizes_[piece.set];
    const double* j = js_.data() + piece.values;
    double* out = y.data() + set_offsets_[piece.set];
    for (int c = 0; c < block_sizes_[piece.block]; ++c) {
      const double v = w[block_offsets_[piece.block] + c];
      for (int r = 0; r < rows; ++r) out[r] += *j++ * v;
    }
  }
}

void MassSpaceSystem::multiply_transposed(const Vector& r, Vector& w) const {
  w.setZero();
  for (const Piece& piece : pieces_) {
    const int rows = set_sizes_[piece.set];
    const double* j = js_.data() + piece.values;
    const double* from = r.data() + set_offsets_[piece.set];
    for (int c = 0; c < block_sizes_[piece.block]; ++c)
      for (int k = 0; k < rows; ++k) w[block_offsets_[piece.block] + c] += *j++ * from[k];
  }
}

bool MassSpaceSystem::factor(const BlockDiagonal& x, const BlockDiagonal* y) {
  sign_ = 1;
  for (std::size_t i = 0; i < set_sizes_.size(); ++i) {
    const int o = set_offsets_[i];
    if (y)
      y_[i] = (*y)[i];
    else
      y_[i].setIdentity();
    if (set_sizes_[i] == 1) {
      const double value = x[i](0, 0) + y_[i](0, 0) * damping_[o];
      if (!(std::abs(value) > 0.0)) return sign_ = 0, false;
      if (value < 0.0) sign_ = -sign_;
      x_inverse_[i](0, 0) = 1.0 / value;
      c_[i](0, 0) = y_[i](0, 0) / value;
      continue;
    }
    const Eigen::Matrix3d xi = x[i] + y_[i] * damping_.segment<3>(o).asDiagonal();
    // By elimination: cofactors would lose all digits of the interior point's blocks near the end.
    const Eigen::PartialPivLU<Eigen::Matrix3d> lu(xi);
    const double determinant = lu.determinant();
    if (!(std::abs(determinant) > 0.0) || !std::isfinite(determinant)) return sign_ = 0, false;
    x_inverse_[i] = lu.inverse();
    if (determinant < 0.0) sign_ = -sign_;
    c_[i].noalias() = x_inverse_[i] * y_[i];
  }
  assemble();
  if (!lu_.factor()) return sign_ = 0, false;
  sign_ *= lu_.determinant_sign();
  return true;
}

/// Fills lu_ with M + Js' c_ Js.
void MassSpaceSystem::assemble() {
  std::vector<double>& values = lu_.values();
  std::copy(mass_values_.begin(), mass_values_.end(), values.begin());
  for (const Product& product : products_) {
    const Piece& a = pieces_[product.a];
    const Piece& b = pieces_[product.b];
    const int na = block_sizes_[a.block], nb = block_sizes_[b.block], rows = set_sizes_[a.set];
    const double* ja = js_.data() + a.values;
    const double* jb = js_.data() + b.values;
    const Eigen::Matrix3d& c = c_[static_cast<std::size_t>(a.set)];
    double* out = values.data() + product.value;
    for (int q = 0; q < nb; ++q, jb += rows) {
      if (rows == 3) {
        const double v0 = c(0, 0) * jb[0] + c(0, 1) * jb[1] + c(0, 2) * jb[2];
        const double v1 = c(1, 0) * jb[0] + c(1, 1) * jb[1] + c(1, 2) * jb[2];
        const double v2 = c(2, 0) * jb[0] + c(2, 1) * jb[1] + c(2, 2) * jb[2];
        for (int p = 0; p < na; ++p) out[q * na + p] += ja[3 * p] * v0 + ja[3 * p + 1] * v1 + ja[3 * p + 2] * v2;
      } else {
        const double v = c(0, 0) * jb[0];
        for (int p = 0; p < na; ++p) out[q * na + p] += ja[p] * v;
      }
    }
  }
}

void MassSpaceSystem::solve(VectorRef rhs) const {
  const auto multiply = [this](const BlockDiagonal& blocks, VectorRef v) {
    for (std::size_t i = 0; i < set_sizes_.size(); ++i) {
      if (set_sizes_[i] == 1) {
        v[set_offsets_[i]] *= blocks[i](0, 0);
      } else {
        const Eigen::Vector3d t = blocks[i] * v.segment<3>(set_offsets_[i]);
        v.segment<3>(set_offsets_[i]) = t;
      }
    }
  };
  r_ = rhs;
  multiply(x_inverse_, r_);
  multiply_transposed(r_, w_);
  lu_.solve(w_);
  r_.setZero();
  add_product(w_, r_);
  multiply(y_, r_);
  rhs -= r_;
  multiply(x_inverse_, rhs);
}

bool MassSpaceSystem::factor_reduced(const std::vector<ReducedSet>& sets, double delta) {
  using Kind = ReducedSet::Kind;
  delta_ = delta;
  bool symmetric = true;
  for (std::size_t i = 0; i < sets.size(); ++i) {
    const ReducedSet& set = sets[i];
    const double* damping = damping_.data() + set_offsets_[i];
    Reduced& reduced = reduced_[i];
    reduced = {set.kind, set.u0, set.u1, set.friction, set.weight, {0.0, 0.0, 0.0, 0.0}};
    double* inverse = reduced.inverse;
    Eigen::Matrix3d& c = c_[i];
    c.setZero();
    switch (set.kind) {
      case Kind::Fixed:
        break;
      case Kind::Line:
        c(0, 0) = inverse[0] = 1.0 / (damping[0] + delta);
        break;
      case Kind::Normal:
        c(2, 2) = inverse[0] = 1.0 / (damping[2] + delta);
        break;
      case Kind::Stick:
        for (int k = 0; k < 3; ++k) c(k, k) = inverse[k] = 1.0 / (damping[k] + delta);
        break;
      case Kind::Slip: {
        // D is upper triangular: along the slip N moves the tangents, but not the other way round.
        const double across = set.u1 * set.u1 * damping[0] + set.u0 * set.u0 * damping[1] + delta + set.weight;
        const double mixed = set.friction * set.u0 * set.u1 * (damping[1] - damping[0]);
        const double normal = damping[2] + delta;
        inverse[0] = 1.0 / across, inverse[2] = -mixed / (across * normal), inverse[3] = 1.0 / normal;
        // F D^-1 E', with E = (v, N), F = (v, friction u + N).
        const Eigen::Vector3d v(-set.u1, set.u0, 0.0), n(0.0, 0.0, 1.0);
        const Eigen::Vector3d along(set.friction * set.u0, set.friction * set.u1, 1.0);
        c = v * (inverse[0] * v + inverse[2] * n).transpose() + along * (inverse[3] * n).transpose();
        if (set.friction != 0.0) symmetric = false;
        break;
      }
    }
  }
  assemble();
  if (symmetric && lu_.factor_symmetric()) return true;
  if (symmetric) assemble();
  return lu_.factor();
}

void MassSpaceSystem::reduce(const Vector& y, Vector& r) const {
  using Kind = ReducedSet::Kind;
  for (std::size_t i = 0; i < reduced_.size(); ++i) {
    const Reduced& set = reduced_[i];
    const int o = set_offsets_[i];
    switch (set.kind) {
      case Kind::Fixed:
        break;
      case Kind::Line:
        r[o] = y[o];
        break;
      case Kind::Normal:
        r[o] = y[o + 2];
        break;
      case Kind::Slip: {
        const double normal = y[o + 2];
        r[o] = set.u0 * y[o + 1] - set.u1 * y[o];
        r[o + 1] = normal;
        break;
      }
      case Kind::Stick:
        for (int k = o; k < o + 3; ++k) r[k] = y[k];
        break;
    }
  }
}

void MassSpaceSystem::expand(const Vector& x, Vector& y) const {
  using Kind = ReducedSet::Kind;
  y.setZero();
  for (std::size_t i = 0; i < reduced_.size(); ++i) {
    const Reduced& set = reduced_[i];
    const int o = set_offsets_[i];
    switch (set.kind) {
      case Kind::Fixed:
        break;
      case Kind::Line:
        y[o] = x[o];
        break;
      case Kind::Normal:
        y[o + 2] = x[o];
        break;
      case Kind::Slip: {
        const double along = set.friction * x[o + 1];
        y[o] = along * set.u0 - x[o] * set.u1;
        y[o + 1] = along * set.u1 + x[o] * set.u0;
        y[o + 2] = x[o + 1];
        break;
      }
      case Kind::Stick:
        for (int k = o; k < o + 3; ++k) y[k] = x[k];
        break;
    }
  }
}

void MassSpaceSystem::divide(const Vector& r, Vector& x) const {
  using Kind = ReducedSet::Kind;
  for (std::size_t i = 0; i < reduced_.size(); ++i) {
    const Reduced& set = reduced_[i];
    const int o = set_offsets_[i];
    if (set.kind == Kind::Slip) {
      x[o] = set.inverse[0] * r[o] + set.inverse[2] * r[o + 1];
      x[o + 1] = set.inverse[3] * r[o + 1];
      continue;
    }
    const int rows = num_rows(set.kind);
    for (int k = 0; k < rows; ++k) x[o + k] = set.inverse[k] * r[o + k];
  }
}

/// x = D^-1 (r - E' Js w),   N w = Js' F D^-1 r,   N = M + Js' F D^-1 E' Js.
void MassSpaceSystem::solve_reduced_once(const Vector& r, Vector& x) const {
  divide(r, x);
  expand(x, y_rows_);
  multiply_transposed(y_rows_, w_);
  lu_.solve(w_);
  y_rows_.setZero();
  add_product(w_, y_rows_);
  reduce(y_rows_, x);
  r_ = r - x;
  divide(r_, x);
}

void MassSpaceSystem::solve_reduced(VectorRef rhs) const {
  rhs_rows_ = rhs;
  solve_reduced_once(rhs_rows_, x_rows_);
  // A small D divides by little and so costs digits: once more for what is left.
  expand(x_rows_, y_rows_);
  apply(y_rows_, r_);
  reduce(r_, correction_);
  for (std::size_t i = 0; i < reduced_.size(); ++i) {
    const Reduced& set = reduced_[i];
    const int rows = num_rows(set.kind);
    for (int k = set_offsets_[i]; k < set_offsets_[i] + rows; ++k) rhs_rows_[k] -= correction_[k] + delta_ * x_rows_[k];
    if (set.kind == ReducedSet::Kind::Slip) rhs_rows_[set_offsets_[i]] -= set.weight * x_rows_[set_offsets_[i]];
  }
  solve_reduced_once(rhs_rows_, correction_);
  for (std::size_t i = 0; i < reduced_.size(); ++i) {
    const int o = set_offsets_[i], rows = num_rows(reduced_[i].kind);
    for (int k = o; k < o + rows; ++k) rhs[k] = x_rows_[k] + correction_[k];
  }
}

}  // namespace

MassSpaceDelassus::MassSpaceDelassus(const SparseMatrix& mass, const SparseMatrix& jacobian) {
  const auto shape = [](const SparseMatrix& m) { return std::to_string(m.rows()) + " x " + std::to_string(m.cols()); };
  if (mass.rows() != mass.cols()) throw InvalidInput("mass", "is " + shape(mass) + ", must be square");
  if (jacobian.cols() != mass.rows()) {
    throw InvalidInput("jacobian", "is " + shape(jacobian) + ", must have the " + std::to_string(mass.rows()) +
                                       " columns of the mass matrix");
  }
  require_finite("mass", mass);
  require_finite("jacobian", jacobian);
  asymmetry_ = asymmetry_of(mass);
  const SparseMatrix transpose = mass.transpose();
  require_symmetric(mass, transpose);
  mass_ = asymmetry_ == 0.0 ? mass : SparseMatrix(0.5 * (mass + transpose));
  jacobian_ = jacobian;
  const auto nonzero = [](Index, Index, double value) { return value != 0.0; };
  mass_.prune(nonzero);
  jacobian_.prune(nonzero);
  mass_.makeCompressed();
  jacobian_.makeCompressed();
  transpose_ = jacobian_.transpose();
  if (mass_.rows() == 0) {
    inverse_mass_jacobian_.resize(0, jacobian_.rows());
    return;
  }
  invert_mass();
}

/// The groups of velocities that M ties together (a free body, a robot), and M^-1 J^T, one dense Cholesky per group.
void MassSpaceDelassus::invert_mass() {
  const Index nv = num_velocities();
  UnionFind tied(static_cast<std::size_t>(nv));
  for (Index c = 0; c < nv; ++c)
    for (SparseMatrix::InnerIterator it(mass_, c); it; ++it) tied.join(static_cast<int>(it.row()), static_cast<int>(c));
  group_of_ = tied.labels();
  groups_.resize(static_cast<std::size_t>(1 + *std::max_element(group_of_.begin(), group_of_.end())));
  std::vector<int> position(static_cast<std::size_t>(nv));
  for (int c = 0; c < nv; ++c) {
    position[c] = static_cast<int>(groups_[group_of_[c]].size());
    groups_[group_of_[c]].push_back(c);
  }
  std::vector<Eigen::LLT<Matrix>> cholesky(groups_.size());
  std::map<int, TwofoldCholesky> exact;  // of the ill-conditioned ones
  for (std::size_t k = 0; k < groups_.size(); ++k) {
    const auto size = static_cast<Index>(groups_[k].size());
    Matrix block = Matrix::Zero(size, size);
    for (const int c : groups_[k])
      for (SparseMatrix::InnerIterator it(mass_, c); it; ++it) block(position[it.row()], position[c]) = it.value();
    cholesky[k].compute(block);
    if (cholesky[k].info() != Eigen::Success) {
      throw InvalidInput("mass", "is not positive definite, in the block of row " + std::to_string(groups_[k].front()));
    }
    // Scaling to diagonal 1 is within a factor of size of the best (van der Sluis 1969).
    if (size == 1 || cholesky[k].rcond() >= static_cast<double>(size) * kIllConditioned) continue;
    const double reciprocal = reciprocal_condition(block);
    if (!(reciprocal >= kSingular)) {
      throw InvalidInput("mass", "has the reciprocal condition " + in_full(reciprocal) + " in the block of row " +
                                     std::to_string(groups_[k].front()) + ", its rows scaled to diagonal 1, must be " +
                                     "at least 1e-15: its rounding would decide the answer");
    }
    if (reciprocal < kIllConditioned && !exact[static_cast<int>(k)].factor(block)) {
      throw InvalidInput("mass", "is not positive definite, in the block of row " + std::to_string(groups_[k].front()));
    }
  }
  std::vector<Eigen::Triplet<double>> triplets;
  std::vector<Vector> rhs(groups_.size());
  std::vector<int> touched;
  for (Index i = 0; i < size(); ++i) {
    touched.clear();
    for (SparseMatrix::InnerIterator it(transpose_, i); it; ++it) {
      const int k = group_of_[it.row()];
      if (rhs[k].size() == 0) {
        rhs[k].setZero(static_cast<Index>(groups_[k].size()));
        touched.push_back(k);
      }
      rhs[k][position[it.row()]] = it.value();
    }
    for (const int k : touched) {
      const auto precise = exact.find(k);
      if (precise != exact.end())
        precise->second.solve(rhs[k]);
      else
        cholesky[k].solveInPlace(rhs[k]);
      for (std::size_t c = 0; c < groups_[k].size(); ++c)
        triplets.emplace_back(groups_[k][c], static_cast<int>(i), rhs[k][static_cast<Index>(c)]);
      rhs[k].resize(0);
    }
  }
  inverse_mass_jacobian_.resize(nv, size());
  inverse_mass_jacobian_.setFromTriplets(triplets.begin(), triplets.end());
  inverse_mass_jacobian_.prune([](Index, Index, double value) { return value != 0.0; });
}

void MassSpaceDelassus::apply(const ConstVectorRef& x, VectorRef y) const {
  thread_local std::vector<double> scratch;  // grows only, so that a warm call allocates nothing
  if (scratch.size() < static_cast<std::size_t>(num_velocities())) scratch.resize(num_velocities());
  Eigen::Map<Vector> w(scratch.data(), num_velocities());
  w.noalias() = inverse_mass_jacobian_ * x;
  y.noalias() = jacobian_ * w;
}

void MassSpaceDelassus::diagonal(VectorRef diagonal) const {
  for (Index i = 0; i < size(); ++i) {
    const double d = transpose_.col(i).dot(inverse_mass_jacobian_.col(i));
    diagonal[i] = d < 0.0 ? 0.0 : d;
  }
}

SparseMatrix MassSpaceDelassus::matrix() const {
  const SparseMatrix g = jacobian_ * inverse_mass_jacobian_;
  const SparseMatrix transpose = g.transpose();
  return 0.5 * (g + transpose);
}

std::vector<int> MassSpaceDelassus::islands(const ConstraintSets& sets) const {
  // Sets and velocities are the nodes; J and M the edges.
  const auto count = static_cast<std::size_t>(sets.num_sets());
  UnionFind components(count + static_cast<std::size_t>(num_velocities()));
  std::vector<int> set_of(static_cast<std::size_t>(sets.size()));
  int index = 0;
  for (const ConstraintSet& set : sets) {
    for (Index k = 0; k < set.size(); ++k) set_of[set.offset + k] = index;
    ++index;
  }
  const int first = static_cast<int>(count);
  for (Index c = 0; c < jacobian_.cols(); ++c)
    for (SparseMatrix::InnerIterator it(jacobian_, c); it; ++it)
      components.join(set_of[it.row()], first + static_cast<int>(c));
  for (Index c = 0; c < mass_.cols(); ++c)
    for (SparseMatrix::InnerIterator it(mass_, c); it; ++it)
      components.join(first + static_cast<int>(it.row()), first + static_cast<int>(c));
  std::vector<int> labels = components.labels();  // the sets come first, so their labels are 0, 1, ... without gaps
  labels.resize(count);
  return labels;
}

std::shared_ptr<const DelassusOperator> MassSpaceDelassus::restrict(const std::vector<Index>& rows) const {
  // The velocities that the rows act on, and those that M ties to them. Costs what the part has, not the whole.
  std::vector<int> used;
  for (const Index r : rows)
    for (SparseMatrix::InnerIterator it(transpose_, r); it; ++it) used.push_back(group_of_[it.row()]);
  std::sort(used.begin(), used.end());
  used.erase(std::unique(used.begin(), used.end()), used.end());
  std::vector<Index> kept;
  for (const int k : used) kept.insert(kept.end(), groups_[k].begin(), groups_[k].end());
  std::sort(kept.begin(), kept.end());
  return std::make_shared<MassSpaceDelassus>(select(mass_, kept, kept), select(jacobian_, rows, kept));
}

void MassSpaceDelassus::prepare(const ConstraintSets& sets, const ConstVectorRef& scale,
                                const ConstVectorRef& compliance, std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<MassSpaceSystem*>(system.get());
  if (!known) system.reset(known = new MassSpaceSystem);
  known->setup(mass_, jacobian_, inverse_mass_jacobian_, sets, scale, compliance);
}

}  // namespace signorini
