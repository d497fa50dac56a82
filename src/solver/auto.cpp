// Which method, when (docs/auto.md):
//   check the guess -> split into islands -> for each: warm Newton -> interior point, finished by Newton -> fallbacks.
#include "signorini/solver/auto.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "finish.hpp"
#include "signorini/solver/admm.hpp"

namespace signorini {
namespace {

constexpr double kAim = 1e-3;  // of the tolerance: what Newton aims at from a guess, if the settings do not say
// Sweeps: at least kFirstSweeps, and on while so many more would do, at the rate of the last kFirstSweeps. Few where
// nothing slips, since Newton is good there, and in islands of more than kPatch sets, where something stalls.
constexpr int kFirstSweeps = 3, kMoreSweeps = 30, kFewSweeps = 10, kMostSweeps = 100;
constexpr double kLoose = 1e-6;  // what is aimed at from a guess from which on sweeps come before Newton
// Proximal Newton goes on from sweeps where their certificate, times the contacts that press, is below kNear, or
// kNearer if less than kLoose is aimed at; and no more than after one sweep, or kStuck of that.
constexpr double kNear = 0.3, kNearer = 0.1, kStuck = 1.5;
constexpr int kSweptNewton = 3, kSweptProximal = 16, kSweptPatience = 6, kSweepsBetween = 20;
constexpr ActiveSearch kSweptSearch{1e-5, 0.3, true}, kStickSearch{1e-3, 0.3, false},
    kFinishSearch{3e-3, 0.3, false, 0.5};
constexpr double kGoodStart = 0.3;  // certificate of an iterate of Newton's from which the interior point goes on
constexpr int kWarmNewton = 5;      // iterations granted to Newton from a guess
constexpr int kWarmSweeps = 10;     // that follow where these do not do and the guess's certificate is above kFarOff
constexpr double kFarOff = 1e-4;
constexpr int kWarmPatience = 8, kWarmSteps = 15;
constexpr double kFirstFinish = 1e-6;  // certificate at which finish() is first tried
constexpr double kNearlyDone = 3.0;    // tolerances from which a large attempt tries to, if that is more
// The same of finish_reduced(), over the number of sets, and at most; and how long a step has to be.
constexpr double kFirstReduced = 6e-3, kLargestReduced = 1e-3, kFullStep = 0.97;
constexpr double kQuick = 0.6;           // what a step leaves of the certificate below which the interior point goes on
constexpr int kSlowSteps = 3;            // that leave more, in a row, after which proximal Newton tries
constexpr double kFirstProximal = 1e-4;  // certificate at which proximal Newton tries, once a start
constexpr double kWeight = 3e-4, kWeightShare = 30.0, kHighWeight = 0.3;  // its first weight; late: of the certificate
// Factorisations granted to it, and how many of them without halving the certificate; for a large island.
constexpr int kWarmProximal = 15, kSweptWarmProximal = 10, kProximal = 150, kProximalPatience = 60;
constexpr int kLargeProximal = 800, kLargeProximalPatience = 400;
constexpr int kFinish = 3, kLateFinish = 6, kLastFinish = 12;
constexpr int kFinishProximal = 6;  // factorisations of proximal Newton in its place
constexpr double kFinishWeight = 3e-5;
constexpr int kLate = 25;  // interior-point iterations after which Newton tries earlier
constexpr double kLateFactor = 100.0;
constexpr int kPatience = 15, kSteps = 60;
constexpr double kMargin = 0.9;  // of the tolerance, for an island
constexpr int kLarge = 250;      // sets beyond which the interior point only has to come near, for repair() to go on
// Continuation in friction: factors to begin with, by how much the factor grows, factorisations granted.
constexpr double kFrictionStarts[] = {0.3, 0.1, 0.01};
constexpr double kFrictionGrowth = 1.1, kMostFrictionGrowth = 1.3, kLeastFrictionGrowth = 1.001;
constexpr int kFrictionBudget = 300;
constexpr double kLargestImpulse = 1e10;  // over the free velocity: beyond it rounding alone makes residuals small
constexpr double kNoSolution = 1e12;      // over the free velocity: a solution larger than this counts as none
// With a softness near rounding the solve turns the ray out of the cones, and projecting it undoes what was purged.
constexpr double kRaySoftness = 1e-5, kRaySlope = 1e-6;
constexpr int kRayPurges = 4;
constexpr int kPatches = 800;  // sets from which on sweeps go on patch by patch
constexpr int kPatch = 100;    // sets of a patch of repair()
constexpr int kPatchBudget = 150, kRepairRounds = 30;
constexpr double kPatchTolerance = 1e-9;
constexpr int kFirstOrder = 5000;  // iterations of ADMM, at the very end
constexpr int kBudget = 2000;      // factorisations, if settings.max_iterations does not say otherwise

/// Starts of the interior point, tried in turn: start scale, least centring, theta. The first goes on from near, if
/// that is there.
constexpr InteriorPoint::Options kAttempts[] = {{30.0, 0.03, 1.0},   {30.0, 0.03, 1.0}, {1.0, 0.03, 0.95},
                                                {1000.0, 0.03, 1.0}, {0.01, 0.03, 1.0}, {10.0, 0.1, 1.0},
                                                {100.0, 0.03, 0.9}};

/// In large islands, before those: they go on for long, and come near where others stop.
constexpr InteriorPoint::Options kLargeAttempts[] = {{30.0, 0.03, 1.0, 1e-3}, {3.0, 0.03, 1.0, 1e-3}};
constexpr int kLargePatience = 50, kLargeSteps = 200;

/// For each set, the others that it acts on directly.
std::vector<std::vector<int>> contact_graph(const ContactProblem& problem) {
  std::vector<int> set_of(static_cast<std::size_t>(problem.size()));
  for (Index i = 0; i < problem.num_sets(); ++i)
    for (Index k = 0; k < problem.sets()[i].size(); ++k) set_of[problem.sets()[i].offset + k] = static_cast<int>(i);
  std::vector<std::vector<int>> neighbours(static_cast<std::size_t>(problem.num_sets()));
  const SparseMatrix matrix = problem.delassus().matrix();
  for (Index c = 0; c < matrix.outerSize(); ++c)
    for (SparseMatrix::InnerIterator it(matrix, c); it; ++it) {
      std::vector<int>& list = neighbours[set_of[c]];
      const int i = set_of[it.row()];
      if (i != set_of[c] && (list.empty() || list.back() != i)) list.push_back(i);
    }
  return neighbours;
}

/// About `size` sets around `centre`, nearest first.
std::vector<int> patch_around(const std::vector<std::vector<int>>& neighbours, int centre, int size) {
  std::vector<int> patch{centre};
  std::vector<std::uint8_t> inside(neighbours.size(), 0);
  inside[centre] = 1;
  for (std::size_t k = 0; k < patch.size() && static_cast<int>(patch.size()) < size; ++k)
    for (const int i : neighbours[patch[k]])
      if (!inside[i]) inside[i] = 1, patch.push_back(i);
  return patch;
}

void solve_islands(const ContactProblem& problem, const Settings& settings, AutoWorkspace& w, const Guess* guess,
                   bool may_repair, Solution& solution);

/// One island being solved: the best iterate so far and what it cost.
class Ladder {
 public:
  /// whole, island: problem is the scaled version of these sets of it; null: of all of it.
  Ladder(ScaledProblem& problem, const ContactProblem& whole, const std::vector<int>* island, Law law, double tolerance,
         double aim, double global_reference, int max_factorizations, bool may_repair, AutoWorkspace& workspace,
         IterateObserver observe)
      : problem_(problem),
        whole_(whole),
        island_(island),
        law_(law),
        tolerance_(tolerance),
        aim_(aim),
        global_reference_(global_reference),
        max_factorizations_(max_factorizations),
        may_repair_(may_repair),
        w_(workspace),
        observe_(std::move(observe)) {
    w_.newton.resize(problem.size(), problem.sets.num_sets());
  }

  int iterations = 0, factorizations = 0;
  double best = std::numeric_limits<double>::infinity();  ///< certificate of w_.best
  SolverType method = SolverType::Auto;                   ///< that found it; Auto: none was needed

  void solve(const GrowVector* guess) {
    proximal_ = law_ == Law::Ncp && problem_.system->reduces();
    active_newton_ = guess && proximal_;
    const bool cheap = problem_.system->cheap_columns() || (!guess && in_patches());
    const bool sweeps_first = proximal_ && cheap && (!guess || aim_ >= kLoose);
    if (guess && !sweeps_first && newton(*guess, kWarmNewton)) return;
    w_.scratch.setZero(problem_.size());
    offer(w_.scratch, natural_residual(problem_, law_, w_.scratch, problem_.b, w_.newton.natural), SolverType::Auto);
    if (done()) return;
    if (sweeps_first && sweep(guess)) return;
    if (guess && !sweeps_first) {
      const bool found = proximal_ ? sweep_and_go_on(*guess) : interior_point(guess, {}, kWarmPatience, kWarmSteps);
      if (found) return;
    }
    if (proximal_ && large() && from_large_attempts()) return;
    const int steps = problem_.sets.num_sets() > kLarge ? kLate : kSteps;
    for (const InteriorPoint::Options& options : kAttempts) {
      const bool near = &options == kAttempts;
      if (near && !has_near_) continue;
      if (interior_point(near ? &w_.near : nullptr, options, kPatience, steps)) return;
      if (acceptable()) return;
      if (out_of_budget()) break;
      if (proximal_ && !tried_proximal_) {
        const double weight = std::clamp(kWeightShare * w_.interior_point.relative(), kWeight, kHighWeight);
        if (proximal_newton(w_.interior_point.impulse(), proximal_budget(), weight)) return;
      }
      if (large() && repair()) return;
      if (newton(w_.interior_point.impulse(), kLastFinish)) return;
    }
    if (!guess && may_repair_ && proximal_ && max_factorizations_ >= kBudget && !out_of_budget() &&
        friction_continuation())
      return;
    if (!out_of_budget() && continuation()) return;
    if (may_repair_ && many() && !out_of_budget() && repair()) return;
    if (may_repair_ && max_factorizations_ >= kBudget) first_order();
  }

  /// Whether the iterate of the least relative residual alone, however large, points along a ray that rules out every
  /// solution of reasonable size (T49).
  bool infeasible() {
    GrowVector ray = w_.ray, velocity;
    velocity.resize(ray.size());
    keep_ray(ray);
    const auto proves = [&] {
      problem_.system->apply(ray, velocity);
      const double slope = -problem_.b.dot(ray);
      return slope > kRaySlope * problem_.b.norm() * ray.norm() &&
             slope >= kNoSolution * problem_.reference * velocity.norm();  // false for NaN
    };
    if (proves()) return true;
    // What is left of it where G + R is next to nothing.
    const BlockDiagonal soft(static_cast<std::size_t>(problem_.sets.num_sets()),
                             Eigen::Matrix3d(kRaySoftness * Eigen::Matrix3d::Identity()));
    ++factorizations;
    if (!problem_.system->factor(soft)) return false;
    for (int k = 0; k < kRayPurges; ++k) {
      problem_.system->solve(velocity);
      ray -= velocity;
      keep_ray(ray);
      if (proves()) return true;
    }
    return false;
  }

 private:
  /// Projects on the directions d with d . s >= 0 for all s that the law allows.
  void keep_ray(GrowVector& ray) const {
    for (const ConstraintSet& set : problem_.sets) {
      double* d = ray.data() + set.offset;
      switch (set.type) {
        case SetType::FrictionCone:
          if (law_ == Law::Ncp)
            d[0] = d[1] = 0.0, d[2] = std::max(d[2], 0.0);
          else
            project_friction_cone(set.friction, d, d);
          break;
        case SetType::HalfLine:
          *d = std::max(*d, 0.0);
          break;
        case SetType::Interval:
          if (std::isfinite(*d > 0.0 ? set.upper : set.lower)) *d = 0.0;
          break;
        case SetType::Equality:
          break;
      }
    }
  }

  bool done() const { return best <= tolerance_; }
  /// Good enough for the whole problem, whose certificate has a larger scale than the island's.
  bool acceptable() const {
    const double scale = std::max(problem_.reference, std::sqrt(3.0) * w_.best.lpNorm<Eigen::Infinity>());
    return best * scale <= tolerance_ * global_reference_;
  }
  bool many() const { return problem_.sets.num_sets() > kPatch; }
  bool large() const { return may_repair_ && problem_.sets.num_sets() > kLarge; }
  bool in_patches() const { return may_repair_ && problem_.sets.num_sets() >= kPatches; }
  int proximal_budget() const { return large() ? kLargeProximal : kProximal; }
  int budget_left() const { return max_factorizations_ - factorizations; }
  bool out_of_budget() const { return budget_left() <= 0; }

  /// The island as a problem of its own, which only the last rungs need.
  const ContactProblem& part() {
    if (!island_) return whole_;
    if (part_.num_sets() > 0) return part_;
    std::vector<Index> rows;
    ConstraintSets sets;
    for (const int i : *island_) {
      const ConstraintSet& set = whole_.sets()[i];
      for (Index k = 0; k < set.size(); ++k) rows.push_back(set.offset + k);
      sets.add(set);
    }
    Vector free_velocity(sets.size()), compliance(sets.size());
    for (Index k = 0; k < sets.size(); ++k) {
      free_velocity[k] = whole_.free_velocity()[rows[k]];
      compliance[k] = whole_.compliance()[rows[k]];
    }
    part_.assign(whole_.delassus().restrict(rows), free_velocity, sets, compliance);
    return part_;
  }

  void offer(const ConstVectorRef& l, double relative, SolverType by) {
    const double size = l.lpNorm<Eigen::Infinity>();
    const double alone = relative * std::min(1.0, problem_.reference / (problem_.share_weight * size));
    if (alone < straightest_) straightest_ = alone, w_.ray = l;
    if (!(relative < best)) return;
    if (best <= 1.0 && size > kLargestImpulse * problem_.reference) return;
    best = relative;
    method = by;
    w_.best = l;
  }

  /// Slow, but it wanders less than it jumps: ADMM comes nearest where all else fails.
  void first_order() {
    Settings settings;
    settings.law = law_;
    settings.tolerance = tolerance_;
    settings.max_iterations = kFirstOrder;
    AdmmWorkspace workspace;
    Solution solution;
    solution.impulse.setZero(problem_.size());
    solve_admm(part(), settings, workspace, nullptr, solution);
    factorizations += solution.factorizations;
    iterations += solution.iterations;
    GrowVector l, t;
    l.resize(problem_.size()), t.resize(problem_.size());
    problem_.from_impulse(solution.impulse, l);
    problem_.system->apply(l, t);
    t += problem_.b;
    offer(l, natural_residual(problem_, law_, l, t, w_.newton.natural), SolverType::Admm);
    if (!done()) newton(l, kLastFinish);
  }

  /// Follows the solution for `factor` times the friction (T48), easy for small factors, as the factor rises to 1.
  bool friction_continuation() {
    const double best_before = best;
    const GrowVector before = w_.best;
    const SolverType method_before = method;
    const double straightest = std::exchange(straightest_, 0.0);  // other problems' rays are no proof
    const ConstraintSets sets = problem_.sets;
    const auto scale_friction = [&](double factor) {
      for (Index i = 0; i < sets.num_sets(); ++i)
        if (sets[i].type == SetType::FrictionCone) problem_.sets.set_friction(i, factor * sets[i].friction);
      best = std::numeric_limits<double>::infinity();
    };
    const int limit = factorizations + kFrictionBudget;
    GrowVector l;
    double reached = 0.0, growth = kFrictionGrowth;
    for (const double factor : kFrictionStarts) {
      scale_friction(factor);
      if (!interior_point(nullptr, kAttempts[0], kPatience, kSteps)) continue;
      l = w_.best;
      reached = factor;
      break;
    }
    while (reached > 0.0 && reached < 1.0 && growth > kLeastFrictionGrowth && factorizations < limit) {
      const double factor = std::min(1.0, growth * reached);
      scale_friction(factor);
      if (newton(l, kLastFinish) || proximal_newton(l, kProximal)) {
        l = w_.best;
        reached = factor;
        growth = std::min(std::pow(growth, 1.3), kMostFrictionGrowth);
      } else {
        growth = std::sqrt(growth);
      }
    }
    problem_.sets = sets;
    straightest_ = straightest;
    if (reached == 1.0) return true;
    best = best_before;
    w_.best = before;
    method = method_before;
    return false;
  }

  /// Follows the solution of A + weight I (T42), easy for large weights, as the weight falls to 0.
  bool continuation() {
    const double best_before = best;
    const GrowVector before = w_.best;
    const SolverType method_before = method;
    const double straightest = std::exchange(straightest_, 0.0);  // other problems' rays are no proof
    GrowVector l = Vector::Zero(problem_.size());
    double weight = 1.0, factor = 0.1, reached = 0.0;
    while (weight > 1e-9 && factor < 0.9 && !out_of_budget()) {
      problem_.regularize(part(), weight);
      best = std::numeric_limits<double>::infinity();
      bool ok = reached > 0.0 && (newton(l, kLastFinish) || interior_point(&l, {}, kWarmPatience, kWarmSteps));
      if (!ok) ok = interior_point(nullptr, {}, kPatience, kSteps);
      if (ok) {
        l = w_.best;
        reached = weight;
      } else if (reached > 0.0) {
        factor = std::sqrt(factor);
      } else {
        break;
      }
      weight = reached * factor;
    }
    problem_.regularize(part(), 0.0);
    straightest_ = straightest;
    best = best_before;
    w_.best = before;
    method = method_before;
    return reached > 0.0 && (newton(l, kLastFinish) || interior_point(&l, {}, kWarmPatience, kWarmSteps));
  }

  /// What holds a large island up are a few knots of contacts. Solves the patches around the worst contacts, the
  /// impulses outside kept as they are, and lets Newton settle the whole after each round.
  bool repair() {
    const std::vector<std::vector<int>> neighbours = contact_graph(part());
    AutoWorkspace workspace;
    Solution solution;
    Settings settings;
    settings.law = law_;
    settings.tolerance = kPatchTolerance;
    Vector l = w_.best, t(problem_.size()), natural(problem_.size());
    std::vector<int> order(neighbours.size());
    std::vector<double> error(order.size());
    for (int round = 0; round < kRepairRounds && !out_of_budget(); ++round) {
      w_.newton.l = l;
      if (take(newton_iterations(problem_, law_, tolerance_, kWarmNewton, w_.newton, observer()))) return true;
      l = w_.newton.best;
      for (int sweep = 0; sweep < 2; ++sweep) {
        problem_.system->apply(l, t);
        t += problem_.b;
        natural_residual(problem_, law_, l, t, natural);
        const double bar = 0.3 * tolerance_ * std::max(problem_.reference, l.lpNorm<Eigen::Infinity>());
        std::vector<std::uint8_t> covered(order.size(), 0);
        for (std::size_t i = 0; i < order.size(); ++i) {
          const ConstraintSet& set = problem_.sets[static_cast<Index>(i)];
          order[i] = static_cast<int>(i);
          error[i] = natural.segment(set.offset, set.size()).norm();
        }
        std::sort(order.begin(), order.end(),
                  [&](int a, int b) { return error[a] != error[b] ? error[a] > error[b] : a < b; });
        for (const int centre : order) {
          if (!(error[centre] > bar) || out_of_budget()) break;
          if (covered[centre]) continue;
          // Of changing size: a knot on a patch's edge would come back round after round.
          const std::vector<int> patch = patch_around(neighbours, centre, kPatch * (1 + round % 3));
          for (std::size_t k = 0; k <= patch.size() / 2; ++k) covered[patch[k]] = 1;  // the inner half
          const double share = static_cast<double>(patch.size()) / static_cast<double>(order.size());
          settings.max_iterations = std::clamp(static_cast<int>(budget_left() / share), 1, kPatchBudget);
          solve_patch(patch, settings, workspace, solution, l);
        }
      }
    }
    return newton(l, kLastFinish);
  }

  /// Solves the sets of `patch` for the impulses of the others in l, and writes the result into l.
  void solve_patch(std::vector<int> patch, const Settings& settings, AutoWorkspace& workspace, Solution& solution,
                   Vector& l) {
    std::sort(patch.begin(), patch.end());
    std::vector<Index> rows;
    ConstraintSets sets;
    for (const int i : patch) {
      const ConstraintSet& set = part().sets()[i];
      for (Index k = 0; k < set.size(); ++k) rows.push_back(set.offset + k);
      sets.add(set);
    }
    const auto count = static_cast<Index>(rows.size());
    Vector impulse(part().size()), velocity(part().size());
    problem_.to_impulse(l, impulse);
    part().velocity(impulse, velocity);
    const std::shared_ptr<const DelassusOperator> delassus = part().delassus().restrict(rows);
    Guess guess;
    guess.impulse.resize(count);
    Vector own(count), free_velocity(count), compliance(count);
    for (Index k = 0; k < count; ++k) {
      guess.impulse[k] = impulse[rows[k]];
      compliance[k] = part().compliance()[rows[k]];
      free_velocity[k] = velocity[rows[k]];
    }
    delassus->apply(guess.impulse, own);
    free_velocity -= own + compliance.cwiseProduct(guess.impulse);
    const ContactProblem problem(delassus, free_velocity, std::move(sets), compliance);
    solution = Solution();
    solve_islands(problem, settings, workspace, &guess, false, solution);
    patch_work_ += static_cast<double>(solution.factorizations) * static_cast<double>(count);
    for (Index k = 0; k < count; ++k) l[rows[k]] = solution.impulse[k] / (problem_.scale[rows[k]] * problem_.unit);
    while (patch_work_ >= static_cast<double>(part().size())) {  // a patch counts by its share of the rows
      patch_work_ -= static_cast<double>(part().size());
      ++factorizations;
    }
  }

  /// Gauss-Seidel while that gets there soon; then, from where it is, Newton where nothing slips, and proximal Newton.
  bool sweep(const GrowVector* guess) {
    BlockSweeps& sweeps = w_.sweeps;
    const double target = guess ? aim_ : tolerance_;
    sweeps.start(problem_, guess);
    double relative = sweeps.relative(problem_), first = relative;  // first: after one sweep
    double last[kFirstSweeps], soon = 0.0;                          // before the last ones; what more would leave
    if (guess) offer(sweeps.impulse(), relative, SolverType::Auto);
    for (int count = 0; relative > target && soon <= target && count < kMostSweeps; ++iterations) {
      last[count++ % kFirstSweeps] = relative;
      sweeps.sweep(problem_);
      relative = sweeps.relative(problem_);
      if (count == 1) first = relative;
      if (observe_) observe_(sweeps.impulse(), factorizations);
      if (count < kFirstSweeps) continue;
      const double more = sweeps.slips() && !many() ? kMoreSweeps : kFewSweeps;
      soon = relative * std::pow(relative / last[count % kFirstSweeps], more / kFirstSweeps);
    }
    offer(sweeps.impulse(), relative, SolverType::Pgs);
    if (relative <= target || !std::isfinite(relative)) return done();
    if (!guess && in_patches() && sweep_patches()) return done();

    has_near_ = relative <= first;
    w_.near = sweeps.impulse();
    const bool loose = target >= kLoose;
    const bool close =
        relative * sweeps.pressing() <= (loose ? kNear : kNearer) && relative <= (loose ? kStuck : 1.0) * first;
    if (!guess && !close) return sweeps.mostly_sticks() && newton_from_stick(target);
    if (!sweeps.slips() && !many() && newton_from_sweeps(target)) return true;
    const int rounds = loose ? 2 : 1;
    for (int round = 0; round < rounds && !out_of_budget(); ++round) {
      for (int k = 0; round > 0 && k < kSweepsBetween; ++k, ++iterations) sweeps.sweep(problem_);
      if (proximal_newton(sweeps.impulse(), kSweptProximal / rounds, kWeight, kSweptPatience)) return true;
    }
    return false;
  }

  /// From a guess that Newton gets nowhere from. Where it is far off, a few contacts open, close or begin to slip now,
  /// and a few sweeps find them.
  bool sweep_and_go_on(const GrowVector& guess) {
    BlockSweeps& sweeps = w_.sweeps;
    bool far = problem_.system->cheap_columns();
    if (far) {
      sweeps.start(problem_, &guess);
      far = sweeps.relative(problem_) > kFarOff;
    }
    if (!far) return proximal_newton(guess, kWarmProximal);
    if (many()) return sweep(nullptr);
    for (int k = 0; k < kWarmSweeps; ++k, ++iterations) sweeps.sweep(problem_);
    if (newton_from_sweeps(aim_) || proximal_newton(sweeps.impulse(), kSweptWarmProximal)) return true;
    if (best < kGoodStart) has_near_ = true, w_.near = w_.best;
    return false;
  }

  /// On from the sweeps patch by patch; then, unless it is knots that stop these, proximal Newton on the whole. False
  /// where A does not list its columns.
  bool sweep_patches() {
    PatchResult result;
    if (!w_.patches.solve(problem_, tolerance_, budget_left(), w_.sweeps.impulse(), result)) return false;
    iterations += static_cast<int>(std::ceil(result.sweeps));
    factorizations += static_cast<int>(std::ceil(result.factorizations));
    if (observe_) observe_(w_.patches.impulse(), factorizations);
    offer(w_.patches.impulse(), result.relative, SolverType::Pgs);
    has_near_ = true, w_.near = w_.patches.impulse();
    if (!done() && result.relative <= kFirstProximal && !out_of_budget())
      proximal_newton(w_.near, kProximal, kWeight, kProximalPatience, &w_.sweeps);
    return true;
  }

  /// The interior point for long, and proximal Newton from there; whether that does.
  bool from_large_attempts() {
    for (const InteriorPoint::Options& options : kLargeAttempts) {
      if (interior_point(nullptr, options, kLargePatience, kLargeSteps) || acceptable()) return true;
      if (!out_of_budget() && proximal_newton(w_.best, proximal_budget())) return true;
      if (out_of_budget()) return false;
    }
    return false;
  }

  /// Counts what an attempt of Newton cost, and offers its best iterate; whether that does.
  bool take(const NewtonResult& result) {
    iterations += result.iterations;
    factorizations += result.factorizations;
    offer(w_.newton.best, result.relative, SolverType::Newton);
    return done();
  }

  /// From where every contact sticks, given up soon where many do not.
  bool newton_from_stick(double target) {
    ++iterations, ++factorizations;
    if (!stick_everywhere(problem_, w_.newton)) return false;
    const NewtonResult result = active_newton_iterations(problem_, tolerance_, target, kSweptNewton, w_.newton,
                                                         observer(), 0.0, nullptr, kStickSearch);
    if (result.relative < kGoodStart) has_near_ = true, w_.near = w_.newton.best;
    return take(result);
  }

  /// Hardly damped: where nothing slips the equations are linear, but for contacts that open or begin to slip.
  bool newton_from_sweeps(double target) {
    w_.newton.l = w_.sweeps.impulse(), w_.newton.t = w_.sweeps.velocity();
    const NewtonResult result = active_newton_iterations(problem_, tolerance_, target, kSweptNewton, w_.newton,
                                                         observer(), 0.0, nullptr, kSweptSearch);
    return take(result);
  }

  bool proximal_newton(const GrowVector& from, int max_factorizations, double weight = kWeight) {
    if (!large()) return proximal_newton(from, max_factorizations, weight, kProximalPatience);
    return proximal_newton(from, max_factorizations, weight, kLargeProximalPatience, &w_.sweeps);
  }
  bool proximal_newton(const GrowVector& from, int max_factorizations, double weight, int patience,
                       BlockSweeps* sweeps = nullptr) {
    w_.newton.l = from;
    const NewtonResult result =
        proximal_newton_iterations(problem_, tolerance_, weight, std::min(max_factorizations, budget_left()), patience,
                                   w_.newton, observer(), sweeps);
    return take(result);
  }

  bool newton(const ConstVectorRef& from, int max_iterations) {
    w_.newton.l = from;
    max_iterations = std::min(max_iterations, budget_left());
    const NewtonResult result =
        active_newton_ ? active_newton_iterations(problem_, tolerance_, aim_, max_iterations, w_.newton, observer())
                       : newton_iterations(problem_, law_, tolerance_, max_iterations, w_.newton, observer());
    return take(result);
  }

  bool finish(const GrowVector& from, bool late) {
    if (!proximal_ || large()) return newton(from, late ? kLateFinish : kFinish);
    return proximal_newton(from, kFinishProximal, kFinishWeight, kFinishProximal);
  }

  /// More damped than from a guess, and given up as soon as it does not gain.
  bool finish_reduced(const GrowVector& from) {
    w_.newton.l = from;
    const NewtonResult result = active_newton_iterations(problem_, tolerance_, tolerance_, kFinish, w_.newton,
                                                         observer(), 0.0, nullptr, kFinishSearch);
    return take(result);
  }

  /// Interior point, with Newton trying to finish: finish_reduced(), then finish() from kFirstFinish on, each again
  /// when the certificate has fallen tenfold. Gives up when that has not halved in `patience` steps.
  bool interior_point(const GrowVector* guess, const InteriorPoint::Options& options, int patience, int max_steps) {
    InteriorPoint& interior = w_.interior_point;
    interior.options = options;
    const bool patient = options.weight > 0.0;
    interior.start(problem_, law_, guess);
    tried_proximal_ = false;
    double last = std::numeric_limits<double>::infinity(), milestone = last;
    double next = patient ? std::max(kFirstFinish, kNearlyDone * tolerance_) : kFirstFinish;
    double reduced = std::min(kFirstReduced / static_cast<double>(problem_.sets.num_sets()), kLargestReduced);
    int since = 0, slow = 0;
    while (true) {
      const double relative = interior.relative();
      offer(interior.impulse(), relative, SolverType::InteriorPoint);
      if (done()) return true;
      if (relative <= 0.5 * milestone) milestone = relative, since = 0;
      if (++since > patience || interior.iterations() >= max_steps || out_of_budget()) return false;
      slow = relative > kQuick * last ? slow + 1 : 0;
      if (proximal_ && !patient && relative <= kFirstProximal && slow >= kSlowSteps && !tried_proximal_) {
        tried_proximal_ = true;
        if (proximal_newton(interior.impulse(), proximal_budget())) return true;
      }
      const bool late = !patient && (interior.held_back() || interior.iterations() > kLate);
      if (relative <= next * (late ? kLateFactor : 1.0)) {
        next = late ? 0.3 * relative / kLateFactor : (patient ? 0.3 : 0.1) * relative;
        if (patient ? proximal_newton(interior.impulse(), kFinishProximal) : finish(interior.impulse(), late))
          return true;
      } else if (proximal_ && !late && relative <= reduced && interior.last_step() >= kFullStep && interior.settled()) {
        reduced = 0.1 * relative;
        if (finish_reduced(interior.impulse())) return true;
      }
      last = relative;
      const int known = interior.factorizations();
      const bool going = interior.step();
      factorizations += interior.factorizations() - known;
      ++iterations;
      if (observe_) observe_(interior.impulse(), factorizations);
      if (!going) return false;
    }
  }

  IterateObserver observer() const {
    if (!observe_) return {};
    return [this, before = factorizations](const ConstVectorRef& l, int count) { observe_(l, before + count); };
  }

  ScaledProblem& problem_;
  const ContactProblem& whole_;
  const std::vector<int>* island_;
  ContactProblem part_;
  Law law_;
  double tolerance_, aim_, global_reference_, patch_work_ = 0.0;
  double straightest_ = std::numeric_limits<double>::infinity();  // what w_.ray leaves against its own size
  bool has_near_ = false;                                         // whether w_.near is a start of the interior point
  bool active_newton_ = false, proximal_ = false, tried_proximal_ = false;
  int max_factorizations_;
  bool may_repair_;  // false inside a patch
  AutoWorkspace& w_;
  IterateObserver observe_;
};

/// Groups the sets by island: w.first, w.members. Returns the number of islands.
int find_members(const ContactProblem& problem, AutoWorkspace& w) {
  problem.delassus().label_islands(problem.sets(), w.labels);
  const int count = w.labels.empty() ? 0 : 1 + *std::max_element(w.labels.begin(), w.labels.end());
  w.first.assign(static_cast<std::size_t>(count) + 1, 0);
  for (const int label : w.labels) ++w.first[label + 1];
  for (int k = 0; k < count; ++k) w.first[k + 1] += w.first[k];
  w.members.resize(w.labels.size());
  for (std::size_t i = 0; i < w.labels.size(); ++i) w.members[w.first[w.labels[i]]++] = static_cast<int>(i);
  for (int k = count; k > 0; --k) w.first[k] = w.first[k - 1];
  w.first[0] = 0;
  return count;
}

/// Relative residual of an island by itself, as natural_residual has it, from the velocity of the whole.
double island_residual(const ContactProblem& problem, const int* members, int count, Law law, double share_weight,
                       const GrowVector& impulse, const GrowVector& velocity) {
  double error = 0.0, largest = 0.0, free = 0.0;
  for (int k = 0; k < count; ++k) {
    const RelativePart part = relative_part(problem, members[k], impulse, velocity, law);
    if (std::isnan(part.error)) return part.error;
    error = std::max(error, part.error), largest = std::max(largest, part.size), free = std::max(free, part.free);
  }
  largest = std::max(largest, free);
  if (error == 0.0) return 0.0;
  return std::max(error / largest, share_weight * error / free);  // infinite where nothing asks for an impulse
}

void solve_islands(const ContactProblem& problem, const Settings& settings, AutoWorkspace& w, const Guess* guess,
                   bool may_repair, Solution& solution) {
  const double aim =
      std::min(settings.aim > 0.0 ? settings.aim : kAim * settings.tolerance, kMargin * settings.tolerance);
  solution.impulse.setZero(problem.size());
  solution.velocity.resize(problem.size());
  solution.solver = SolverType::Auto;
  bool holds = false;  // the guess, at the tolerance
  if (guess) {
    problem.sets().project(guess->impulse, solution.impulse);
    solution.residual = residual(problem, solution.impulse, settings.law, solution.velocity);
    holds = solution.residual.solves(settings.tolerance);
    if (holds && solution.residual.relative <= aim) {
      solution.status = Status::Solved;
      return;
    }
  }
  const int budget = settings.max_iterations > 0 ? settings.max_iterations : kBudget;
  double reference = problem.reference();  // of the whole certificate, before scaling to an island's unit
  for (const ConstraintSet& set : problem.sets())
    reference = std::max(reference, problem.free_velocity().segment(set.offset, set.size()).norm() /
                                        std::sqrt(problem.scale()[set.offset]));

  const int num_islands = find_members(problem, w);
  bool out_of_iterations = false, infeasible = false;
  Index largest = -1;
  int history_factorizations = 0;  // of the islands so far, one after the other
  Recorder recorder(problem, settings, solution);
  for (int k = 0; k < num_islands; ++k) {
    const int *members = w.members.data() + w.first[k], count = w.first[k + 1] - w.first[k];
    const double tolerance = kMargin * settings.tolerance;
    if (guess && num_islands > 1) {
      const double enough = guess->answers ? tolerance : aim, share_weight = enough / Residual::largest_share(enough);
      if (island_residual(problem, members, count, settings.law, share_weight, solution.impulse, solution.velocity) <=
          enough)
        continue;
    }
    w.part.assign(members, members + count);
    const std::vector<int>* island = num_islands > 1 ? &w.part : nullptr;
    if (island)
      w.problem.setup_part(problem, w.part, tolerance);
    else
      w.problem.setup(problem, tolerance);
    if (holds && !(settings.law == Law::Ncp && w.problem.system->reduces())) break;  // better would not be cheap
    // The island's rows in the whole, one set after the other.
    const auto for_each_row = [&](auto&& visit) {
      Index row = 0;
      for (int i = 0; i < count; ++i) {
        const ConstraintSet& set = problem.sets()[members[i]];
        for (Index r = 0; r < set.size(); ++r) visit(row++, set.offset + r);
      }
    };
    if (guess) {
      w.impulse.resize(w.problem.size());
      for_each_row([&](Index own, Index row) { w.impulse[own] = guess->impulse[row]; });
      w.start.resize(w.problem.size());
      w.problem.from_impulse(w.impulse, w.start);
    }
    IterateObserver observe;
    const int before = history_factorizations;
    if (settings.record_history) {
      observe = [&](const ConstVectorRef& l, int factorizations) {
        Vector impulse(l.size());
        w.problem.to_impulse(l, impulse);
        for_each_row([&](Index own, Index row) { solution.impulse[row] = impulse[own]; });
        recorder.record(solution.impulse, before + factorizations);
      };
    }
    Ladder ladder(w.problem, problem, island, settings.law, tolerance, aim, reference / w.problem.unit, budget,
                  may_repair, w, std::move(observe));
    // A guess that dwarfs what is asked for leaves rounding alone to tell impulses apart.
    const bool near = guess && w.start.lpNorm<Eigen::Infinity>() <= kLargestImpulse * w.problem.reference;
    ladder.solve(near ? &w.start : nullptr);
    history_factorizations += ladder.factorizations;
    solution.iterations = std::max(solution.iterations, ladder.iterations);
    solution.factorizations = std::max(solution.factorizations, ladder.factorizations);
    if (w.problem.size() > largest) largest = w.problem.size(), solution.solver = ladder.method;
    if (ladder.best > settings.tolerance && ladder.factorizations >= budget) out_of_iterations = true;
    if (may_repair && ladder.best > settings.tolerance && settings.max_iterations == 0 && ladder.infeasible())
      infeasible = true;
    w.impulse.resize(w.problem.size());
    w.problem.to_impulse(w.best, w.impulse);
    for_each_row([&](Index own, Index row) { solution.impulse[row] = w.impulse[own]; });
  }
  finish(problem, settings, out_of_iterations, solution);
  if (infeasible && solution.status != Status::Invalid && solution.status != Status::Solved)
    solution.status = Status::Infeasible;
}

}  // namespace

void solve_auto(const ContactProblem& problem, const Settings& settings, AutoWorkspace& workspace, const Guess* guess,
                Solution& solution) {
  solve_islands(problem, settings, workspace, guess, true, solution);
}

}  // namespace signorini
