// Minimises the cost of Todorov 2014 and Castro et al. 2022 over the velocities v = v_f + M^-1 J^T l, among which its
// minimiser is: with u = A l + b the contact velocity in the scaled problem and r I the compliance,
//     cost(l) = 1/2 l . A l + r/2 sum |P_K(-u_i / r)|^2     (for sets that are cones)
//     gradient = A (l - gamma(u)),   gamma(u) = P_K(-u / r)
//     (I + D A / r) step = gamma - l,   D the derivative of P_K at -u / r
// At the minimum gamma solves the CCP of A + r I. Once differentiable, strictly convex in u: Newton with an exact line
// search converges from anywhere, and in the end quadratically.
#include "signorini/solver/convex_newton.hpp"

#include <algorithm>
#include <cmath>

#include "finish.hpp"
#include "no_malloc.hpp"

namespace signorini {
namespace {

constexpr int kNewtonIterations = 100;
constexpr int kMaxDoublings = 20, kMaxSearch = 60;
constexpr double kExact = 1e-10;  // what is left of the slope
constexpr double kRounding = 1e-15;

/// Derivative of the projection at a, symmetric; of a one-row set, entry (0, 0).
void projection_derivative(const ConstraintSet& set, const double* a, Eigen::Matrix3d& d) {
  d.setZero();
  if (set.type != SetType::FrictionCone) {
    double p;
    project(set, a, &p);
    d(0, 0) = p == a[0] ? 1.0 : 0.0;
    return;
  }
  const double mu = set.friction, tangent = std::sqrt(a[0] * a[0] + a[1] * a[1]);
  if (mu * tangent <= -a[2]) return;
  if (mu == 0.0) {
    d(2, 2) = 1.0;
  } else if (tangent <= mu * a[2]) {
    d.setIdentity();
  } else {  // n (mu w, 1) with w = a_T / |a_T|
    const double w0 = a[0] / tangent, w1 = a[1] / tangent, factor = 1.0 / (1.0 + mu * mu);
    const double ratio = mu * (a[2] + mu * tangent) * factor / tangent;
    const double n[3] = {mu * w0, mu * w1, 1.0}, v[3] = {-w1, w0, 0.0};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) d(i, j) = factor * n[i] * n[j] + ratio * v[i] * v[j];
  }
}

/// Slope and curvature of the cost along the step, at `along` of it.
struct Line {
  double slope = 0.0, curvature = 0.0;
  double size = 0.0;  ///< of what the slope is a difference of
};

Line line(const ConvexNewtonWorkspace& w, double r, double along) {
  Line out;
  out.curvature = w.step.dot(w.moved);
  out.slope = w.step.dot(w.u) - w.step.dot(w.problem.b) + along * out.curvature;  // step . A (l + along step)
  out.size = std::abs(out.slope);
  Eigen::Matrix3d d;
  for (const ConstraintSet& set : w.problem.sets) {
    double a[3], p[3];
    const Index n = set.size();
    const double* q = w.moved.data() + set.offset;
    for (Index k = 0; k < n; ++k) a[k] = -(w.u[set.offset + k] + along * q[k]) / r;
    project(set, a, p);
    projection_derivative(set, a, d);
    for (Index k = 0; k < n; ++k) {
      out.slope -= p[k] * q[k];
      out.size += std::abs(p[k] * q[k]);
      for (Index j = 0; j < n; ++j) out.curvature += q[k] * d(k, j) * q[j] / r;
    }
  }
  return out;
}

/// Where the slope is 0, by Newton inside a bracket: the slope grows. 0 when the step leads nowhere.
double search(const ConvexNewtonWorkspace& w, double r) {
  const Line start = line(w, r, 0.0);
  const double first = start.slope;
  if (!(first < -kRounding * start.size)) return 0.0;
  double low = 0.0, high = 1.0;
  Line now = line(w, r, high);
  for (int k = 0; now.slope < kExact * first && k < kMaxDoublings; ++k) {  // first < 0: the slope has not turned yet
    low = high, high *= 2.0;
    now = line(w, r, high);
  }
  double along = high;
  for (int k = 0; k < kMaxSearch && std::abs(now.slope) > -kExact * first; ++k) {
    (now.slope < 0.0 ? low : high) = along;
    along -= now.slope / now.curvature;
    if (!(along > low && along < high)) along = 0.5 * (low + high);
    if (along == low || along == high) break;
    now = line(w, r, along);
  }
  return along;
}

}  // namespace

void solve_convex_newton(const ContactProblem& problem, const Settings& settings, ConvexNewtonWorkspace& w,
                         const Guess* guess, Solution& solution) {
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : kNewtonIterations;
  const double r = (1.0 - settings.convex.impedance) / settings.convex.impedance;  // blocks of A have a mean diagonal 1
  w.problem.setup(problem, settings.tolerance);
  ScaledProblem& p = w.problem;
  for (GrowVector* v : {&w.l, &w.u, &w.impulse, &w.step, &w.moved, &w.gradient}) v->setZero(p.size());
  w.x.resize(static_cast<std::size_t>(problem.num_sets()));
  w.y.resize(w.x.size());
  if (guess) p.from_impulse(guess->impulse, w.l);
  Recorder recorder(problem, settings, solution);

  bool done = false;
  double relative = 0.0;
  // The impulse of u, and the model's residual of it: A (impulse - l) is the whole of it, but for a projection.
  const auto judge = [&] {
    w.impulse = -w.u / r;
    p.sets.project(w.impulse, w.impulse);
    w.step = w.impulse - w.l;
    p.system->apply(w.step, w.gradient);
    w.moved = w.u + w.gradient + r * w.impulse;  // (A + r I) impulse + b
    relative = natural_residual(p, Law::Ccp, w.impulse, w.moved, w.gradient);
    done = relative <= settings.tolerance;
    return done || !std::isfinite(relative);
  };
  {
    const NoMalloc no_malloc;
    p.system->apply(w.l, w.u);
    w.u += p.b;
    bool stop = judge();
    recorder.record(w.impulse, p, 0);
    while (!stop && solution.iterations < max_iterations) {
      for (Index i = 0; i < p.sets.num_sets(); ++i) {
        const ConstraintSet& set = p.sets[i];
        double a[3];
        for (Index k = 0; k < set.size(); ++k) a[k] = -w.u[set.offset + k] / r;
        Eigen::Matrix3d& y = w.y[static_cast<std::size_t>(i)];
        projection_derivative(set, a, y);
        y /= r;
        w.x[static_cast<std::size_t>(i)].setIdentity();
      }
      ++solution.factorizations;
      if (!p.system->factor(w.x, w.y)) break;
      p.system->solve(w.step);  // judge() left impulse - l there
      p.system->apply(w.step, w.moved);
      const double along = search(w, r);
      if (!(along > 0.0)) break;
      w.l += along * w.step;
      p.system->apply(w.l, w.u);
      w.u += p.b;
      ++solution.iterations;
      stop = judge();
      recorder.record(w.impulse, p, solution.factorizations);
    }
  }
  p.to_impulse(w.impulse, solution.impulse);
  finish(problem, settings, !done && solution.iterations >= max_iterations, solution);
  if (solution.status != Status::Invalid) solution.model_residual = relative;
}

}  // namespace signorini
