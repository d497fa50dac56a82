// Letters in this file: x, sigma  impulse and its velocity (G + R) x + g;  omega  over-relaxation.
#include "signorini/solver/pgs.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>

#include "sweeps.hpp"

namespace signorini {
namespace {

/// Step lengths with which a step on one block alone does not overshoot.
PgsWorkspace::Step step_length(const GaussSeidel& rows, const ConstraintSet& set) {
  const Eigen::Matrix3d block = rows.block(set);
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
        w_.rows.project_step(set, omega_ * step.normal);
      } else if (law_ == Law::Ccp) {
        w_.rows.project_step(set, omega_ * step.cone);
      } else {
        signorini_coulomb(set, step);
      }
    }
  }

 private:
  /// The NCP as (T3) and (T4): 0 <= x_N, sigma_N >= 0, x_N sigma_N = 0; x_T = P_disc(mu x_N)(x_T - step sigma_T).
  /// Faster than a step on the cone with the De Saxce term, and needs no term.
  void signorini_coulomb(const ConstraintSet& set, const PgsWorkspace::Step& step) {
    const Index t1 = set.offset, t2 = t1 + 1, n = t1 + 2;
    const Vector &x = w_.rows.impulse, &sigma = w_.rows.sigma;
    const double normal = x[n] - omega_ * step.normal * sigma[n];
    w_.rows.assign(n, normal < 0.0 ? 0.0 : normal);
    const double a = x[t1] - omega_ * step.tangent * sigma[t1];
    const double b = x[t2] - omega_ * step.tangent * sigma[t2];
    const double length = std::hypot(a, b), radius = set.friction * x[n];
    const double shrink = length > radius ? radius / length : 1.0;
    w_.rows.assign(t1, shrink * a);
    w_.rows.assign(t2, shrink * b);
  }

  const ContactProblem& problem_;
  const Law law_;
  const double omega_;
  PgsWorkspace& w_;
};

}  // namespace

void solve_pgs(const ContactProblem& problem, const Settings& settings, PgsWorkspace& w, const Guess* guess,
               Solution& solution) {
  w.rows.setup(problem, guess);
  w.step.clear();
  for (const ConstraintSet& set : problem.sets()) w.step.push_back(step_length(w.rows, set));
  problem.sets().project(w.rows.impulse, w.rows.impulse);
  sweep_and_finish(
      problem, settings, w.rows, Sweep(problem, settings, w),
      [&](const Residual& certificate) {
        return Judgement{certificate.excess(settings.tolerance), certificate.solves(settings.tolerance)};
      },
      solution);
}

}  // namespace signorini
