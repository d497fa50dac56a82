#pragma once

#include <vector>

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
  /// Puts values laid out like values() where factor(fronts, added) takes them from: num_factor_entries() of them.
  void assemble(const double* values, double* fronts) const;
  /// Factors what is assembled, with added[i] added to block (i, i). on_diagonal: as the kernels have it.
  bool factor(const double* fronts, const BlockDiagonal& added, bool on_diagonal);
  /// Factors a symmetric positive definite matrix, without pivoting; false when it is not that. Of blocks (i, j) and
  /// (j, i) the one below the diagonal in the order of elimination is read, so both have to be there.
  bool factor_symmetric();
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
    int block_entries = 0;  // where its entries end in block_entries_
    // by set_sizes():
    int pivots = 0, updates = 0;  // p, u in rows
    int first = 0;                // first pivot, in elimination order
    Index lower = 0, upper = 0;   // where L (n x p) and U (p x u) start in factors_
    Index rows = 0;               // where the u update rows (elimination order) start in rows_, and in relative_
    Index entries_begin = 0, entries_end = 0;
  };
  /// A pair of blocks in a front: (a, b) goes to its positions in the front's blocks, b being a pivot.
  struct BlockEntry {
    Index ab, ba;  // in values_
    int a, b;      // positions
  };
  /// Copies one block of values_ into a front.
  struct Entry {
    Index value;
    Index target;  // in factors_
    int rows, columns, stride;
    bool lower;  // needed by factor_symmetric()
  };

  static void copy_in(const double* values, const Entry& entry, double* fronts) {
    const double* from = values + entry.value;
    double* to = fronts + entry.target;
    if (entry.rows == 3 && entry.columns == 3) {  // by far the most
      for (int c = 0; c < 3; ++c, to += entry.stride, from += 3) to[0] = from[0], to[1] = from[1], to[2] = from[2];
      return;
    }
    for (int c = 0; c < entry.columns; ++c)
      for (int r = 0; r < entry.rows; ++r) to[static_cast<Index>(c) * entry.stride + r] = *from++;
  }
  void assemble(const Supernode& super, const double* values, double* fronts) const;
  void add_diagonal(const Supernode& super, const BlockDiagonal& added);
  template <typename Assemble>
  bool factor_fronts(bool on_diagonal, Assemble&& assemble);
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
  std::vector<Entry> entries_;
  std::vector<int> rows_, relative_, pivots_;
  std::vector<double> factors_;
  std::vector<double> stack_, schur_;
  mutable std::vector<double> x_, update_;
};

}  // namespace signorini
