// Which method, when (docs/auto.md):
//   check the guess -> split into islands -> for each: warm Newton -> interior point, finished by Newton -> fallbacks.
#include "signorini/solver/auto.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "signorini/problem/island.hpp"

namespace signorini {
namespace {

constexpr int kWarmNewton = 8;  // iterations granted to Newton from a guess
constexpr int kWarmPatience = 8, kWarmSteps = 15;
constexpr double kFirstFinish = 1e-6;  // certificate at which Newton first tries to finish
constexpr int kFinish = 3, kLateFinish = 6, kLastFinish = 12;
constexpr int kLate = 25;  // interior-point iterations after which Newton tries earlier
constexpr double kLateFactor = 100.0;
constexpr int kPatience = 15, kSteps = 60;
constexpr int kBudget = 1000;  // factorisations, if settings.max_iterations does not say otherwise

/// Starts of the interior point, tried in turn: start scale, least centring, theta.
constexpr InteriorPoint::Options kAttempts[] = {{30.0, 0.03, 1.0}, {1.0, 0.03, 0.95}, {1000.0, 0.03, 1.0},
                                                {0.01, 0.03, 1.0}, {10.0, 0.1, 1.0},  {100.0, 0.03, 0.9}};

/// One island being solved: the best iterate so far and what it cost.
class Ladder {
 public:
  Ladder(ScaledProblem& problem, const ContactProblem& part, Law law, double tolerance, double global_reference,
         int max_factorizations, AutoWorkspace& workspace, IterateObserver observe)
      : problem_(problem),
        part_(part),
        law_(law),
        tolerance_(tolerance),
        slack_(std::max(1.0, global_reference / std::max(problem.reference, 1e-300))),
        max_factorizations_(max_factorizations),
        w_(workspace),
        observe_(std::move(observe)) {
    w_.newton.resize(problem.size(), problem.sets.num_sets());
  }

  int iterations = 0, factorizations = 0;
  double best = std::numeric_limits<double>::infinity();  ///< certificate of w_.best
  SolverType method = SolverType::Auto;                   ///< that found it; Auto: none was needed

  void solve(const Vector* guess) {
    w_.scratch.setZero(problem_.size());
    offer(w_.scratch, natural_residual(problem_, law_, w_.scratch, problem_.b, w_.newton.natural), SolverType::Auto);
    if (done()) return;
    if (guess && newton(*guess, kWarmNewton)) return;
    if (guess && interior_point(guess, {}, kWarmPatience, kWarmSteps)) return;
    for (const InteriorPoint::Options& options : kAttempts) {
      if (interior_point(nullptr, options, kPatience, kSteps) || acceptable() || out_of_budget()) return;
      if (newton(Vector(w_.interior_point.impulse()), kLastFinish)) return;
    }
    continuation();
  }

 private:
  bool done() const { return best <= tolerance_; }
  /// Good enough for the whole problem, whose certificate has a larger scale than the island's.
  bool acceptable() const { return best <= tolerance_ * slack_; }
  bool out_of_budget() const { return factorizations >= max_factorizations_; }

  void offer(const Vector& l, double relative, SolverType by) {
    if (!(relative < best)) return;
    best = relative;
    method = by;
    w_.best = l;
  }

  /// Follows the solution of A + weight I (T38), easy for large weights, as the weight falls to 0.
  bool continuation() {
    const double best_before = best;
    const Vector before = w_.best;
    Vector l = Vector::Zero(problem_.size());
    double weight = 1.0, factor = 0.1, reached = 0.0;
    while (weight > 1e-9 && factor < 0.9 && !out_of_budget()) {
      problem_.regularize(part_, weight);
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
    problem_.regularize(part_, 0.0);
    best = best_before;
    w_.best = before;
    return reached > 0.0 && (newton(l, kLastFinish) || interior_point(&l, {}, kWarmPatience, kWarmSteps));
  }

  bool newton(const Vector& from, int max_iterations) {
    w_.newton.l = from;
    const NewtonResult result = newton_iterations(problem_, law_, tolerance_, max_iterations, w_.newton, observer());
    iterations += result.iterations;
    factorizations += result.factorizations;
    offer(w_.newton.best, result.relative, SolverType::Newton);
    return done();
  }

  /// Interior point, with Newton trying to finish at kFirstFinish and again each time the certificate has fallen
  /// tenfold. Gives up when the certificate has not halved in `patience` steps.
  bool interior_point(const Vector* guess, const InteriorPoint::Options& options, int patience, int max_steps) {
    InteriorPoint& interior = w_.interior_point;
    interior.options = options;
    interior.start(problem_, law_, guess);
    double next = kFirstFinish, milestone = std::numeric_limits<double>::infinity();
    int since = 0;
    while (true) {
      const double relative = interior.relative();
      offer(interior.impulse(), relative, SolverType::InteriorPoint);
      if (done()) return true;
      if (relative <= 0.5 * milestone) milestone = relative, since = 0;
      if (++since > patience || interior.iterations() >= max_steps || out_of_budget()) return false;
      const bool late = interior.held_back() || interior.iterations() > kLate;
      if (relative <= next * (late ? kLateFactor : 1.0)) {
        next = late ? 0.3 * relative / kLateFactor : 0.1 * relative;
        if (newton(interior.impulse(), late ? kLateFinish : kFinish)) return true;
      }
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
    return [this, before = factorizations](const Vector& l, int count) { observe_(l, before + count); };
  }

  ScaledProblem& problem_;
  const ContactProblem& part_;
  Law law_;
  double tolerance_, slack_;
  int max_factorizations_;
  AutoWorkspace& w_;
  IterateObserver observe_;
};

}  // namespace

void solve_auto(const ContactProblem& problem, const Settings& settings, AutoWorkspace& w, const Guess* guess,
                Solution& solution) {
  solution.impulse.setZero(problem.size());
  solution.solver = SolverType::Auto;
  if (guess) {
    problem.sets().project(guess->impulse, solution.impulse);
    w.impulse.resize(problem.size()), w.scratch.resize(problem.size());
    if (residual(problem, solution.impulse, settings.law, w.impulse, w.scratch).solves(settings.tolerance)) {
      finish(problem, settings, false, solution);
      return;
    }
    solution.impulse.setZero();
  }
  const double aim = 0.5 * settings.tolerance;
  const int budget = settings.max_iterations > 0 ? settings.max_iterations : kBudget;
  double reference = 0.0;  // of the whole certificate, before scaling to an island's unit
  for (const ConstraintSet& set : problem.sets())
    reference = std::max(reference, problem.free_velocity().segment(set.offset, set.size()).norm() /
                                        std::sqrt(problem.scale()[set.offset]));

  const std::vector<Island> islands = find_islands(problem);
  bool out_of_iterations = false;
  Index largest = -1;
  Recorder recorder(problem, settings, solution);
  for (std::size_t k = 0; k < islands.size(); ++k) {
    const Island& island = islands[k];
    const ContactProblem& part = island.problem ? *island.problem : problem;
    w.problem.setup(part);
    const Vector* start = nullptr;
    Vector warm;
    if (guess) {
      Vector impulse(part.size());
      for (Index i = 0; i < part.size(); ++i) impulse[i] = guess->impulse[island.row(i)];
      warm.resize(part.size());
      w.problem.from_impulse(impulse, warm);
      start = &warm;
    }
    IterateObserver observe;
    if (settings.record_history) {
      observe = [&](const Vector& l, int factorizations) {
        Vector impulse(part.size());
        w.problem.to_impulse(l, impulse);
        for (Index i = 0; i < part.size(); ++i) solution.impulse[island.row(i)] = impulse[i];
        recorder.record(solution.impulse, factorizations);
      };
    }
    Ladder ladder(w.problem, part, settings.law, aim, reference / w.problem.unit, budget, w, std::move(observe));
    ladder.solve(start);
    solution.iterations = std::max(solution.iterations, ladder.iterations);
    solution.factorizations = std::max(solution.factorizations, ladder.factorizations);
    if (part.size() > largest) largest = part.size(), solution.solver = ladder.method;
    if (ladder.best > settings.tolerance && ladder.factorizations >= budget) out_of_iterations = true;
    w.impulse.resize(part.size());
    w.problem.to_impulse(w.best, w.impulse);
    for (Index i = 0; i < part.size(); ++i) solution.impulse[island.row(i)] = w.impulse[i];
  }
  finish(problem, settings, out_of_iterations, solution);
}

}  // namespace signorini
