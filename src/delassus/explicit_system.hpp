#pragma once

#include <memory>
#include <vector>

#include "block_lu.hpp"
#include "dense_kernels.hpp"
#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

/// ScaledDelassus of an operator whose matrix G is at hand. Blocks of A are stored; X + Y A is factored by BlockLu, or
/// as one dense matrix where that is as good: then a new pattern costs nothing.
class ExplicitSystem final : public ScaledDelassus {
 public:
  /// matrix: G, symmetric, both triangles, compressed.
  void setup(const SparseMatrix& matrix, const ConstraintSets& sets, const ConstVectorRef& scale,
             const ConstVectorRef& compliance);

  /// matrix: G, symmetric, dense, column-major, both triangles. Allocates nothing for sizes already seen.
  void setup(const double* matrix, const ConstraintSets& sets, const ConstVectorRef& scale,
             const ConstVectorRef& compliance);

  /// G(rows of set i, rows of set j), i > j, column-major.
  struct Block {
    int i, j;
    const double* values;
  };
  /// The same of G in `diagonal`, by its lower triangles, and `blocks`, in ascending order of (i, j), which the caller
  /// has filled. scale: one value a set, repeated on its rows. Allocates nothing for sizes and, unless dense, patterns
  /// already seen.
  void setup(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance);
  std::vector<const double*> diagonal;
  /// Of so many sets and blocks below the diagonal, whether that setup() makes one dense matrix.
  static bool is_dense(Index rows, Index num_sets, std::size_t num_blocks);
  int stride = 0;  ///< between the columns of `diagonal` and `blocks`; 0: as many as a block has rows
  std::vector<Block> blocks;
  std::vector<int> local;  ///< of the caller's: numbers in a part by number in the whole

  Index size() const override { return size_; }
  void apply(const ConstVectorRef& x, VectorRef y) const override;
  bool factor(const BlockDiagonal& x, const BlockDiagonal& y) override;
  bool factor(const BlockDiagonal& x, bool rough = false) override;
  int determinant_sign() const override { return dense_ ? sign_ : analysis_->lu.determinant_sign(); }
  void solve(VectorRef rhs) const override;
  bool reduces() const override { return true; }
  bool cheap_columns() const override { return true; }
  Eigen::Matrix3d diagonal_block(Index set) const override;
  void add_columns(Index set, const double* x, double* y) const override;
  bool factor_reduced(const std::vector<ReducedSet>& sets, double delta) override;
  void solve_reduced(VectorRef rhs) const override;
  bool list_columns(std::vector<int>& first, std::vector<ColumnBlock>& columns) const override;

 private:
  /// A pattern with its symbolic analysis.
  struct Analysis {
    std::vector<int> sizes, pattern;  ///< rows of each set; i, j of each block, in turn
    std::vector<int> place;           ///< of each block in lu.pairs()
    std::vector<int> diagonal_place;  ///< of each set
    /// Of the columns of each set, the blocks of rows: set i, and where A(i, set) starts in lu.values().
    struct Place {
      int i;
      Index start;
    };
    std::vector<int> first_column_block;  ///< of each set; the same for its rows
    std::vector<Place> column_blocks;
    std::vector<DenseKernels::BlockAt> row_blocks;  ///< A(set, i), where all sets are contacts
    long last_use = 0;
    BlockLu lu;
    void find_columns();
  };

  void take_sizes(const ConstraintSets& sets);
  void reserve_fronts();
  bool same_pattern(const SparseMatrix& matrix, const ConstraintSets& sets) const;
  void analyze(const SparseMatrix& matrix, const ConstraintSets& sets);
  void find_analysis();
  bool factor_dense();
  void reduce_dense(double delta);

  Index size_ = 0;
  std::vector<int> sizes_, offsets_;
  bool dense_ = false;
  std::vector<double>
      a_;  ///< values of A: when dense, all of it, column-major; else laid out as analysis_->lu.values()

  // dense
  std::vector<double> k_;  ///< the matrix to factor, then its factors
  std::vector<int> pivots_;
  Index rows_ = 0;  ///< of k_
  int sign_ = 0;
  bool symmetric_ = false;
  mutable std::vector<double> x_;
  std::vector<double> columns_;

  // reduced
  struct Active {
    ReducedSet::Kind kind;
    int offset, row;  ///< first row in A, and in the reduced matrix
    double u0, u1, friction, weight;
    int size() const { return kind == ReducedSet::Kind::Stick ? 3 : kind == ReducedSet::Kind::Slip ? 2 : 1; }
  };
  std::vector<Active> active_;
  std::vector<int> reduced_sizes_;  ///< of every set

  // by blocks
  Analysis* analysis_ = nullptr;
  std::vector<std::unique_ptr<Analysis>> analyses_;
  long uses_ = 0;

  std::vector<double> fronts_;  ///< A as BlockLu::assemble() has it, where that is small
  bool assembled_ = false;

  // from a sparse matrix
  std::unique_ptr<Analysis> sparse_;
  struct Run {
    Index target;  ///< in a_
    int count;     ///< stored entries of a column of G one below the other, of one block
  };
  std::vector<Run> runs_;
  std::vector<int> outer_, inner_;
};

/// y += a x, for a block a of rows x columns.
inline void add_block_product(int rows, int columns, const double* a, const double* x, double* y) {
  if (rows == 3 && columns == 3) {
    y[0] += a[0] * x[0] + a[3] * x[1] + a[6] * x[2];
    y[1] += a[1] * x[0] + a[4] * x[1] + a[7] * x[2];
    y[2] += a[2] * x[0] + a[5] * x[1] + a[8] * x[2];
    return;
  }
  for (int c = 0; c < columns; ++c)
    for (int r = 0; r < rows; ++r) y[r] += *a++ * x[c];
}

/// yi += a xj, yj += a^T xi, for a block a of ni x nj.
inline void add_block_products(int ni, int nj, const double* a, const double* xi, const double* xj,
                               double* __restrict yi, double* __restrict yj) {
  if (ni == 3 && nj == 3) {
    yi[0] += a[0] * xj[0] + a[3] * xj[1] + a[6] * xj[2];
    yi[1] += a[1] * xj[0] + a[4] * xj[1] + a[7] * xj[2];
    yi[2] += a[2] * xj[0] + a[5] * xj[1] + a[8] * xj[2];
    yj[0] += a[0] * xi[0] + a[1] * xi[1] + a[2] * xi[2];
    yj[1] += a[3] * xi[0] + a[4] * xi[1] + a[5] * xi[2];
    yj[2] += a[6] * xi[0] + a[7] * xi[1] + a[8] * xi[2];
    return;
  }
  for (int c = 0; c < nj; ++c)
    for (int r = 0; r < ni; ++r) {
      yi[r] += a[c * ni + r] * xj[c];
      yj[c] += a[c * ni + r] * xi[r];
    }
}

/// Shared by the operators: max |G - G^T| / max |G|.
double asymmetry_of(const SparseMatrix& matrix);

}  // namespace signorini
