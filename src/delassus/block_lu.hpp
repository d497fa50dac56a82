#pragma once

#include <cstring>
#include <vector>

#include "dense_kernels.hpp"
#include "signorini/delassus/scaled_delassus.hpp"

namespace signorini {

/// For each block a list of other blocks.
struct BlockLists {
  std::vector<int> first{0}, items;  ///< of block j: items from first[j] to before first[j + 1]

  struct List {
    const int *from, *to;
    const int* begin() const { return from; }
    const int* end() const { return to; }
    int size() const { return static_cast<int>(to - from); }
  };
  int size() const { return static_cast<int>(first.size()) - 1; }
  List operator[](int j) const { return {items.data() + first[j], items.data() + first[j + 1]}; }
};

/// Multifrontal LU of a square matrix of small dense blocks with a symmetric pattern and unsymmetric values: a
/// minimum-degree order of the block graph (exact for up to 64 blocks, else AMD), relaxed supernodes, dense fronts, row
/// pivoting inside a supernode. After analyze(), nothing here allocates. Reference: Duff and Reid 1983; Liu 1992 for
/// the elimination tree and the stack of updates.
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
  void analyze(const std::vector<int>& block_sizes, const BlockLists& neighbours);

  Index size() const { return size_; }
  const std::vector<Pair>& pairs() const { return pairs_; }
  /// Entries of the matrix, to be filled before factor().
  std::vector<double>& values() { return values_; }
  const std::vector<double>& values() const { return values_; }

  /// Rows of each block from here on, at most those given to analyze(): blocks may shrink, to nothing too, without a
  /// new analysis. A block (i, j) in values() starts where it did and has this many rows and columns.
  void set_sizes(const std::vector<int>& block_sizes);

  /// Factors the matrix in values().
  bool factor();
  /// Factors the matrix that write(i, j, from, to, stride) makes: block (i, j), which would start at `from` in
  /// values(), goes to `to`, where zeros are, the columns `stride` apart.
  template <typename Write>
  bool factor(const Write& write) {
    return factor_fronts(false, false,
                         [&](const Supernode& super) { write_front(super, false, factors_.data(), write); });
  }
  /// Puts values laid out like values() where factor(fronts, added) takes them from: num_factor_entries() of them.
  void assemble(const double* values, double* fronts) const;
  /// Factors what is assembled, with added[i] added to block (i, i). on_diagonal: as the kernels have it.
  bool factor(const double* fronts, const BlockDiagonal& added, bool on_diagonal);
  /// Factors a symmetric positive definite matrix, without pivoting; false when it is not that. Of blocks (i, j) and
  /// (j, i) the one below the diagonal in the order of elimination is read, so both have to be there.
  bool factor_symmetric();
  template <typename Write>
  bool factor_symmetric(const Write& write) {
    return factor_fronts(true, false,
                         [&](const Supernode& super) { write_front(super, true, factors_.data(), write); });
  }
  int determinant_sign() const { return sign_; }
  /// With the last factorisation, in place. Rows that a block does not have are left alone.
  void solve(VectorRef rhs) const;
  Index num_factor_entries() const { return room_.factors; }  ///< of L and U

 private:
  struct Supernode {
    int parent = -1;
    int children = 0, num_children = 0;  // where its children start in children_
    int blocks = 0;                      // where its blocks start in front_blocks_: pivots, then updates
    int pivot_blocks = 0, update_blocks = 0;
    int first_entry = 0, last_entry = 0;  // from where to before where its entries are in block_entries_
    // by set_sizes():
    int pivots = 0, updates = 0;  // p, u in rows
    int first = 0;                // first pivot, in elimination order
    Index lower = 0, upper = 0;   // where L (n x p) and U (p x u) start in factors_
    Index rows = 0;               // where the u update rows (elimination order) start in rows_, and in relative_
  };
  /// A pair of blocks in a front: (a, b) goes to its positions in the front's blocks, b being a pivot.
  struct BlockEntry {
    Index ab, ba;  // in values_
    int a, b;      // positions
  };
  /// write() of factor() that copies from values.
  auto copy_from(const double* values) const {
    return [this, values](int i, int j, Index start, double* to, int stride) {
      const double* from = values + start;
      const int rows = sizes_[i], columns = sizes_[j];
      if (rows == 3 && columns == 3) {  // by far the most
        for (int c = 0; c < 3; ++c, to += stride, from += 3) to[0] = from[0], to[1] = from[1], to[2] = from[2];
        return;
      }
      for (int c = 0; c < columns; ++c)
        for (int r = 0; r < rows; ++r) to[static_cast<Index>(c) * stride + r] = *from++;
    };
  }
  template <typename Write>
  void write_front(const Supernode& super, bool symmetric, double* fronts, const Write& write) const;
  void add_diagonal(const Supernode& super, const BlockDiagonal& added);
  template <typename Assemble>
  bool factor_fronts(bool symmetric, bool on_diagonal, const Assemble& assemble);
  void extend_add(const Supernode& super, double*& top);
  void extend_add_symmetric(const Supernode& super, double*& top);

  void find_room();
  void make_room();  // in what find_room() has reserved; large islands may do without, and then nobody touches it

  struct Room {
    Index factors = 0, stack = 0, widest = 0;
  };
  Room room_;
  Index size_ = 0;
  int sign_ = 0;
  bool symmetric_ = false;  // what the last factorisation was
  std::vector<Pair> pairs_;
  std::vector<double> values_;
  std::vector<int> offsets_, sizes_;  // of each block: first row in the caller's vectors, rows at present
  std::vector<Supernode> supernodes_;
  std::vector<int> children_;         // supernodes
  std::vector<int> front_blocks_;     // names of blocks
  std::vector<int> parent_position_;  // of each of them that is an update: position in the parent's front
  std::vector<BlockEntry> block_entries_;
  // by set_sizes():
  std::vector<int> front_rows_;   // first row in its front of each entry of front_blocks_
  std::vector<int> row_of_;       // first row of each block, in elimination order
  std::vector<int> permutation_;  // row in the caller's vectors of each row in elimination order
  std::vector<int> rows_, relative_, pivots_;
  std::vector<double> factors_;
  std::vector<double> stack_, schur_;
  mutable std::vector<double> x_, update_;
};

template <typename Write>
void BlockLu::write_front(const Supernode& super, bool symmetric, double* fronts, const Write& write) const {
  const int p = super.pivots, u = super.updates, n = p + u;
  double *l = fronts + super.lower, *up = fronts + super.upper;  // U follows L
  std::memset(l, 0, static_cast<std::size_t>(n + (symmetric ? 0 : u)) * p * sizeof(double));
  const int *blocks = front_blocks_.data() + super.blocks, *rows = front_rows_.data() + super.blocks;
  for (int e = super.first_entry; e < super.last_entry; ++e) {
    const BlockEntry& entry = block_entries_[e];
    const int i = blocks[entry.a], j = blocks[entry.b];
    if (sizes_[i] == 0 || sizes_[j] == 0) continue;
    const Index a = rows[entry.a], b = rows[entry.b];
    write(i, j, entry.ab, l + b * n + a, n);
    if (i == j || symmetric) continue;
    if (entry.a < super.pivot_blocks)
      write(j, i, entry.ba, l + a * n + b, n);
    else
      write(j, i, entry.ba, up + (a - p) * p + b, p);
  }
}

template <typename Assemble>
bool BlockLu::factor_fronts(bool symmetric, bool on_diagonal, const Assemble& assemble) {
  make_room();
  const DenseKernels& kernels = dense_kernels();
  sign_ = 1;
  symmetric_ = symmetric;
  double* top = stack_.data();
  for (const Supernode& super : supernodes_) {
    const int p = super.pivots, u = super.updates;
    double *l = factors_.data() + super.lower, *up = factors_.data() + super.upper, *schur = schur_.data();
    if (u > 0) std::memset(schur, 0, static_cast<std::size_t>(u) * u * sizeof(double));
    assemble(super);
    symmetric ? extend_add_symmetric(super, top) : extend_add(super, top);
    if (p > 0)
      sign_ *= symmetric ? kernels.factor_symmetric_front(p, u, l, up, schur)
                         : kernels.factor_front(p, u, l, up, schur, pivots_.data() + super.first, on_diagonal);
    if (sign_ == 0) return false;
    if (u > 0) std::memcpy(top, schur, static_cast<std::size_t>(u) * u * sizeof(double));
    top += static_cast<Index>(u) * u;
  }
  return true;
}

}  // namespace signorini
