// Which method, when (docs/solvers, auto):
//   check the guess -> split into islands -> for each: warm Newton -> interior point, finished by Newton -> fallbacks.
#include "signorini/solver/auto.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "signorini/problem/island.hpp"

namespace signorini {
namespace {

constexpr int kWarmNewton = 8;        // iterations granted to Newton from a guess
constexpr double kFirstFinish = 1e-6; // certificate at which Newton first tries to finish
constexpr int kFinish = 3, kLateFinish = 6, kLastFinish = 12;
constexpr int kLate = 25;             // interior-point iterations after which Newton tries earlier
constexpr double kLateFactor = 100.0;

/// One island being solved: the best iterate so far and what it cost.
class Ladder {
 public:
  Ladder(ScaledProblem& problem, Law law, double tolerance, double global_reference, int max_factorizations,
         AutoWorkspace& workspace)
      : problem_(problem),
        law_(law),
        tolerance_(tolerance),
        slack_(std::max(1.0, global_reference / std::max(problem.reference, 1e-300))),
        max_factorizations_(max_factorizations),
        w_(workspace) {
    w_.newton.resize(problem.size(), problem.sets.num_sets());
  }

  int iterations = 0, factorizations = 0;
  double best = std::numeric_limits<double>::infinity();  ///< certificate of w_.best
  int rung = 0;                                           ///< how far down the ladder the answer was found

  void solve(const Vector* guess) {
    if (guess && newton(*guess, kWarmNewton)) return;
    if (guess && interior_point(guess, 1.0, false, 15)) return;
    if (interior_point(nullptr, 1.0, false, 40)) return;
    if (acceptable()) return;
    rung = 1;
    const Vector last = w_.interior_point.impulse();
    if (newton(last, kLastFinish)) return;
    if (newton(Vector(w_.best), kLastFinish)) return;
    rung = 2;
    interior_point(nullptr, 1.0, true, 60);
    if (done()) return;
    const Vector lagged = w_.interior_point.impulse();
    if (newton(lagged, kLastFinish)) return;
    if (interior_point(&lagged, 1.0, false, 40)) return;
    for (const double scale : {0.01, 10.0, 100.0}) {
      ++rung;
      if (out_of_budget()) return;
      if (interior_point(nullptr, scale, false, 40)) return;
      if (newton(Vector(w_.interior_point.impulse()), kLastFinish)) return;
    }
  }

 private:
  bool done() const { return best <= tolerance_; }
  /// Good enough for the whole problem, whose certificate has a larger scale than the island's.
  bool acceptable() const { return best <= tolerance_ * slack_; }
  bool out_of_budget() const { return factorizations >= max_factorizations_; }

  void offer(const Vector& l, double relative) {
    if (!(relative < best)) return;
    best = relative;
    w_.best = l;
  }

  bool newton(const Vector& from, int max_iterations) {
    w_.newton.l = from;
    const NewtonResult result = newton_iterations(problem_, law_, tolerance_, max_iterations, w_.newton);
    iterations += result.iterations;
    factorizations += result.factorizations;
    offer(w_.newton.best, result.relative);
    return done();
  }

  /// Interior point, with Newton trying to finish at 1e-6 and again each time the certificate has fallen tenfold. Gives
  /// up when the certificate has not halved in `patience` steps.
  bool interior_point(const Vector* guess, double start_scale, bool lagged, int patience) {
    InteriorPoint& method = w_.interior_point;
    method.start_scale = start_scale;
    method.lagged = lagged;
    method.start(problem_, law_, guess);
    double next = kFirstFinish, lowest = std::numeric_limits<double>::infinity(), milestone = lowest;
    int since = 0;
    const int before = factorizations;
    bool going = true;
    while (going) {
      const double relative = method.relative();
      offer(method.impulse(), relative);
      if (done()) break;
      lowest = std::min(lowest, relative);
      if (lowest <= 0.5 * milestone) milestone = lowest, since = 0;
      if (++since > patience || method.iterations() >= 100 || factorizations >= max_factorizations_) break;
      const bool late = method.held_back() || method.iterations() > kLate;
      if (relative <= next * (late ? kLateFactor : 1.0)) {
        next = late ? 0.3 * relative / kLateFactor : 0.1 * relative;
        if (newton(method.impulse(), late ? kLateFinish : kFinish)) break;
      }
      const int known = method.factorizations();
      going = method.step();
      factorizations += method.factorizations() - known;
      ++iterations;
    }
    (void)before;
    return done();
  }

  ScaledProblem& problem_;
  Law law_;
  double tolerance_, slack_;
  int max_factorizations_;
  AutoWorkspace& w_;
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
  const int budget = settings.max_iterations > 0 ? settings.max_iterations : 1000;
  double reference = 0.0;  // of the whole certificate, before scaling to an island's unit
  for (const ConstraintSet& set : problem.sets())
    reference = std::max(reference, problem.free_velocity().segment(set.offset, set.size()).norm() /
                                        std::sqrt(problem.scale()[set.offset]));

  const std::vector<Island> islands = find_islands(problem);
  bool out_of_iterations = false;
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
    Ladder ladder(w.problem, settings.law, aim, reference / w.problem.unit, budget, w);
    ladder.solve(start);
    solution.iterations += ladder.iterations;
    solution.factorizations += ladder.factorizations;
    if (ladder.best > settings.tolerance && ladder.factorizations >= budget) out_of_iterations = true;
    w.impulse.resize(part.size());
    w.problem.to_impulse(w.best, w.impulse);
    for (Index i = 0; i < part.size(); ++i) solution.impulse[island.row(i)] = w.impulse[i];
  }
  finish(problem, settings, out_of_iterations, solution);
}

}  // namespace signorini
