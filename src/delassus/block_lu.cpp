#include "block_lu.hpp"

#include <Eigen/OrderingMethods>
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <utility>

#include "dense_kernels.hpp"

namespace signorini {
namespace {

/// Fill-reducing order of the block graph: order[k] = block eliminated k-th.
std::vector<int> minimum_degree(const BlockLists& neighbours) {
  const int n = neighbours.size();
  std::vector<int> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  const std::size_t edges = neighbours.items.size();
  const double full = 0.5 * n * (n - 1.0);
  if (n < 4 || static_cast<double>(edges) > 0.9 * full) return order;
  SparseMatrix pattern(n, n);  // one triangle: the ordering symmetrises it
  pattern.reserve(static_cast<Index>(edges) + n);
  for (int j = 0; j < n; ++j) {
    pattern.startVec(j);
    pattern.insertBack(j, j) = 1.0;
    for (const int i : neighbours[j]) pattern.insertBack(i, j) = 1.0;
  }
  pattern.finalize();
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> permutation;
  Eigen::AMDOrdering<int>()(pattern, permutation);
  for (int k = 0; k < n; ++k) order[static_cast<std::size_t>(k)] = permutation.indices()[k];
  return order;
}

/// Elimination tree of a symmetric pattern given by the lists of higher-numbered neighbours (Liu 1992).
std::vector<int> elimination_tree(const BlockLists& lower) {
  const int n = lower.size();
  BlockLists upper;  // lower-numbered neighbours
  upper.first.assign(static_cast<std::size_t>(n) + 1, 0);
  for (const int i : lower.items) ++upper.first[i + 1];
  std::partial_sum(upper.first.begin(), upper.first.end(), upper.first.begin());
  upper.items.resize(lower.items.size());
  std::vector<int> next(upper.first.begin(), upper.first.end() - 1);
  for (int j = 0; j < n; ++j)
    for (const int i : lower[j]) upper.items[next[i]++] = j;
  std::vector<int> parent(n, -1), ancestor(n, -1);
  for (int j = 0; j < n; ++j) {
    for (int i : upper[j]) {
      while (ancestor[i] != -1 && ancestor[i] != j) {
        const int above = ancestor[i];
        ancestor[i] = j;
        i = above;
      }
      if (ancestor[i] == -1) ancestor[i] = j, parent[i] = j;
    }
  }
  return parent;
}

/// Of each node of a forest, its place where children come before parents. parent[j] > j, or -1.
std::vector<int> postorder(const std::vector<int>& parent) {
  const int n = static_cast<int>(parent.size());
  std::vector<int> place(parent.size(), 1);  // at first the size of its tree
  for (int j = 0; j < n; ++j)
    if (parent[j] >= 0) place[parent[j]] += place[j];
  int end = n;
  std::vector<int> end_of(parent.size());  // of what is left for the children
  for (int j = n - 1; j >= 0; --j) {
    int& last = parent[j] < 0 ? end : end_of[parent[j]];
    const int size = place[j];
    place[j] = end_of[j] = last - 1;
    last -= size;
  }
  return place;
}

std::vector<int> inverse_of(const std::vector<int>& order) {
  std::vector<int> position(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) position[order[k]] = static_cast<int>(k);
  return position;
}

/// Renames the blocks: new name position[j] for j.
BlockLists renumber(const BlockLists& lower, const std::vector<int>& position) {
  const int n = lower.size();
  BlockLists out;
  out.first.assign(static_cast<std::size_t>(n) + 1, 0);
  for (int j = 0; j < n; ++j)
    for (const int i : lower[j]) ++out.first[std::min(position[i], position[j]) + 1];
  std::partial_sum(out.first.begin(), out.first.end(), out.first.begin());
  out.items.resize(lower.items.size());
  std::vector<int> next(out.first.begin(), out.first.end() - 1);
  for (int j = 0; j < n; ++j)
    for (const int i : lower[j])
      out.items[next[std::min(position[i], position[j])]++] = std::max(position[i], position[j]);
  for (int j = 0; j < n; ++j) std::sort(out.items.begin() + out.first[j], out.items.begin() + out.first[j + 1]);
  return out;
}

/// For each column of L, the blocks below its diagonal block.
BlockLists structure_of(const BlockLists& lower, const std::vector<int>& parent) {
  const int n = lower.size();
  std::vector<int> child(parent.size(), -1), next(parent.size(), -1);  // children of each, as linked lists
  for (int j = n - 1; j >= 0; --j)
    if (parent[j] >= 0) next[j] = child[parent[j]], child[parent[j]] = j;
  std::vector<int> mark(parent.size(), -1);
  BlockLists out;
  out.first.reserve(static_cast<std::size_t>(n) + 1);
  out.items.reserve(2 * lower.items.size());
  for (int j = 0; j < n; ++j) {
    mark[j] = j;
    const auto add = [&](int i) {
      if (mark[i] != j) mark[i] = j, out.items.push_back(i);
    };
    for (const int i : lower[j]) add(i);
    for (int c = child[j]; c >= 0; c = next[c])
      for (int k = out.first[c]; k < out.first[c + 1]; ++k) add(out.items[k]);
    std::sort(out.items.begin() + out.first[j], out.items.end());
    out.first.push_back(static_cast<int>(out.items.size()));
  }
  return out;
}

/// The columns of L in the order of elimination: their blocks, the elimination tree, the blocks below the diagonal.
struct Columns {
  std::vector<int> order, parent;
  BlockLists structure;
};

Columns columns_of(const BlockLists& neighbours) {
  Columns out;
  const std::vector<int> order = minimum_degree(neighbours);
  const std::vector<int> parent = elimination_tree(renumber(neighbours, inverse_of(order)));
  const std::vector<int> place = postorder(parent);
  out.order.resize(order.size()), out.parent.resize(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) {
    out.order[place[k]] = order[k];
    out.parent[place[k]] = parent[k] < 0 ? -1 : place[parent[k]];
  }
  out.structure = structure_of(renumber(neighbours, inverse_of(out.order)), out.parent);
  return out;
}

constexpr int kFew = 64;  // blocks that fit into the bits of a word

/// The same for few blocks, by exact minimum degree.
Columns columns_of_few(const BlockLists& neighbours) {
  using Bits = std::uint64_t;
  const int n = neighbours.size();
  const auto bit = [](int i) { return Bits{1} << i; };
  const auto first_of = [](Bits bits) { return __builtin_ctzll(bits); };
  Bits below[kFew] = {};  // of each block, the others it shares an entry with, then those below it in L
  for (int j = 0; j < n; ++j)
    for (const int i : neighbours[j]) below[j] |= bit(i), below[i] |= bit(j);
  int order[kFew], rank[kFew];
  Bits left = n == kFew ? ~Bits{0} : bit(n) - 1;
  for (int k = 0; k < n; ++k) {
    int least = kFew, block = 0;
    for (Bits rest = left; rest; rest &= rest - 1) {
      const int i = first_of(rest), degree = __builtin_popcountll(below[i]);
      if (degree < least) least = degree, block = i;
    }
    order[k] = block, rank[block] = k;
    left &= ~bit(block);
    for (Bits rest = below[block]; rest; rest &= rest - 1) {
      const int i = first_of(rest);
      below[i] = (below[i] | below[block]) & ~(bit(i) | bit(block));
    }
  }
  std::vector<int> parent(static_cast<std::size_t>(n), -1);
  int num_items = 0;
  for (int k = 0; k < n; ++k) {
    for (Bits rest = below[order[k]]; rest; rest &= rest - 1) {
      const int i = rank[first_of(rest)];
      if (parent[k] < 0 || i < parent[k]) parent[k] = i;
      ++num_items;
    }
  }
  const std::vector<int> place = postorder(parent);
  Columns out;
  out.order.resize(parent.size()), out.parent.resize(parent.size());
  for (int k = 0; k < n; ++k) {
    out.order[place[k]] = order[k];
    out.parent[place[k]] = parent[k] < 0 ? -1 : place[parent[k]];
  }
  out.structure.first.reserve(parent.size() + 1);
  out.structure.items.reserve(static_cast<std::size_t>(num_items));
  for (const int block : out.order) {
    const std::size_t begin = out.structure.items.size();
    for (Bits rest = below[block]; rest; rest &= rest - 1) out.structure.items.push_back(place[rank[first_of(rest)]]);
    std::sort(out.structure.items.begin() + static_cast<std::ptrdiff_t>(begin), out.structure.items.end());
    out.structure.first.push_back(static_cast<int>(out.structure.items.size()));
  }
  return out;
}

/// A supernode while supernodes are being merged.
struct Node {
  int last = 0;  // of its pivots, whose structure is its update rows
  int parent = -1;
  int p = 0, u = 0;    // rows
  double zeros = 0.0;  // entries of L that are zero by structure
};

/// Merging a child into its parent costs stored zeros and saves overhead: CHOLMOD's rule.
bool worth_merging(const Node& child, const Node& parent, double* zeros) {
  const double p = child.p + parent.p, n = p + parent.u;
  const double missing = static_cast<double>(child.p) * (parent.p + parent.u - child.u);
  *zeros = child.zeros + parent.zeros + missing;
  if (missing == 0.0 && child.zeros + parent.zeros == 0.0) return true;
  const double share = *zeros / (p * n - 0.5 * p * (p - 1));
  return p <= 12 ? share < 0.8 : p <= 36 ? share < 0.2 : p <= 96 ? share < 0.1 : share < 0.05;
}

}  // namespace

void BlockLu::analyze(const std::vector<int>& block_sizes, const BlockLists& neighbours) {
  const int num_blocks = static_cast<int>(block_sizes.size());
  offsets_.assign(block_sizes.size(), 0);
  size_ = 0;
  for (int i = 0; i < num_blocks; ++i) {
    offsets_[i] = static_cast<int>(size_);
    size_ += block_sizes[i];
  }
  sign_ = 0;

  // Storage of the matrix.
  pairs_.resize(block_sizes.size() + neighbours.items.size());
  Pair* next = pairs_.data();
  Index num_values = 0;
  for (int j = 0; j < num_blocks; ++j) {
    *next++ = {j, j, num_values, num_values};
    num_values += block_sizes[j] * block_sizes[j];
    for (const int i : neighbours[j]) {
      const Index count = block_sizes[i] * block_sizes[j];
      *next++ = {i, j, num_values, num_values + count};
      num_values += 2 * count;
    }
  }
  values_.resize(static_cast<std::size_t>(num_values));

  const Columns columns = num_blocks <= kFew ? columns_of_few(neighbours) : columns_of(neighbours);
  const std::vector<int>&order = columns.order, &parent = columns.parent;
  const BlockLists& structure = columns.structure;

  // Supernodes: first the fundamental ones, then merged with their parents where that pays.
  std::vector<Node> nodes;
  nodes.reserve(order.size());
  std::vector<int> node_of(order.size(), -1);
  for (int j = 0; j < num_blocks; ++j) {
    const bool joins = j > 0 && parent[j - 1] == j && structure[j - 1].size() == structure[j].size() + 1;
    if (!joins) nodes.emplace_back();
    node_of[j] = static_cast<int>(nodes.size()) - 1;
    nodes.back().p += block_sizes[order[j]];
    nodes.back().last = j;
  }
  for (Node& node : nodes) {
    for (const int i : structure[node.last]) node.u += block_sizes[order[i]];
    node.parent = parent[node.last] < 0 ? -1 : node_of[parent[node.last]];
  }
  const int num_nodes = static_cast<int>(nodes.size());
  std::vector<int> representative(nodes.size());
  std::iota(representative.begin(), representative.end(), 0);
  const auto find = [&](int s) {
    while (representative[s] != s) s = representative[s] = representative[representative[s]];
    return s;
  };
  for (int s = num_nodes - 1; s >= 0; --s) {  // parents before children
    if (nodes[s].parent < 0) continue;
    const int t = find(nodes[s].parent);
    double zeros = 0.0;
    if (!worth_merging(nodes[s], nodes[t], &zeros)) {
      nodes[s].parent = t;
      continue;
    }
    nodes[t].p += nodes[s].p;
    nodes[t].zeros = zeros;
    representative[s] = t;
  }
  // Number the remaining supernodes in postorder, and the blocks along.
  std::vector<int> kept, index(nodes.size(), -1), node_parent;
  kept.reserve(nodes.size()), node_parent.reserve(nodes.size());
  for (int s = 0; s < num_nodes; ++s)
    if (representative[s] == s) index[s] = static_cast<int>(kept.size()), kept.push_back(s);
  for (const int s : kept) node_parent.push_back(nodes[s].parent < 0 ? -1 : index[find(nodes[s].parent)]);
  const std::vector<int> new_index = postorder(node_parent), post = inverse_of(new_index);

  supernodes_.assign(post.size(), Supernode());
  std::vector<int> rank(block_sizes.size());      // of each block, in the order of elimination
  std::vector<int> super_of(block_sizes.size());  // in which it is a pivot
  std::vector<int> place_of(block_sizes.size());  // its position among the pivots there
  for (int j = 0; j < num_blocks; ++j) {
    const int k = super_of[order[j]] = new_index[index[find(node_of[j])]];
    place_of[order[j]] = supernodes_[k].pivot_blocks++;
  }
  children_.clear();
  int num_pivots = 0, num_front_blocks = 0;
  for (std::size_t k = 0; k < post.size(); ++k) {
    Supernode& super = supernodes_[k];
    super.parent = node_parent[post[k]] < 0 ? -1 : new_index[node_parent[post[k]]];
    super.update_blocks = structure[nodes[kept[post[k]]].last].size();
    super.blocks = num_front_blocks;
    super.first = num_pivots;  // in blocks, here
    num_pivots += super.pivot_blocks;
    num_front_blocks += super.pivot_blocks + super.update_blocks;
    if (super.parent >= 0) ++supernodes_[super.parent].num_children;
  }
  front_blocks_.resize(static_cast<std::size_t>(num_front_blocks));
  for (const int block : order) {
    const Supernode& super = supernodes_[super_of[block]];
    rank[block] = super.first + place_of[block];
    front_blocks_[super.blocks + place_of[block]] = block;
  }
  int num_children = 0;
  for (std::size_t k = 0; k < post.size(); ++k) {
    Supernode& super = supernodes_[k];
    super.children = num_children;
    num_children += std::exchange(super.num_children, 0);
    int* updates = front_blocks_.data() + super.blocks + super.pivot_blocks;
    int* end = updates;
    for (const int position : structure[nodes[kept[post[k]]].last]) *end++ = order[position];
    std::sort(updates, end, [&](int x, int y) { return rank[x] < rank[y]; });
  }
  children_.resize(static_cast<std::size_t>(num_children));
  for (std::size_t k = 0; k < post.size(); ++k)
    if (supernodes_[k].parent >= 0) {
      Supernode& above = supernodes_[supernodes_[k].parent];
      children_[above.children + above.num_children++] = static_cast<int>(k);
    }
  const auto position_in = [&](const Supernode& super, int block) {
    if (&supernodes_[super_of[block]] == &super) return place_of[block];
    const int* first = front_blocks_.data() + super.blocks + super.pivot_blocks;
    const int* found =
        std::lower_bound(first, first + super.update_blocks, block, [&](int x, int y) { return rank[x] < rank[y]; });
    return super.pivot_blocks + static_cast<int>(found - first);
  };
  parent_position_.assign(front_blocks_.size(), -1);
  for (const Supernode& super : supernodes_) {
    if (super.parent < 0) continue;
    for (int k = super.pivot_blocks; k < super.pivot_blocks + super.update_blocks; ++k)
      parent_position_[super.blocks + k] = position_in(supernodes_[super.parent], front_blocks_[super.blocks + k]);
  }
  // Block (a, b), b eliminated first, lies in b's L; block (b, a) in b's U, or in its L when a is a pivot there too.
  const auto eliminated_first = [&](const Pair& pair) { return rank[pair.i] < rank[pair.j] ? pair.i : pair.j; };
  for (const Pair& pair : pairs_) ++supernodes_[super_of[eliminated_first(pair)]].last_entry;
  int num_entries = 0;
  for (Supernode& super : supernodes_) {
    super.first_entry = num_entries;
    num_entries += std::exchange(super.last_entry, num_entries);
  }
  block_entries_.resize(pairs_.size());
  for (const Pair& pair : pairs_) {
    const int b = eliminated_first(pair), a = pair.i + pair.j - b;
    Supernode& super = supernodes_[super_of[b]];
    const bool swapped = a != pair.i;
    block_entries_[super.last_entry++] = {swapped ? pair.upper : pair.lower, swapped ? pair.lower : pair.upper,
                                          position_in(super, a), position_in(super, b)};
  }

  sizes_.clear();
  set_sizes(block_sizes);
  find_room();
  pivots_.assign(static_cast<std::size_t>(size_), 0);
  x_.assign(static_cast<std::size_t>(size_), 0.0);
}

/// For the sizes at hand, the largest ones.
void BlockLu::find_room() {
  room_ = Room();
  Index top = 0;
  for (const Supernode& super : supernodes_) {
    const Index p = super.pivots, u = super.updates;
    room_.factors += (p + 2 * u) * p;
    // The stack holds the children's updates until the parent has taken them.
    for (int c = super.children; c < super.children + super.num_children; ++c) {
      const Index updates = supernodes_[children_[c]].updates;
      top -= updates * updates;
    }
    top += u * u;
    room_.stack = std::max(room_.stack, top);
    room_.widest = std::max(room_.widest, u);
  }
  factors_.reserve(static_cast<std::size_t>(room_.factors));
  stack_.reserve(static_cast<std::size_t>(room_.stack));
  schur_.reserve(static_cast<std::size_t>(room_.widest * room_.widest));
  update_.reserve(static_cast<std::size_t>(room_.widest));
}

void BlockLu::make_room() {
  factors_.resize(static_cast<std::size_t>(room_.factors));
  stack_.resize(static_cast<std::size_t>(room_.stack));
  schur_.resize(static_cast<std::size_t>(room_.widest * room_.widest));
  update_.resize(static_cast<std::size_t>(room_.widest));
}

void BlockLu::set_sizes(const std::vector<int>& block_sizes) {
  if (block_sizes == sizes_ && !sizes_.empty()) return;
  sizes_ = block_sizes;
  front_rows_.resize(front_blocks_.size());
  row_of_.resize(sizes_.size());
  permutation_.resize(static_cast<std::size_t>(size_));
  int row = 0, num_rows = 0;
  for (Supernode& super : supernodes_) {
    super.first = row;
    for (int k = 0; k < super.pivot_blocks; ++k) {
      const int block = front_blocks_[super.blocks + k];
      front_rows_[super.blocks + k] = row - super.first;
      row_of_[block] = row;
      for (int r = 0; r < sizes_[block]; ++r) permutation_[row++] = offsets_[block] + r;
    }
    super.pivots = row - super.first;
    super.updates = 0;
    for (int k = super.pivot_blocks; k < super.pivot_blocks + super.update_blocks; ++k) {
      front_rows_[super.blocks + k] = super.pivots + super.updates;
      super.updates += sizes_[front_blocks_[super.blocks + k]];
    }
    super.rows = num_rows;
    num_rows += super.updates;
  }
  permutation_.resize(static_cast<std::size_t>(row));
  rows_.resize(static_cast<std::size_t>(num_rows));
  relative_.resize(rows_.size());
  Index num_factors = 0;
  for (Supernode& super : supernodes_) {
    const int p = super.pivots, n = p + super.updates;
    const int* blocks = front_blocks_.data() + super.blocks;
    const int* up = super.parent < 0 ? nullptr : front_rows_.data() + supernodes_[super.parent].blocks;
    Index u = super.rows;
    for (int k = super.pivot_blocks; k < super.pivot_blocks + super.update_blocks; ++k)
      for (int r = 0; r < sizes_[blocks[k]]; ++r, ++u) {
        rows_[u] = row_of_[blocks[k]] + r;
        relative_[u] = up[parent_position_[super.blocks + k]] + r;
      }
    super.lower = num_factors;
    super.upper = super.lower + static_cast<Index>(n) * p;
    num_factors = super.upper + static_cast<Index>(p) * super.updates;
  }
}

void BlockLu::extend_add(const Supernode& super, double*& top) {
  const int p = super.pivots, u = super.updates, n = p + u;
  double* l = factors_.data() + super.lower;
  double* up = factors_.data() + super.upper;
  for (int c = super.num_children - 1; c >= 0; --c) {  // the last child's is on top of the stack
    const Supernode& child = supernodes_[children_[super.children + c]];
    const int m = child.updates;
    const int* rows = relative_.data() + child.rows;
    top -= static_cast<Index>(m) * m;
    const double* from = top;
    const int inside = static_cast<int>(std::lower_bound(rows, rows + m, p) - rows);
    for (int j = 0; j < m; ++j, from += m) {
      if (j < inside) {
        double* to = l + static_cast<Index>(rows[j]) * n;
        for (int i = 0; i < m; ++i) to[rows[i]] += from[i];
      } else {
        double* to = up + static_cast<Index>(rows[j] - p) * p;
        for (int i = 0; i < inside; ++i) to[rows[i]] += from[i];
        to = schur_.data() + static_cast<Index>(rows[j] - p) * u - p;
        for (int i = inside; i < m; ++i) to[rows[i]] += from[i];
      }
    }
  }
}

void BlockLu::extend_add_symmetric(const Supernode& super, double*& top) {
  const int p = super.pivots, u = super.updates, n = p + u;
  for (int c = super.num_children - 1; c >= 0; --c) {
    const Supernode& child = supernodes_[children_[super.children + c]];
    const int m = child.updates;
    const int* rows = relative_.data() + child.rows;
    top -= static_cast<Index>(m) * m;
    const double* from = top;
    for (int j = 0; j < m; ++j, from += m) {
      double* to = rows[j] < p ? factors_.data() + super.lower + static_cast<Index>(rows[j]) * n
                               : schur_.data() + static_cast<Index>(rows[j] - p) * u - p;
      for (int i = j; i < m; ++i) to[rows[i]] += from[i];
    }
  }
}

void BlockLu::assemble(const double* values, double* fronts) const {
  for (const Supernode& super : supernodes_) write_front(super, false, fronts, copy_from(values));
}

void BlockLu::add_diagonal(const Supernode& super, const BlockDiagonal& added) {
  const int n = super.pivots + super.updates;
  for (int k = super.blocks; k < super.blocks + super.pivot_blocks; ++k) {
    const int size = sizes_[front_blocks_[k]];
    const Eigen::Matrix3d& x = added[static_cast<std::size_t>(front_blocks_[k])];
    double* to = factors_.data() + super.lower + static_cast<Index>(front_rows_[k]) * (n + 1);
    if (size == 3) {  // by far the most
      const double* from = x.data();
      for (int c = 0; c < 3; ++c, to += n, from += 3) to[0] += from[0], to[1] += from[1], to[2] += from[2];
      continue;
    }
    for (int c = 0; c < size; ++c, to += n)
      for (int r = 0; r < size; ++r) to[r] += x(r, c);
  }
}

bool BlockLu::factor() { return factor(copy_from(values_.data())); }

bool BlockLu::factor_symmetric() { return factor_symmetric(copy_from(values_.data())); }

bool BlockLu::factor(const double* fronts, const BlockDiagonal& added, bool on_diagonal) {
  return factor_fronts(false, on_diagonal, [&](const Supernode& super) {
    const std::size_t count = static_cast<std::size_t>(super.pivots + 2 * super.updates) * super.pivots;
    std::memcpy(factors_.data() + super.lower, fronts + super.lower, count * sizeof(double));
    add_diagonal(super, added);
  });
}

void BlockLu::solve(VectorRef rhs) const {
  const DenseKernels& kernels = dense_kernels();
  double* x = x_.data();
  for (std::size_t k = 0; k < permutation_.size(); ++k) x[k] = rhs[permutation_[k]];
  for (const Supernode& super : supernodes_) {
    if (super.pivots == 0) continue;
    const double* l = factors_.data() + super.lower;
    kernels.forward(super.pivots, super.updates, l, symmetric_ ? nullptr : pivots_.data() + super.first,
                    x + super.first, update_.data());
    const int* rows = rows_.data() + super.rows;
    for (int i = 0; i < super.updates; ++i) x[rows[i]] += update_[i];  // update_ = -L21 x
  }
  for (auto super = supernodes_.rbegin(); super != supernodes_.rend(); ++super) {
    if (super->pivots == 0) continue;
    const int* rows = rows_.data() + super->rows;
    for (int i = 0; i < super->updates; ++i) update_[i] = x[rows[i]];
    const double* l = factors_.data() + super->lower;
    kernels.backward(super->pivots, super->updates, l, factors_.data() + super->upper, x + super->first,
                     update_.data());
  }
  for (std::size_t k = 0; k < permutation_.size(); ++k) rhs[permutation_[k]] = x[k];
}

}  // namespace signorini
