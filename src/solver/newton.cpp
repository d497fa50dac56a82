// Semismooth Newton on the natural map (docs/theory.md, T26 to T33). Letters in this file:
//   l, t    scaled impulse and its velocity A l + b        r    natural residual l - P_K(l - s)
//   s       t + Gamma(t)                                   D    derivative of P_K at l - s
//   C       derivative of s by t                           K    (I - D) + D C (A + delta I), the Newton matrix
#include "signorini/solver/newton.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "no_malloc.hpp"

namespace signorini {
namespace {

constexpr int kWatch = 5;  // residuals that the nonmonotone line search looks back on
constexpr int kMaxHalvings = 10;
constexpr double kLargestDelta = 1e-2, kSmallestDelta = 1e-7, kDeltaFactor = 0.1;

/// X = (I - D) + delta D C and Y = D C of every set (T28 to T31).
void derivative(const ScaledProblem& problem, Law law, const Vector& l, const Vector& t, double delta, BlockDiagonal& x,
                BlockDiagonal& y) {
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets[i];
    const Index o = set.offset;
    Eigen::Matrix3d& xi = x[static_cast<std::size_t>(i)];
    Eigen::Matrix3d& yi = y[static_cast<std::size_t>(i)];
    if (set.type != SetType::FrictionCone) {
      const double a = l[o] - t[o];
      double p;
      project(set, &a, &p);
      const double d = p == a ? 1.0 : 0.0;
      yi(0, 0) = d;
      xi(0, 0) = 1.0 - d + delta * d;
      continue;
    }
    const double mu = set.friction;
    const double speed = std::sqrt(t[o] * t[o] + t[o + 1] * t[o + 1]);
    const double a0 = l[o] - t[o], a1 = l[o + 1] - t[o + 1];
    const double a2 = l[o + 2] - t[o + 2] - (law == Law::Ncp ? mu * speed : 0.0);
    const double tangent = std::sqrt(a0 * a0 + a1 * a1);
    if (mu * tangent <= -a2) {  // open: D = 0
      yi.setZero();
      xi.setIdentity();
      continue;
    }
    double c0 = 0.0, c1 = 0.0;  // last row of C is (c0, c1, 1)
    if (law == Law::Ncp && speed > 0.0) c0 = mu * t[o] / speed, c1 = mu * t[o + 1] / speed;
    if (tangent <= mu * a2) {  // stick: D = I
      yi.setIdentity();
      yi(2, 0) = c0, yi(2, 1) = c1;
      xi = delta * yi;
      continue;
    }
    // slip: the projection is n (mu u, 1), n = (a2 + mu |a_T|) / (1 + mu^2), u = a_T / |a_T|
    const double u0 = a0 / tangent, u1 = a1 / tangent;
    const double factor = 1.0 / (1.0 + mu * mu), n = (a2 + mu * tangent) * factor;
    const double ratio = mu * n / tangent, g0 = factor * mu * u0, g1 = factor * mu * u1;
    Eigen::Matrix3d d;
    d << mu * u0 * g0 + ratio * u1 * u1, mu * u0 * g1 - ratio * u0 * u1, mu * u0 * factor,  //
        mu * u1 * g0 - ratio * u0 * u1, mu * u1 * g1 + ratio * u0 * u0, mu * u1 * factor,   //
        g0, g1, factor;
    yi = d;
    for (int k = 0; k < 3; ++k) yi(k, 0) += d(k, 2) * c0, yi(k, 1) += d(k, 2) * c1;
    xi = delta * yi - d;
    xi.diagonal().array() += 1.0;
  }
}

}  // namespace

void NewtonMemory::resize(Index size, Index num_sets) {
  for (Vector* v : {&l, &t, &natural, &direction, &trial, &trial_t, &trial_natural, &best}) v->resize(size);
  x.resize(static_cast<std::size_t>(num_sets));
  y.resize(static_cast<std::size_t>(num_sets));
}

NewtonResult newton_iterations(ScaledProblem& problem, Law law, double tolerance, int max_iterations, NewtonMemory& m,
                               const IterateObserver& observe) {
  const NoMalloc guard;
  NewtonResult result;
  const auto evaluate = [&](const Vector& l, Vector& t, Vector& natural) {
    problem.system->apply(l, t);
    t += problem.b;
    return natural_residual(problem, law, l, t, natural);
  };
  double relative = evaluate(m.l, m.t, m.natural);
  result.relative = relative;
  m.best = m.l;
  double merits[kWatch];
  std::fill(merits, merits + kWatch, 0.0);
  for (; result.iterations < max_iterations && relative > tolerance; ++result.iterations) {
    const double merit = m.natural.norm();
    merits[result.iterations % kWatch] = merit;
    const double delta = std::clamp(kDeltaFactor * merit, kSmallestDelta, kLargestDelta);
    derivative(problem, law, m.l, m.t, delta, m.x, m.y);
    ++result.factorizations;
    if (!problem.system->factor(m.x, m.y)) break;
    m.direction = -m.natural;
    problem.system->solve(m.direction);
    if (!m.direction.allFinite()) break;

    const double reference = *std::max_element(merits, merits + kWatch);
    double step = 1.0;
    for (int halvings = 0;; ++halvings, step *= 0.5) {
      m.trial = m.l + step * m.direction;
      relative = evaluate(m.trial, m.trial_t, m.trial_natural);
      if (m.trial_natural.norm() <= (1.0 - 1e-4 * step) * reference || halvings == kMaxHalvings) break;
    }
    std::swap(m.l, m.trial);
    std::swap(m.t, m.trial_t);
    std::swap(m.natural, m.trial_natural);
    if (!(relative >= result.relative)) result.relative = relative, m.best = m.l;
    if (observe) {
      const AllowMalloc allow;
      observe(m.l, result.factorizations);
    }
    if (std::isnan(relative)) break;
  }
  // The answer lies in the cones where that costs nothing.
  problem.sets.project(m.best, m.trial);
  const double projected = evaluate(m.trial, m.trial_t, m.trial_natural);
  if (projected <= std::max(result.relative, tolerance)) result.relative = projected, m.best = m.trial;
  return result;
}

void solve_newton(const ContactProblem& problem, const Settings& settings, NewtonWorkspace& w, const Guess* guess,
                  Solution& solution) {
  w.problem.setup(problem, 0.5 * settings.tolerance);
  w.memory.resize(problem.size(), problem.num_sets());
  if (guess)
    w.problem.from_impulse(guess->impulse, w.memory.l);
  else
    w.memory.l.setZero();
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : 100;
  Recorder recorder(problem, settings, solution);
  recorder.record(w.memory.l, w.problem, 0);
  const NewtonResult result =
      newton_iterations(w.problem, settings.law, 0.5 * settings.tolerance, max_iterations, w.memory,
                        [&](const Vector& l, int factorizations) { recorder.record(l, w.problem, factorizations); });
  solution.iterations = result.iterations;
  solution.factorizations = result.factorizations;
  w.problem.to_impulse(w.memory.best, solution.impulse);
  finish(problem, settings, result.iterations >= max_iterations, solution);
}

}  // namespace signorini
