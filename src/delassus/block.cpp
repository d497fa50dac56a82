#include "signorini/delassus/block.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>

#include "explicit_system.hpp"
#include "islands.hpp"
#include "require.hpp"
#include "signorini/errors.hpp"

namespace signorini {
namespace {

constexpr double kLargest = 1e100;

}  // namespace

void BlockDelassus::reset(const ConstraintSets& sets, const std::vector<Pair>& blocks) {
  const auto num_sets = static_cast<int>(sets.num_sets());
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    const Pair& p = blocks[k];
    if (p.second >= 0 && p.second < p.first && p.first < num_sets && (k == 0 || blocks[k - 1] < p)) continue;
    std::ostringstream message;
    message << "is (" << p.first << ", " << p.second << "), must be (i, j) with " << num_sets
            << " > i > j >= 0, in ascending order and each once";
    throw InvalidInput("blocks[" + std::to_string(k) + "]", message.str());
  }
  offsets_.resize(static_cast<std::size_t>(num_sets) + 1);
  diagonal_starts_.resize(static_cast<std::size_t>(num_sets));
  pairs_ = blocks;
  starts_.resize(blocks.size());
  Index values = 0;
  offsets_[0] = 0;
  for (int i = 0; i < num_sets; ++i) {
    const auto size = static_cast<int>(sets[i].size());
    offsets_[static_cast<std::size_t>(i) + 1] = offsets_[static_cast<std::size_t>(i)] + size;
    diagonal_starts_[static_cast<std::size_t>(i)] = values;
    values += size * size;
  }
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    starts_[k] = values;
    values += size_of(blocks[k].first) * size_of(blocks[k].second);
  }
  values_.assign(static_cast<std::size_t>(values), 0.0);
  first_pair_.resize(static_cast<std::size_t>(num_sets) + 1);
  int k = 0;
  for (int i = 0; i <= num_sets; ++i) {
    while (k < static_cast<int>(pairs_.size()) && pairs_[static_cast<std::size_t>(k)].first < i) ++k;
    first_pair_[static_cast<std::size_t>(i)] = k;
  }
}

void BlockDelassus::check(const ConstraintSets& sets) const {
  bool fits = sets.num_sets() == num_sets();
  for (int i = 0; fits && i < static_cast<int>(num_sets()); ++i) fits = sets[i].size() == size_of(i);
  if (!fits) throw InvalidInput("sets", "are not those that the Delassus operator was reset with");
  if (sum_is_bounded(values_.data(), static_cast<Index>(values_.size()))) return;
  // The upper triangles of the diagonal blocks are never read, and may hold anything.
  const auto refuse = [](int i, int j, double value) {
    require(false, "delassus block (" + std::to_string(i) + ", " + std::to_string(j) + ")", value, "within +-1e100");
  };
  for (int i = 0; i < static_cast<int>(num_sets()); ++i)
    for (int c = 0, n = size_of(i); c < n; ++c)
      for (int r = c; r < n; ++r)
        if (!(std::abs(diagonal_block(i)[c * n + r]) <= kLargest)) refuse(i, i, diagonal_block(i)[c * n + r]);
  for (Index k = 0; k < num_blocks(); ++k)
    for (int v = 0; v < size_of(pair(k).first) * size_of(pair(k).second); ++v)
      if (!(std::abs(block(k)[v]) <= kLargest)) refuse(pair(k).first, pair(k).second, block(k)[v]);
}

void BlockDelassus::apply(const ConstVectorRef& x, VectorRef y) const {
  for (int i = 0; i < static_cast<int>(num_sets()); ++i) {
    const double* a = diagonal_block(i);
    const int o = offsets_[static_cast<std::size_t>(i)];
    if (size_of(i) == 1) {
      y[o] = a[0] * x[o];
      continue;
    }
    y[o] = a[0] * x[o] + a[1] * x[o + 1] + a[2] * x[o + 2];
    y[o + 1] = a[1] * x[o] + a[4] * x[o + 1] + a[5] * x[o + 2];
    y[o + 2] = a[2] * x[o] + a[5] * x[o + 1] + a[8] * x[o + 2];
  }
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    const int i = pairs_[k].first, j = pairs_[k].second;
    add_block_products(size_of(i), size_of(j), values_.data() + starts_[k], x.data() + offsets_[i],
                       x.data() + offsets_[j], y.data() + offsets_[i], y.data() + offsets_[j]);
  }
}

void BlockDelassus::diagonal(VectorRef diagonal) const {
  for (int i = 0; i < static_cast<int>(num_sets()); ++i)
    for (int r = 0, n = size_of(i); r < n; ++r) diagonal[offsets_[i] + r] = diagonal_block(i)[r * n + r];
}

SparseMatrix BlockDelassus::matrix() const {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(2 * values_.size());
  for (int i = 0; i < static_cast<int>(num_sets()); ++i) {
    const int o = offsets_[i], n = size_of(i);
    for (int c = 0; c < n; ++c)
      for (int r = 0; r < n; ++r)
        entries.emplace_back(o + r, o + c, diagonal_block(i)[std::min(r, c) * n + std::max(r, c)]);
  }
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    const int i = pairs_[k].first, j = pairs_[k].second, n = size_of(i);
    for (int c = 0; c < size_of(j); ++c)
      for (int r = 0; r < n; ++r) {
        const double value = values_[starts_[k] + c * n + r];
        entries.emplace_back(offsets_[i] + r, offsets_[j] + c, value);
        entries.emplace_back(offsets_[j] + c, offsets_[i] + r, value);
      }
  }
  SparseMatrix out(size(), size());
  out.setFromTriplets(entries.begin(), entries.end());
  return out;
}

std::vector<int> BlockDelassus::islands(const ConstraintSets& sets) const {
  std::vector<int> labels;
  label_islands(sets, labels);
  return labels;
}

void BlockDelassus::label_islands(const ConstraintSets&, std::vector<int>& labels) const {
  IslandForest forest(static_cast<int>(num_sets()), labels);
  for (std::size_t k = 0; k < pairs_.size() && forest.trees() > 1; ++k) forest.join(pairs_[k].first, pairs_[k].second);
  forest.finish();
}

std::shared_ptr<const DelassusOperator> BlockDelassus::restrict(const std::vector<Index>& rows) const {
  // Rows come as whole sets.
  std::vector<int> local(static_cast<std::size_t>(num_sets()), -1);
  auto part = std::make_shared<BlockDelassus>();
  ConstraintSets sets;
  std::vector<int> chosen;
  for (std::size_t r = 0; r < rows.size();) {
    const auto i = static_cast<int>(std::upper_bound(offsets_.begin(), offsets_.end(), static_cast<int>(rows[r])) -
                                    offsets_.begin() - 1);
    local[static_cast<std::size_t>(i)] = static_cast<int>(chosen.size());
    chosen.push_back(i);
    if (size_of(i) == 3)
      sets.add_friction_cone(0.0);
    else
      sets.add_half_line();
    r += static_cast<std::size_t>(size_of(i));
  }
  struct Source {
    Pair pair;
    std::size_t block;
    bool transposed;
  };
  std::vector<Source> sources;
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    const int i = local[static_cast<std::size_t>(pairs_[k].first)],
              j = local[static_cast<std::size_t>(pairs_[k].second)];
    if (i >= 0 && j >= 0) sources.push_back({{std::max(i, j), std::min(i, j)}, k, i < j});
  }
  std::sort(sources.begin(), sources.end(), [](const Source& a, const Source& b) { return a.pair < b.pair; });
  std::vector<Pair> blocks;
  for (const Source& source : sources) blocks.push_back(source.pair);
  part->reset(sets, blocks);
  for (std::size_t i = 0; i < chosen.size(); ++i)
    std::copy_n(diagonal_block(chosen[i]), size_of(chosen[i]) * size_of(chosen[i]),
                part->diagonal_block(static_cast<Index>(i)));
  for (std::size_t b = 0; b < sources.size(); ++b) {
    const Pair& from = pairs_[sources[b].block];
    const double* value = block(static_cast<Index>(sources[b].block));
    double* to = part->block(static_cast<Index>(b));
    const int n = size_of(from.first), m = size_of(from.second);
    for (int c = 0; c < m; ++c)
      for (int r = 0; r < n; ++r) to[sources[b].transposed ? r * m + c : c * n + r] = value[c * n + r];
  }
  return part;
}

void BlockDelassus::prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
                            std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->stride = 0;
  known->diagonal.resize(static_cast<std::size_t>(num_sets()));
  for (std::size_t i = 0; i < known->diagonal.size(); ++i) known->diagonal[i] = values_.data() + diagonal_starts_[i];
  known->blocks.resize(pairs_.size());
  for (std::size_t k = 0; k < pairs_.size(); ++k)
    known->blocks[k] = {pairs_[k].first, pairs_[k].second, values_.data() + starts_[k]};
  known->setup(sets, scale, compliance);
}

void BlockDelassus::prepare_part(const ConstraintSets&, const std::vector<int>& part, const ConstraintSets& part_sets,
                                 const ConstVectorRef& scale, const ConstVectorRef& compliance,
                                 std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->stride = 0;
  const auto count = static_cast<int>(part.size());
  known->local.resize(static_cast<std::size_t>(num_sets()));
  known->diagonal.resize(part.size());
  known->blocks.clear();
  for (int i = 0; i < count; ++i) {
    known->local[part[i]] = i;
    known->diagonal[i] = diagonal_block(part[i]);
    for (int k = first_pair_[part[i]]; k < first_pair_[part[i] + 1]; ++k) {
      const int global = pairs_[k].second, j = known->local[global];  // which an earlier part may have left
      if (j >= 0 && j < i && part[j] == global) known->blocks.push_back({i, j, values_.data() + starts_[k]});
    }
  }
  known->setup(part_sets, scale, compliance);
}

}  // namespace signorini
