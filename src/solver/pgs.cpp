// Letters in this file: x, sigma  impulse and its velocity (G + R) x + g;  omega  over-relaxation.
#include "signorini/solver/pgs.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "no_malloc.hpp"

namespace signorini {
namespace {

constexpr int kDefaultSweeps = 5000;
constexpr int kSweepsBetweenChecks = 10;  // sweeps; a check costs about as much as one

/// Step lengths with which a step on one block alone does not overshoot.
PgsWorkspace::Step step_length(const ContactProblem& problem, const SparseMatrix& matrix, const ConstraintSet& set) {
  Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
  for (Index j = 0; j < set.size(); ++j) {
    for (SparseMatrix::InnerIterator it(matrix, set.offset + j); it; ++it) {
      const Index i = it.row() - set.offset;
      if (i >= 0 && i < set.size()) block(i, j) += it.value();
    }
    block(j, j) += problem.compliance()[set.offset + j];
  }
  const auto inverse = [](double x) { return x > 0.0 ? 1.0 / x : 0.0; };
  if (set.size() == 1) return {inverse(block(0, 0)), 0.0, 0.0};
  const double mean = 0.5 * (block(0, 0) + block(1, 1)), half = 0.5 * (block(0, 0) - block(1, 1));
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(block, Eigen::EigenvaluesOnly);
  return {inverse(block(2, 2)), inverse(mean + std::hypot(half, block(0, 1))), inverse(eigen.eigenvalues()[2])};
}

/// The two vectors of the iteration, sigma always that of x.
class Sweep {
 public:
  Sweep(const ContactProblem& problem, const Settings& settings, PgsWorkspace& workspace)
      : problem_(problem), law_(settings.law), omega_(settings.pgs.over_relaxation), w_(workspace) {}

  void operator()() {
    for (Index i = 0; i < problem_.num_sets(); ++i) {
      const ConstraintSet& set = problem_.sets()[i];
      const PgsWorkspace::Step& step = w_.step[static_cast<std::size_t>(i)];
      if (set.type != SetType::FrictionCone) {
        project_step(set, step.normal);
      } else if (law_ == Law::Ccp) {
        project_step(set, step.cone);
      } else {
        signorini_coulomb(set, step);
      }
    }
  }

 private:
  /// x_i = P_K(x_i - omega sigma_i / L_i).
  void project_step(const ConstraintSet& set, double step) {
    double x[3];
    for (Index k = 0; k < set.size(); ++k) x[k] = w_.impulse[set.offset + k] - omega_ * step * w_.sigma[set.offset + k];
    project(set, x, x);
    for (Index k = 0; k < set.size(); ++k) assign(set.offset + k, x[k]);
  }

  /// The NCP as (T3) and (T4): 0 <= x_N, sigma_N >= 0, x_N sigma_N = 0; x_T = P_disc(mu x_N)(x_T - step sigma_T).
  /// Faster than a step on the cone with the De Saxce term, and needs no term.
  void signorini_coulomb(const ConstraintSet& set, const PgsWorkspace::Step& step) {
    const Index t1 = set.offset, t2 = t1 + 1, n = t1 + 2;
    const double normal = w_.impulse[n] - omega_ * step.normal * w_.sigma[n];
    assign(n, normal < 0.0 ? 0.0 : normal);
    const double a = w_.impulse[t1] - omega_ * step.tangent * w_.sigma[t1];
    const double b = w_.impulse[t2] - omega_ * step.tangent * w_.sigma[t2];
    const double length = std::hypot(a, b), radius = set.friction * w_.impulse[n];
    const double shrink = length > radius ? radius / length : 1.0;
    assign(t1, shrink * a);
    assign(t2, shrink * b);
  }

  void assign(Index row, double value) {
    const double change = value - w_.impulse[row];
    if (change == 0.0) return;
    w_.impulse[row] = value;
    for (SparseMatrix::InnerIterator it(w_.matrix, row); it; ++it) w_.sigma[it.row()] += it.value() * change;
    w_.sigma[row] += problem_.compliance()[row] * change;
  }

  const ContactProblem& problem_;
  const Law law_;
  const double omega_;
  PgsWorkspace& w_;
};

}  // namespace

void solve_pgs(const ContactProblem& problem, const Settings& settings, PgsWorkspace& w, const Guess* guess,
               Solution& solution) {
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : kDefaultSweeps;
  w.matrix = problem.delassus().matrix();
  w.step.clear();
  for (const ConstraintSet& set : problem.sets()) w.step.push_back(step_length(problem, w.matrix, set));
  for (Vector* v : {&w.impulse, &w.sigma, &w.scratch}) v->setZero(problem.size());
  if (guess) w.impulse = guess->impulse;
  problem.sets().project(w.impulse, w.impulse);
  w.best = w.impulse;
  solution.iterations = solution.factorizations = 0;
  solution.penalty = 0.0;
  solution.history.clear();
  if (settings.record_history) solution.history.reserve(static_cast<std::size_t>(max_iterations));

  double best_relative = std::numeric_limits<double>::infinity();
  // The certificate, which also refreshes sigma. True when there is nothing more to do.
  const auto check = [&] {
    const Residual certificate = residual(problem, w.impulse, settings.law, w.sigma);
    const bool solves = certificate.solves(settings.tolerance);
    if (solves || certificate.relative < best_relative) {
      best_relative = certificate.relative;
      w.best = w.impulse;
    }
    if (settings.record_history && solution.iterations > 0) {
      solution.history.push_back({solution.iterations, 0, 0.0, certificate});
    }
    return solves || !std::isfinite(certificate.relative);
  };

  {
    const NoMalloc no_malloc;
    Sweep sweep(problem, settings, w);
    bool done = check();
    while (!done && solution.iterations < max_iterations) {
      sweep();
      const int k = ++solution.iterations;
      if (k < kSweepsBetweenChecks || k % kSweepsBetweenChecks == 0 || k == max_iterations || settings.record_history) {
        done = check();
      }
    }
  }
  solution.impulse = w.best;
  finish(problem, settings, solution.iterations >= max_iterations, solution);
}

}  // namespace signorini
