#include "block_lu.hpp"

#include <Eigen/OrderingMethods>
#include <algorithm>
#include <cstring>
#include <numeric>

#include "dense_kernels.hpp"

namespace signorini {
namespace {

using Lists = std::vector<std::vector<int>>;

/// Fill-reducing order of the block graph: order[k] = block eliminated k-th.
std::vector<int> minimum_degree(const Lists& neighbours) {
  const int n = static_cast<int>(neighbours.size());
  std::vector<int> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  std::size_t edges = 0;
  for (const auto& list : neighbours) edges += list.size();
  const double full = 0.5 * n * (n - 1.0);
  if (n < 4 || static_cast<double>(edges) > 0.9 * full) return order;
  SparseMatrix pattern(n, n);  // one triangle: the ordering symmetrises it
  pattern.reserve(static_cast<Index>(edges) + n);
  for (int j = 0; j < n; ++j) {
    pattern.startVec(j);
    pattern.insertBack(j, j) = 1.0;
    for (const int i : neighbours[static_cast<std::size_t>(j)]) pattern.insertBack(i, j) = 1.0;
  }
  pattern.finalize();
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> permutation;
  Eigen::AMDOrdering<int>()(pattern, permutation);
  for (int k = 0; k < n; ++k) order[static_cast<std::size_t>(k)] = permutation.indices()[k];
  return order;
}

/// Elimination tree of a symmetric pattern given by the lists of higher-numbered neighbours (Liu 1992).
std::vector<int> elimination_tree(const Lists& lower) {
  const int n = static_cast<int>(lower.size());
  Lists upper(lower.size());  // lower-numbered neighbours
  for (int j = 0; j < n; ++j)
    for (const int i : lower[j]) upper[i].push_back(j);
  std::vector<int> parent(n, -1), ancestor(n, -1);
  for (int j = 0; j < n; ++j) {
    for (int i : upper[j]) {
      while (ancestor[i] != -1 && ancestor[i] != j) {
        const int next = ancestor[i];
        ancestor[i] = j;
        i = next;
      }
      if (ancestor[i] == -1) ancestor[i] = j, parent[i] = j;
    }
  }
  return parent;
}

Lists children_of(const std::vector<int>& parent, std::vector<int>* roots) {
  Lists children(parent.size());
  for (int j = 0; j < static_cast<int>(parent.size()); ++j) {
    if (parent[j] >= 0)
      children[parent[j]].push_back(j);
    else if (roots)
      roots->push_back(j);
  }
  return children;
}

std::vector<int> postorder(const std::vector<int>& parent) {
  std::vector<int> roots, order, stack;
  const Lists children = children_of(parent, &roots);
  std::vector<std::size_t> next(parent.size(), 0);
  for (const int root : roots) {
    stack.push_back(root);
    while (!stack.empty()) {
      const int j = stack.back();
      if (next[j] < children[j].size()) {
        stack.push_back(children[j][next[j]++]);
      } else {
        order.push_back(j);
        stack.pop_back();
      }
    }
  }
  return order;
}

/// Renames the blocks: new name k for order[k].
Lists renumber(const Lists& lower, const std::vector<int>& order) {
  const int n = static_cast<int>(lower.size());
  std::vector<int> position(n);
  for (int k = 0; k < n; ++k) position[order[k]] = k;
  Lists out(lower.size());
  for (int j = 0; j < n; ++j)
    for (const int i : lower[j]) out[std::min(position[i], position[j])].push_back(std::max(position[i], position[j]));
  for (auto& list : out) std::sort(list.begin(), list.end());
  return out;
}

/// A supernode while supernodes are being merged: its pivots and update rows are blocks.
struct Node {
  std::vector<int> pivots, updates;
  int parent = -1;
  int p = 0, u = 0;    // rows
  double zeros = 0.0;  // entries of L that are zero by structure
  bool merged = false;
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

void BlockLu::analyze(const std::vector<int>& block_sizes, const Lists& neighbours) {
  const int num_blocks = static_cast<int>(block_sizes.size());
  offsets_.assign(block_sizes.size(), 0);
  size_ = 0;
  for (int i = 0; i < num_blocks; ++i) {
    offsets_[i] = static_cast<int>(size_);
    size_ += block_sizes[i];
  }
  sign_ = 0;

  // Storage of the matrix.
  pairs_.clear();
  Index num_values = 0;
  for (int j = 0; j < num_blocks; ++j) {
    pairs_.push_back({j, j, num_values, num_values});
    num_values += block_sizes[j] * block_sizes[j];
    for (const int i : neighbours[j]) {
      const Index count = block_sizes[i] * block_sizes[j];
      pairs_.push_back({i, j, num_values, num_values + count});
      num_values += 2 * count;
    }
  }
  values_.assign(static_cast<std::size_t>(num_values), 0.0);

  // Order of elimination, then the structure of each column of L.
  std::vector<int> order = minimum_degree(neighbours);
  Lists lower = renumber(neighbours, order);
  std::vector<int> parent = elimination_tree(lower);
  {
    const std::vector<int> post = postorder(parent);
    std::vector<int> composed(order.size());
    for (std::size_t k = 0; k < post.size(); ++k) composed[k] = order[post[k]];
    order = std::move(composed);
    lower = renumber(neighbours, order);
    parent = elimination_tree(lower);
  }
  Lists structure(lower.size());
  {
    const Lists children = children_of(parent, nullptr);
    std::vector<int> mark(lower.size(), -1);
    for (int j = 0; j < num_blocks; ++j) {
      auto& list = structure[j];
      mark[j] = j;
      const auto merge = [&](const std::vector<int>& from) {
        for (const int i : from)
          if (mark[i] != j) mark[i] = j, list.push_back(i);
      };
      merge(lower[j]);
      for (const int c : children[j]) merge(structure[c]);
      std::sort(list.begin(), list.end());
    }
  }

  // Supernodes: first the fundamental ones, then merged with their parents where that pays.
  const auto size_of = [&](int k) { return block_sizes[order[k]]; };
  std::vector<Node> nodes;
  std::vector<int> node_of(lower.size(), -1);
  for (int j = 0; j < num_blocks; ++j) {
    const bool joins = j > 0 && parent[j - 1] == j && structure[j - 1].size() == structure[j].size() + 1;
    if (!joins) nodes.emplace_back();
    Node& node = nodes.back();
    node_of[j] = static_cast<int>(nodes.size()) - 1;
    node.pivots.push_back(j);
    node.p += size_of(j);
    node.updates = structure[j];
  }
  for (Node& node : nodes) {
    for (const int i : node.updates) node.u += size_of(i);
    node.parent = node.updates.empty() ? -1 : node_of[node.updates.front()];
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
    nodes[t].pivots.insert(nodes[t].pivots.end(), nodes[s].pivots.begin(), nodes[s].pivots.end());
    nodes[t].p += nodes[s].p;
    nodes[t].zeros = zeros;
    nodes[s].merged = true;
    representative[s] = t;
  }
  // Number the remaining supernodes in postorder, and the blocks along.
  std::vector<int> node_parent;
  std::vector<int> kept;
  {
    std::vector<int> index(nodes.size(), -1);
    for (int s = 0; s < num_nodes; ++s)
      if (!nodes[s].merged) index[s] = static_cast<int>(kept.size()), kept.push_back(s);
    for (const int s : kept) node_parent.push_back(nodes[s].parent < 0 ? -1 : index[find(nodes[s].parent)]);
  }
  const std::vector<int> post = postorder(node_parent);
  std::vector<int> new_index(post.size());
  for (std::size_t k = 0; k < post.size(); ++k) new_index[post[k]] = static_cast<int>(k);

  supernodes_.assign(post.size(), Supernode());
  children_.assign(post.size(), {});
  front_blocks_.clear();
  std::vector<int> rank(block_sizes.size());      // of each block, in the order of elimination
  std::vector<int> super_of(block_sizes.size());  // in which it is a pivot
  std::vector<int> place_of(block_sizes.size());  // its position among the pivots there
  int next_rank = 0;
  for (std::size_t k = 0; k < post.size(); ++k) {
    Node& node = nodes[kept[post[k]]];
    Supernode& super = supernodes_[k];
    std::sort(node.pivots.begin(), node.pivots.end());
    super.parent = node_parent[post[k]] < 0 ? -1 : new_index[node_parent[post[k]]];
    if (super.parent >= 0) children_[super.parent].push_back(static_cast<int>(k));
    super.pivot_blocks = static_cast<int>(node.pivots.size());
    super.update_blocks = static_cast<int>(node.updates.size());
    for (std::size_t position = 0; position < node.pivots.size(); ++position) {
      const int block = order[node.pivots[position]];
      rank[block] = next_rank++;
      super_of[block] = static_cast<int>(k);
      place_of[block] = static_cast<int>(position);
    }
  }
  for (std::size_t k = 0; k < post.size(); ++k) {
    Node& node = nodes[kept[post[k]]];
    Supernode& super = supernodes_[k];
    super.blocks = static_cast<int>(front_blocks_.size());
    for (const int position : node.pivots) front_blocks_.push_back(order[position]);
    for (const int position : node.updates) front_blocks_.push_back(order[position]);
    std::sort(front_blocks_.end() - super.update_blocks, front_blocks_.end(),
              [&](int x, int y) { return rank[x] < rank[y]; });
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
  std::vector<std::vector<BlockEntry>> entries(supernodes_.size());
  for (const Pair& pair : pairs_) {
    int a = pair.i, b = pair.j;
    Index ab = pair.lower, ba = pair.upper;
    if (rank[a] < rank[b]) std::swap(a, b), std::swap(ab, ba);
    const Supernode& super = supernodes_[super_of[b]];
    entries[super_of[b]].push_back({ab, ba, position_in(super, a), position_in(super, b)});
  }
  block_entries_.clear();
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    block_entries_.insert(block_entries_.end(), entries[k].begin(), entries[k].end());
    supernodes_[k].block_entries = static_cast<int>(block_entries_.size());
  }

  // Room for the largest sizes.
  entries_.reserve(2 * pairs_.size());
  sizes_.clear();
  set_sizes(block_sizes);
  Index num_factors = 0, stack = 0, top = 0, largest = 0, widest = 0;
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    const Index p = supernodes_[k].pivots, u = supernodes_[k].updates;
    num_factors += (p + 2 * u) * p;
    // The stack holds the children's updates until the parent has taken them.
    for (const int c : children_[k]) top -= static_cast<Index>(supernodes_[c].updates) * supernodes_[c].updates;
    top += u * u;
    stack = std::max(stack, top);
    largest = std::max(largest, u * u);
    widest = std::max(widest, u);
  }
  factors_.assign(static_cast<std::size_t>(num_factors), 0.0);
  stack_.assign(static_cast<std::size_t>(stack), 0.0);
  schur_.assign(static_cast<std::size_t>(largest), 0.0);
  pivots_.assign(static_cast<std::size_t>(size_), 0);
  x_.assign(static_cast<std::size_t>(size_), 0.0);
  update_.assign(static_cast<std::size_t>(widest), 0.0);
}

void BlockLu::set_sizes(const std::vector<int>& block_sizes) {
  if (block_sizes == sizes_ && !sizes_.empty()) return;
  sizes_ = block_sizes;
  front_rows_.resize(front_blocks_.size());
  row_of_.resize(sizes_.size());
  permutation_.clear();
  int row = 0;
  for (Supernode& super : supernodes_) {
    super.first = row;
    for (int k = 0; k < super.pivot_blocks; ++k) {
      const int block = front_blocks_[super.blocks + k];
      front_rows_[super.blocks + k] = row - super.first;
      row_of_[block] = row;
      for (int r = 0; r < sizes_[block]; ++r) permutation_.push_back(offsets_[block] + r);
      row += sizes_[block];
    }
    super.pivots = row - super.first;
  }
  rows_.clear();
  Index num_factors = 0;
  for (Supernode& super : supernodes_) {
    super.rows = static_cast<Index>(rows_.size());
    super.updates = 0;
    for (int k = super.pivot_blocks; k < super.pivot_blocks + super.update_blocks; ++k) {
      const int block = front_blocks_[super.blocks + k];
      front_rows_[super.blocks + k] = super.pivots + super.updates;
      super.updates += sizes_[block];
      for (int r = 0; r < sizes_[block]; ++r) rows_.push_back(row_of_[block] + r);
    }
    super.lower = num_factors;
    super.upper = num_factors + static_cast<Index>(super.pivots + super.updates) * super.pivots;
    num_factors = super.upper + static_cast<Index>(super.pivots) * super.updates;
  }
  relative_.clear();
  for (const Supernode& super : supernodes_) {
    for (int k = super.pivot_blocks; k < super.pivot_blocks + super.update_blocks; ++k) {
      const int up =
          super.parent < 0 ? 0 : front_rows_[supernodes_[super.parent].blocks + parent_position_[super.blocks + k]];
      for (int r = 0; r < sizes_[front_blocks_[super.blocks + k]]; ++r) relative_.push_back(up + r);
    }
  }
  entries_.clear();
  int e = 0;
  for (Supernode& super : supernodes_) {
    super.entries_begin = static_cast<Index>(entries_.size());
    const int n = super.pivots + super.updates, p = super.pivots;
    const int *blocks = front_blocks_.data() + super.blocks, *first_rows = front_rows_.data() + super.blocks;
    for (; e < super.block_entries; ++e) {
      const BlockEntry& entry = block_entries_[e];
      const int na = sizes_[blocks[entry.a]], nb = sizes_[blocks[entry.b]];
      if (na == 0 || nb == 0) continue;
      const Index a = first_rows[entry.a], b = first_rows[entry.b];
      entries_.push_back({entry.ab, super.lower + b * n + a, na, nb, n, true});
      if (entry.a == entry.b) continue;
      if (entry.a < super.pivot_blocks)
        entries_.push_back({entry.ba, super.lower + a * n + b, nb, na, n, false});
      else
        entries_.push_back({entry.ba, super.upper + (a - p) * p + b, nb, na, p, false});
    }
    super.entries_end = static_cast<Index>(entries_.size());
  }
}

void BlockLu::extend_add(const Supernode& super, double*& top, const std::vector<int>& children) {
  const int p = super.pivots, u = super.updates, n = p + u;
  double* l = factors_.data() + super.lower;
  double* up = factors_.data() + super.upper;
  for (auto c = children.rbegin(); c != children.rend(); ++c) {  // the last child's is on top of the stack
    const Supernode& child = supernodes_[*c];
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

void BlockLu::extend_add_symmetric(const Supernode& super, double*& top, const std::vector<int>& children) {
  const int p = super.pivots, u = super.updates, n = p + u;
  for (auto c = children.rbegin(); c != children.rend(); ++c) {
    const Supernode& child = supernodes_[*c];
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

bool BlockLu::factor() {
  const DenseKernels& kernels = dense_kernels();
  sign_ = 1;
  symmetric_ = false;
  double* top = stack_.data();
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    const Supernode& super = supernodes_[k];
    const int p = super.pivots, u = super.updates;
    double* l = factors_.data() + super.lower;
    double* up = factors_.data() + super.upper;
    double* schur = schur_.data();
    std::memset(l, 0, static_cast<std::size_t>(p + 2 * u) * p * sizeof(double));  // and U, which follows
    if (u > 0) std::memset(schur, 0, static_cast<std::size_t>(u) * u * sizeof(double));
    for (Index e = super.entries_begin; e < super.entries_end; ++e) copy_in(entries_[e]);
    extend_add(super, top, children_[k]);
    const int sign = p == 0 ? 1 : kernels.factor_front(p, u, l, up, schur, pivots_.data() + super.first);
    if (sign == 0) {
      sign_ = 0;
      return false;
    }
    sign_ *= sign;
    if (u > 0) std::memcpy(top, schur, static_cast<std::size_t>(u) * u * sizeof(double));
    top += static_cast<Index>(u) * u;
  }
  return true;
}

bool BlockLu::factor_symmetric() {
  const DenseKernels& kernels = dense_kernels();
  sign_ = 1;
  symmetric_ = true;
  double* top = stack_.data();
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    const Supernode& super = supernodes_[k];
    const int p = super.pivots, u = super.updates;
    double* l = factors_.data() + super.lower;
    double* schur = schur_.data();
    std::memset(l, 0, static_cast<std::size_t>(p + u) * p * sizeof(double));
    if (u > 0) std::memset(schur, 0, static_cast<std::size_t>(u) * u * sizeof(double));
    for (Index e = super.entries_begin; e < super.entries_end; ++e)
      if (entries_[e].lower) copy_in(entries_[e]);
    extend_add_symmetric(super, top, children_[k]);
    if (p > 0 && kernels.cholesky_front(p, u, l, schur) == 0) {
      sign_ = 0;
      return false;
    }
    if (u > 0) std::memcpy(top, schur, static_cast<std::size_t>(u) * u * sizeof(double));
    top += static_cast<Index>(u) * u;
  }
  return true;
}

void BlockLu::solve(VectorRef rhs) const {
  const DenseKernels& kernels = dense_kernels();
  double* x = x_.data();
  for (std::size_t k = 0; k < permutation_.size(); ++k) x[k] = rhs[permutation_[k]];
  for (const Supernode& super : supernodes_) {
    if (super.pivots == 0) continue;
    const double* l = factors_.data() + super.lower;
    if (symmetric_)
      kernels.cholesky_forward(super.pivots, super.updates, l, x + super.first, update_.data());
    else
      kernels.forward(super.pivots, super.updates, l, pivots_.data() + super.first, x + super.first, update_.data());
    const int* rows = rows_.data() + super.rows;
    for (int i = 0; i < super.updates; ++i) x[rows[i]] += update_[i];  // update_ = -L21 x
  }
  for (auto super = supernodes_.rbegin(); super != supernodes_.rend(); ++super) {
    if (super->pivots == 0) continue;
    const int* rows = rows_.data() + super->rows;
    for (int i = 0; i < super->updates; ++i) update_[i] = x[rows[i]];
    const double* l = factors_.data() + super->lower;
    if (symmetric_)
      kernels.cholesky_backward(super->pivots, super->updates, l, x + super->first, update_.data());
    else
      kernels.backward(super->pivots, super->updates, l, factors_.data() + super->upper, x + super->first,
                       update_.data());
  }
  for (std::size_t k = 0; k < permutation_.size(); ++k) rhs[permutation_[k]] = x[k];
}

}  // namespace signorini
