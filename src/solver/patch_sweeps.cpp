// Letters in this file: l, t  scaled impulse and its velocity A l + b.
#include "signorini/solver/patch_sweeps.hpp"

#include <algorithm>
#include <cmath>

#include "delassus/explicit_system.hpp"
#include "no_malloc.hpp"

namespace signorini {
namespace {

// Sets of a patch in the first round, how that grows by the round, and at most.
constexpr double kFirstSize = 120.0, kGrowth = 1.3, kLargestSize = 2000.0;
constexpr double kInner = 0.5;  // of a patch, nearest to its centre: what needs no other patch in this round
// Sweeps of a patch, steps that their acceleration looks back on, what they are to leave of its error, and what they
// must leave at most, or else it is a knot.
constexpr int kPatchSweeps = 30, kMemory = 4;
constexpr double kPatchGain = 0.1, kStalled = 0.5;
constexpr double kLeastKnot = 300.0, kKnotWeight = 3e-4;  // sets, as many as a patch has if more; of proximal Newton
constexpr int kKnotFactorizations = 30;
constexpr double kBar = 0.5, kPatchAim = 0.3;  // of the tolerance: error that asks for a patch, and what that aims at
// When it gives up: after so many sweeps, or half as many if more than half of what asked for a patch still does; after
// so many factorisations in an island of 1000 sets, growing as the root, since the larger the island the cheaper they
// are beside those of all of it.
constexpr double kSweepBudget = 1000.0, kKnotBudget = 10.0;
constexpr int kMostRounds = 40;

}  // namespace

void PatchSweeps::start(const ScaledProblem& problem, const GrowVector& impulse) {
  offsets_.clear(), sizes_.clear(), swept_.clear();
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    offsets_.push_back(static_cast<int>(problem.sets[i].offset));
    sizes_.push_back(static_cast<int>(problem.sets[i].size()));
    swept_.emplace_back(problem.sets[i], problem.system->diagonal_block(i));
    swept_.back().take_one_step_if_exact();
  }
  const std::size_t count = sizes_.size();
  place_.assign(count, -1);
  error_.resize(count), done_.resize(count);
  order_.reserve(count);
  const auto largest = std::min(count, static_cast<std::size_t>(kLargestSize));
  patch_.reserve(largest), rows_.reserve(largest), block_first_.reserve(largest + 1);
  blocks_.reserve(columns_.size());
  const auto rows = static_cast<Index>(6 * largest);
  state_.resize(rows), before_.resize(rows), next_.resize(rows);
  anderson_.setup(rows, kMemory);
  l_ = best_ = impulse;
  t_.resize(problem.size()), natural_.resize(problem.size());
}

bool PatchSweeps::solve(const ScaledProblem& problem, double tolerance, int max_factorizations,
                        const GrowVector& impulse, PatchResult& result) {
  if (!problem.system->list_columns(first_, columns_)) return false;
  start(problem, impulse);
  result = PatchResult();
  const double most_factorizations = kKnotBudget * std::sqrt(1e-3 * static_cast<double>(sizes_.size()));
  double size = kFirstSize;
  std::size_t first = 0;
  for (int round = 0;; ++round, size = std::min(kGrowth * size, kLargestSize)) {
    problem.system->apply(l_, t_);
    t_ += problem.b;
    const double relative = natural_residual(problem, Law::Ncp, l_, t_, natural_);
    if (round == 0 || relative < result.relative) result.relative = relative, best_ = l_;
    if (!(relative > tolerance) || round == kMostRounds) break;
    for (std::size_t i = 0; i < error_.size(); ++i) error_[i] = natural_.segment(offsets_[i], sizes_[i]).norm();
    const double unit = *std::max_element(error_.begin(), error_.end()) / relative;  // what the certificate is over
    order_.clear();
    for (std::size_t i = 0; i < error_.size(); ++i)
      if (error_[i] > kBar * tolerance * unit) order_.push_back(static_cast<int>(i));
    if (round == 0) first = order_.size();
    const bool slow = 2 * order_.size() > first;
    if (result.spent || result.factorizations > most_factorizations ||
        result.sweeps > (slow ? 0.5 : 1.0) * kSweepBudget)
      break;
    std::sort(order_.begin(), order_.end(),
              [this](int a, int b) { return error_[a] != error_[b] ? error_[a] > error_[b] : a < b; });
    std::fill(done_.begin(), done_.end(), std::uint8_t{0});
    for (const int centre : order_) {
      if (done_[centre]) continue;
      find_patch(centre, static_cast<int>(size));
      for (std::size_t k = 0; k < static_cast<std::size_t>(kInner * static_cast<double>(patch_.size())); ++k)
        done_[patch_[k]] = 1;
      if (relax(problem, kPatchAim * tolerance * unit, result) <= kStalled) continue;
      find_patch(centre, static_cast<int>(std::max(size, kLeastKnot)));
      newton(problem, kPatchAim * tolerance, max_factorizations, unit, result);
    }
  }
  return true;
}

/// patch_: the `size` sets nearest to `centre`.
void PatchSweeps::find_patch(int centre, int size) {
  patch_.assign(1, centre);
  place_[centre] = 0;
  for (std::size_t k = 0; k < patch_.size() && static_cast<int>(patch_.size()) < size; ++k)
    for (int c = first_[patch_[k]]; c < first_[patch_[k] + 1] && static_cast<int>(patch_.size()) < size; ++c)
      if (place_[columns_[c].set] < 0) place_[columns_[c].set] = 0, patch_.push_back(columns_[c].set);
  for (const int i : patch_) place_[i] = -1;
}

/// Copies the patch's impulse and velocity, and lists A's blocks between its sets.
void PatchSweeps::gather() {
  rows_.clear();
  num_rows_ = 0;
  for (std::size_t k = 0; k < patch_.size(); ++k) {
    place_[patch_[k]] = static_cast<int>(k);
    rows_.push_back(static_cast<int>(num_rows_));
    num_rows_ += sizes_[patch_[k]];
  }
  block_first_.assign(1, 0);
  blocks_.clear();
  for (std::size_t k = 0; k < patch_.size(); ++k) {
    const int i = patch_[k];
    for (int c = first_[i]; c < first_[i + 1]; ++c) {
      const ScaledDelassus::ColumnBlock& column = columns_[c];
      if (place_[column.set] >= 0) blocks_.push_back({rows_[place_[column.set]], sizes_[column.set], column.values});
    }
    block_first_.push_back(static_cast<int>(blocks_.size()));
    for (int r = 0; r < sizes_[i]; ++r) {
      state_[rows_[k] + r] = l_[offsets_[i] + r];
      state_[num_rows_ + rows_[k] + r] = t_[offsets_[i] + r];
    }
  }
  for (const int i : patch_) place_[i] = -1;
}

/// The patch's impulse becomes l, and all hear of it.
void PatchSweeps::put(const double* l) {
  for (const int i : patch_) {
    double change[3];
    bool moved = false;
    for (int r = 0; r < sizes_[i]; ++r, ++l) {
      double& own = l_[offsets_[i] + r];
      change[r] = *l - own;
      own = *l;
      moved |= change[r] != 0.0;
    }
    for (int c = first_[i]; moved && c < first_[i + 1]; ++c) {
      const int j = columns_[c].set;
      add_block_product(sizes_[j], sizes_[i], columns_[c].values, change, t_.data() + offsets_[j]);
    }
  }
}

/// One sweep over the patch, inside it alone. Returns the largest change of an impulse.
double PatchSweeps::sweep(const ScaledProblem& problem) {
  double* l = state_.data();
  double* t = l + num_rows_;
  double largest = 0.0;
  for (std::size_t k = 0; k < patch_.size(); ++k) {
    const int i = patch_[k], size = sizes_[i];
    double change[3];
    bool slips;
    if (!visit_set(problem.sets[i], swept_[i], l + rows_[k], t + rows_[k], change, slips)) continue;
    double square = 0.0;
    for (int r = 0; r < size; ++r) square += change[r] * change[r];
    largest = std::max(largest, square);
    for (int b = block_first_[k]; b < block_first_[k + 1]; ++b)
      add_block_product(blocks_[b].size, size, blocks_[b].values, change, t + blocks_[b].row);
  }
  return std::sqrt(largest);
}

/// Accelerated sweeps over the patch, until one changes no impulse by more than `aim`, or kPatchGain of what the first
/// one did. Returns what they left of that; 0: the aim.
double PatchSweeps::relax(const ScaledProblem& problem, double aim, PatchResult& result) {
  gather();
  const NoMalloc guard;
  const Index size = 2 * num_rows_;
  anderson_.restart(size);
  double first = 0.0, last = 0.0;
  for (int count = 0; count < kPatchSweeps; ++count) {
    before_.head(size) = state_.head(size);
    last = sweep(problem);
    result.sweeps += static_cast<double>(patch_.size()) / static_cast<double>(sizes_.size());
    if (count == 0) first = last;
    if (last <= std::max(aim, kPatchGain * first) || count + 1 == kPatchSweeps) break;
    anderson_.step(before_.head(size), state_.head(size), next_.head(size));
    state_.swap(next_);
  }
  put(state_.data());
  return last <= aim ? 0.0 : last / first;
}

/// Proximal Newton on the patch; unit: what the certificate is relative to.
void PatchSweeps::newton(const ScaledProblem& problem, double tolerance, int max_factorizations, double unit,
                         PatchResult& result) {
  const double share = static_cast<double>(patch_.size()) / static_cast<double>(sizes_.size());
  const auto limit =
      static_cast<int>(std::min<double>(kKnotFactorizations, (max_factorizations - result.factorizations) / share));
  result.spent |= limit < 1;
  if (result.spent) return;
  std::sort(patch_.begin(), patch_.end());
  gather();
  part_.sets.clear();
  for (const int i : patch_) part_.sets.add(problem.sets[i]);
  part_.reference = unit;
  part_.share_weight = 0.0;
  ScaledDelassus::extract(first_, columns_, patch_, part_.sets, part_.system);
  newton_.resize(num_rows_, static_cast<Index>(patch_.size()));
  newton_.l = state_.head(num_rows_);
  part_.b.resize(num_rows_);
  part_.system->apply(newton_.l, part_.b);
  part_.b = state_.segment(num_rows_, num_rows_) - part_.b;
  const NewtonResult found = proximal_newton_iterations(part_, tolerance, kKnotWeight, limit, limit, newton_);
  result.factorizations += share * found.factorizations;
  put(newton_.best.data());
}

}  // namespace signorini
