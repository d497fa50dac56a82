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
  std::vector<int> offset(block_sizes.size() + 1, 0);
  for (int i = 0; i < num_blocks; ++i) offset[i + 1] = offset[i] + block_sizes[i];
  size_ = offset[num_blocks];
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
  std::vector<int> row_of(block_sizes.size());  // first row of each block, in elimination order
  std::vector<int> node_of_block(block_sizes.size());
  permutation_.resize(static_cast<std::size_t>(size_));
  Index row = 0;
  for (std::size_t k = 0; k < post.size(); ++k) {
    Node& node = nodes[kept[post[k]]];
    Supernode& super = supernodes_[k];
    std::sort(node.pivots.begin(), node.pivots.end());
    super.first = static_cast<int>(row);
    super.pivots = node.p;
    super.updates = node.u;
    super.parent = node_parent[post[k]] < 0 ? -1 : new_index[node_parent[post[k]]];
    if (super.parent >= 0) children_[super.parent].push_back(static_cast<int>(k));
    for (const int block : node.pivots) {
      row_of[block] = static_cast<int>(row);
      node_of_block[block] = static_cast<int>(k);
      for (int r = 0; r < size_of(block); ++r) permutation_[row++] = offset[order[block]] + r;
    }
  }

  // Rows, positions in the parents' fronts, storage.
  rows_.clear();
  relative_.clear();
  Index num_factors = 0, stack = 0, top = 0, largest = 0, widest = 0;
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    Supernode& super = supernodes_[k];
    Node& node = nodes[kept[post[k]]];
    std::sort(node.updates.begin(), node.updates.end(), [&](int a, int b) { return row_of[a] < row_of[b]; });
    super.rows = static_cast<Index>(rows_.size());
    for (const int block : node.updates)
      for (int r = 0; r < size_of(block); ++r) rows_.push_back(row_of[block] + r);
    const Index n = super.pivots + super.updates, u = super.updates;
    super.lower = num_factors;
    super.upper = num_factors + n * super.pivots;
    num_factors = super.upper + static_cast<Index>(super.pivots) * u;
    // The stack holds the children's updates until the parent has taken them.
    for (const int c : children_[k]) top -= static_cast<Index>(supernodes_[c].updates) * supernodes_[c].updates;
    top += u * u;
    stack = std::max(stack, top);
    largest = std::max(largest, u * u);
    widest = std::max(widest, u);
  }
  relative_.resize(rows_.size());
  for (Supernode& super : supernodes_) {
    super.relative = super.rows;
    if (super.parent < 0) continue;
    const Supernode& up = supernodes_[super.parent];
    const int* first = rows_.data() + up.rows;
    for (int i = 0; i < super.updates; ++i) {
      const int r = rows_[super.rows + i];
      const int local = r - up.first;
      relative_[super.relative + i] =
          local < up.pivots ? local
                            : up.pivots + static_cast<int>(std::lower_bound(first, first + up.updates, r) - first);
    }
  }
  factors_.assign(static_cast<std::size_t>(num_factors), 0.0);
  stack_.assign(static_cast<std::size_t>(stack), 0.0);
  schur_.assign(static_cast<std::size_t>(largest), 0.0);
  pivots_.assign(static_cast<std::size_t>(size_), 0);
  x_.assign(static_cast<std::size_t>(size_), 0.0);
  update_.assign(static_cast<std::size_t>(widest), 0.0);

  // Where each block of the matrix goes: block (a, b) with b eliminated first lies in b's L; block (b, a) in b's U,
  // or in its L when a is a pivot of the same supernode.
  std::vector<std::vector<Entry>> entries(supernodes_.size());
  std::vector<int> position(block_sizes.size());
  for (int k = 0; k < num_blocks; ++k) position[order[k]] = k;
  for (const Pair& pair : pairs_) {
    int a = pair.i, b = pair.j;
    Index ab = pair.lower, ba = pair.upper;
    if (row_of[position[a]] < row_of[position[b]]) std::swap(a, b), std::swap(ab, ba);
    const int ra = row_of[position[a]], rb = row_of[position[b]];
    const int k = node_of_block[position[b]];
    const Supernode& super = supernodes_[k];
    const int n = super.pivots + super.updates, column = rb - super.first;
    const int na = block_sizes[a], nb = block_sizes[b];
    if (ra - super.first < super.pivots) {
      const int r = ra - super.first;
      entries[k].push_back({ab, super.lower + static_cast<Index>(column) * n + r, na, nb, n});
      if (a != b) entries[k].push_back({ba, super.lower + static_cast<Index>(r) * n + column, nb, na, n});
    } else {
      const int* first = rows_.data() + super.rows;
      const int r = static_cast<int>(std::lower_bound(first, first + super.updates, ra) - first);
      entries[k].push_back({ab, super.lower + static_cast<Index>(column) * n + super.pivots + r, na, nb, n});
      entries[k].push_back({ba, super.upper + static_cast<Index>(r) * super.pivots + column, nb, na, super.pivots});
    }
  }
  entries_.clear();
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    supernodes_[k].entries_begin = static_cast<Index>(entries_.size());
    entries_.insert(entries_.end(), entries[k].begin(), entries[k].end());
    supernodes_[k].entries_end = static_cast<Index>(entries_.size());
  }
}

bool BlockLu::factor() {
  const DenseKernels& kernels = dense_kernels();
  sign_ = 1;
  std::fill(factors_.begin(), factors_.end(), 0.0);
  double* top = stack_.data();
  for (std::size_t k = 0; k < supernodes_.size(); ++k) {
    const Supernode& super = supernodes_[k];
    const int p = super.pivots, u = super.updates, n = p + u;
    double* l = factors_.data() + super.lower;
    double* up = factors_.data() + super.upper;
    double* schur = schur_.data();
    if (u > 0) std::memset(schur, 0, static_cast<std::size_t>(u) * u * sizeof(double));
    for (Index e = super.entries_begin; e < super.entries_end; ++e) {
      const Entry& entry = entries_[e];
      const double* from = values_.data() + entry.value;
      double* to = factors_.data() + entry.target;
      for (int c = 0; c < entry.columns; ++c)
        for (int r = 0; r < entry.rows; ++r) to[c * entry.stride + r] = *from++;
    }
    // Extend-add of the children, the last of which is on top of the stack.
    for (auto c = children_[k].rbegin(); c != children_[k].rend(); ++c) {
      const Supernode& child = supernodes_[*c];
      const int m = child.updates;
      const int* rows = relative_.data() + child.relative;
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
          to = schur + static_cast<Index>(rows[j] - p) * u - p;
          for (int i = inside; i < m; ++i) to[rows[i]] += from[i];
        }
      }
    }
    const int sign = kernels.factor_front(p, u, l, up, schur, pivots_.data() + super.first);
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

void BlockLu::solve(VectorRef rhs) const {
  const DenseKernels& kernels = dense_kernels();
  double* x = x_.data();
  for (Index k = 0; k < size_; ++k) x[k] = rhs[permutation_[k]];
  for (const Supernode& super : supernodes_) {
    kernels.forward(super.pivots, super.updates, factors_.data() + super.lower, pivots_.data() + super.first,
                    x + super.first, update_.data());
    const int* rows = rows_.data() + super.rows;
    for (int i = 0; i < super.updates; ++i) x[rows[i]] += update_[i];  // update_ = -L21 x
  }
  for (auto super = supernodes_.rbegin(); super != supernodes_.rend(); ++super) {
    const int* rows = rows_.data() + super->rows;
    for (int i = 0; i < super->updates; ++i) update_[i] = x[rows[i]];
    kernels.backward(super->pivots, super->updates, factors_.data() + super->lower, factors_.data() + super->upper,
                     x + super->first, update_.data());
  }
  for (Index k = 0; k < size_; ++k) rhs[permutation_[k]] = x[k];
}

}  // namespace signorini
