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
constexpr int kActiveHalvings = 6, kSweptHalvings = 1;
constexpr double kHalf = 0.5;  // what half a step leaves at best: where less is asked for, only full ones are tried
constexpr double kSmallestActiveDelta = 1e-9;
constexpr double kStickDelta = 1e-7;
constexpr int kChords = 4;          // steps with one factor after the first
constexpr double kChordGain = 0.3;  // what such a step must leave of the residual, at most
constexpr double kLeastGain = 0.3;  // what an iteration must leave, once the tolerance holds
// Proximal steps: the largest weight, what an inner solve aims at and has to leave of the residual, its iterations, and
// how the weight moves.
constexpr double kLargestWeight = 1.0, kProximalGain = 0.3, kConverged = 0.3, kHarder = 10.0, kEasier = 0.5;
constexpr int kProximalSteps = 15, kFewSteps = 4;
// With sweeps: iterations of an inner solve, what a step has to leave of the residual to be swept, and how many sweeps:
// one for so many sets, which costs less than a factorisation.
constexpr int kSweptSteps = 5, kLeastSmoothing = 10, kMostSmoothing = 60;
constexpr double kSweptLeft = 0.3, kSetsPerSweep = 40.0;
constexpr double kLeastSweptWeight = 1e-4;  // below it Gauss-Seidel takes too many sweeps to smooth anything
constexpr double kSameDirection = 0.9;      // cosine between two proximal steps beyond which the second one is doubled
constexpr double kLargestDelta = 1e-2, kSmallestDelta = 1e-7, kDeltaFactor = 0.1;

/// X = (I - D) + delta D C and Y = D C of every set (T28 to T31).
void derivative(const ScaledProblem& problem, Law law, const ConstVectorRef& l, const ConstVectorRef& t, double delta,
                BlockDiagonal& x, BlockDiagonal& y) {
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

// ---- The active rows alone (T34 to T36). Letters: a = l - t without Gamma; u, v the slip's direction and across it;
// w = a_T / |a_T|, which is u when the state is fresh; rho = mu a_N / |a_T|.

constexpr double kSmallestRho = 1e-9;

/// The state of every set (T34), from l and its velocity.
void find_active(const ScaledProblem& problem, const GrowVector& l, const GrowVector& t,
                 std::vector<ReducedSet>& sets) {
  using Kind = ReducedSet::Kind;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets[i];
    const Index o = set.offset;
    ReducedSet& reduced = sets[static_cast<std::size_t>(i)];
    const double a = l[o] - t[o];
    switch (set.type) {
      case SetType::FrictionCone: {
        const double a1 = l[o + 1] - t[o + 1], normal = l[o + 2] - t[o + 2];
        if (normal <= 0.0) {
          reduced.kind = Kind::Fixed;
          break;
        }
        const double tangent = std::sqrt(a * a + a1 * a1), radius = set.friction * normal;
        if (tangent <= radius) {
          reduced.kind = Kind::Stick;
        } else if (set.friction == 0.0) {
          reduced.kind = Kind::Normal;
        } else {
          reduced.kind = Kind::Slip;
          reduced.u0 = a / tangent, reduced.u1 = a1 / tangent;
          reduced.friction = set.friction;
          const double rho = std::max(radius / tangent, kSmallestRho);
          reduced.weight = (1.0 - rho) / rho;
        }
        break;
      }
      case SetType::HalfLine:
        reduced.kind = a > 0.0 ? Kind::Line : Kind::Fixed;
        break;
      case SetType::Interval:
        reduced.kind = a > set.lower && a < set.upper ? Kind::Line : Kind::Fixed;
        break;
      case SetType::Equality:
        reduced.kind = Kind::Line;
        break;
    }
  }
}

/// The part of the step that is known beforehand (T35): to zero, to a bound, or onto the cone along the slip. False
/// when there is none.
bool find_jump(const ScaledProblem& problem, const std::vector<ReducedSet>& sets, const GrowVector& l,
               const GrowVector& t, GrowVector& jump) {
  using Kind = ReducedSet::Kind;
  jump.setZero();
  bool any = false;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets[i];
    const ReducedSet& reduced = sets[static_cast<std::size_t>(i)];
    const Index o = set.offset;
    switch (reduced.kind) {
      case Kind::Fixed:
        if (set.type == SetType::FrictionCone) {
          for (Index k = o; k < o + 3; ++k) {
            jump[k] = -l[k];
            any |= l[k] != 0.0;
          }
        } else {
          double p = l[o] - t[o];
          project(set, &p, &p);
          jump[o] = p - l[o];
          any |= jump[o] != 0.0;
        }
        break;
      case Kind::Normal:
        jump[o] = -l[o], jump[o + 1] = -l[o + 1];
        any |= jump[o] != 0.0 || jump[o + 1] != 0.0;
        break;
      case Kind::Slip: {
        const double a0 = l[o] - t[o], a1 = l[o + 1] - t[o + 1], tangent = std::sqrt(a0 * a0 + a1 * a1);
        const double along = tangent > 0.0 ? (reduced.u0 * a0 + reduced.u1 * a1) / tangent : 1.0;  // u . w
        const double step = set.friction * l[o + 2] * along - (reduced.u0 * l[o] + reduced.u1 * l[o + 1]);
        jump[o] = step * reduced.u0, jump[o + 1] = step * reduced.u1;
        any |= step != 0.0;
        break;
      }
      default:
        break;
    }
  }
  return any;
}

/// Right-hand side of the reduced system (T35, T36); `moved` is t after the jump.
void find_right_side(const ScaledProblem& problem, const std::vector<ReducedSet>& sets, const GrowVector& l,
                     const GrowVector& t, const GrowVector& moved, GrowVector& rhs) {
  using Kind = ReducedSet::Kind;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ReducedSet& reduced = sets[static_cast<std::size_t>(i)];
    const Index o = problem.sets[i].offset;
    switch (reduced.kind) {
      case Kind::Fixed:
        break;
      case Kind::Line:
        rhs[o] = -moved[o];
        break;
      case Kind::Normal:
        rhs[o] = -moved[o + 2];
        break;
      case Kind::Slip: {
        const double a0 = l[o] - t[o], a1 = l[o + 1] - t[o + 1], tangent = std::sqrt(a0 * a0 + a1 * a1);
        const double radius = problem.sets[i].friction * (l[o + 2] - t[o + 2]);
        const double across = reduced.u0 * l[o + 1] - reduced.u1 * l[o];                           // v . l
        const double drift = tangent > 0.0 ? (reduced.u0 * a1 - reduced.u1 * a0) / tangent : 0.0;  // v . w
        rhs[o] = (radius * drift - across) * (1.0 + reduced.weight) -
                 (reduced.u0 * (moved[o + 1] - t[o + 1]) - reduced.u1 * (moved[o] - t[o]));
        rhs[o + 1] = -moved[o + 2];
        break;
      }
      case Kind::Stick:
        for (Index k = o; k < o + 3; ++k) rhs[k] = -moved[k];
        break;
    }
  }
}

/// direction = jump + F x, x being the reduced solution.
void expand(const ScaledProblem& problem, const std::vector<ReducedSet>& sets, const GrowVector& jump,
            const GrowVector& x, GrowVector& direction) {
  using Kind = ReducedSet::Kind;
  direction = jump;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ReducedSet& reduced = sets[static_cast<std::size_t>(i)];
    const Index o = problem.sets[i].offset;
    switch (reduced.kind) {
      case Kind::Fixed:
        break;
      case Kind::Line:
        direction[o] = x[o];
        break;
      case Kind::Normal:
        direction[o + 2] = x[o];
        break;
      case Kind::Slip: {
        const double along = reduced.friction * x[o + 1];
        direction[o] += along * reduced.u0 - x[o] * reduced.u1;
        direction[o + 1] += along * reduced.u1 + x[o] * reduced.u0;
        direction[o + 2] = x[o + 1];
        break;
      }
      case Kind::Stick:
        for (Index k = o; k < o + 3; ++k) direction[k] = x[k];
        break;
    }
  }
}

}  // namespace

void NewtonMemory::resize(Index size, Index num_sets) {
  for (GrowVector* v : {&l, &t, &natural, &direction, &trial, &trial_t, &trial_natural, &best, &jump, &rhs})
    v->resize(size);
  reduced.resize(static_cast<std::size_t>(num_sets));
}

NewtonResult newton_iterations(ScaledProblem& problem, Law law, double tolerance, int max_iterations, NewtonMemory& m,
                               const IterateObserver& observe) {
  m.x.resize(m.reduced.size()), m.y.resize(m.reduced.size());
  const NoMalloc guard;
  NewtonResult result;
  const auto evaluate = [&](const GrowVector& l, GrowVector& t, GrowVector& natural) {
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

NewtonResult active_newton_iterations(ScaledProblem& problem, double tolerance, double aim, int max_iterations,
                                      NewtonMemory& m, const IterateObserver& observe, double weight,
                                      const GrowVector* centre, const ActiveSearch& search, BlockSweeps* sweeps) {
  const NoMalloc guard;
  NewtonResult result;
  const auto evaluate = [&](const GrowVector& l, GrowVector& t, GrowVector& natural) {
    problem.system->apply(l, t);
    t += problem.b;
    if (centre) t += weight * (l - *centre);
    return natural_residual(problem, Law::Ncp, l, t, natural);
  };
  /// direction from m.l with the factor and the states at hand.
  const auto find_direction = [&] {
    const bool jumps = find_jump(problem, m.reduced, m.l, m.t, m.jump);
    if (jumps) {
      problem.system->apply(m.jump, m.trial_t);
      if (centre) m.trial_t += weight * m.jump;
      m.trial_t += m.t;
    }
    find_right_side(problem, m.reduced, m.l, m.t, jumps ? m.trial_t : m.t, m.rhs);
    problem.system->solve_reduced(m.rhs);
    expand(problem, m.reduced, m.jump, m.rhs, m.direction);
  };
  double relative =
      search.velocity_known ? natural_residual(problem, Law::Ncp, m.l, m.t, m.natural) : evaluate(m.l, m.t, m.natural);
  const auto accept = [&](double accepted) {
    swap(m.l, m.trial);
    swap(m.t, m.trial_t);
    swap(m.natural, m.trial_natural);
    relative = accepted;
    if (relative < result.relative) result.relative = relative, m.best = m.l;
    if (observe) {
      const AllowMalloc allow;
      observe(m.l, result.factorizations);
    }
  };
  result.relative = relative;
  m.best = m.l;
  double merits[kWatch];
  std::fill(merits, merits + kWatch, 0.0);
  for (; result.iterations < max_iterations && relative > aim; ++result.iterations) {
    const double before = relative;
    merits[result.iterations % kWatch] = m.natural.norm();
    find_active(problem, m.l, m.t, m.reduced);
    ++result.factorizations;
    const double damping = search.delta * std::pow(relative, search.power);
    const double delta = centre ? weight : std::clamp(damping, kSmallestActiveDelta, kLargestDelta);
    if (!problem.system->factor_reduced(m.reduced, delta)) break;
    find_direction();

    const double merit = m.natural.norm(), reference = *std::max_element(merits, merits + kWatch);
    const int most_halvings = sweeps ? kSweptHalvings : search.most_left < kHalf ? 0 : kActiveHalvings;
    double step = 1.0;
    for (int halvings = 0;; ++halvings, step *= 0.5) {
      m.trial = m.l + step * m.direction;
      const double tried = evaluate(m.trial, m.trial_t, m.trial_natural);
      if (m.trial_natural.norm() <= (1.0 - 1e-4 * step) * reference || halvings == most_halvings) {
        accept(tried);
        break;
      }
    }
    if (std::isnan(relative)) break;
    if (sweeps && relative > aim && m.natural.norm() > kSweptLeft * merit) {
      sweeps->start(problem, &m.l, weight, centre);
      const double count = std::floor(static_cast<double>(problem.sets.num_sets()) / kSetsPerSweep);
      const int num_sweeps = static_cast<int>(std::clamp<double>(count, kLeastSmoothing, kMostSmoothing));
      for (int k = 0; k < num_sweeps; ++k) sweeps->sweep(problem);
      m.trial = sweeps->impulse(), m.trial_t = sweeps->velocity();
      const double swept = natural_residual(problem, Law::Ncp, m.trial, m.trial_t, m.trial_natural);
      if (m.trial_natural.norm() < m.natural.norm()) {
        accept(swept);
        continue;
      }
    }
    // Again with the same factor, as long as that gains.
    for (int chord = 0; step == 1.0 && chord < kChords && relative > aim; ++chord) {
      find_direction();
      m.trial = m.l + m.direction;
      const double tried = evaluate(m.trial, m.trial_t, m.trial_natural);
      if (!(tried <= kChordGain * relative)) break;
      accept(tried);
    }
    if (!(relative <= search.most_left * before)) break;
    if (result.relative <= tolerance && !(relative <= kLeastGain * before)) break;
  }
  // The answer lies in the cones where that costs nothing.
  problem.sets.project(m.best, m.trial);
  if (result.relative <= 0.1 * tolerance) {  // a projection moves it by no more than its residual
    m.best = m.trial;
    return result;
  }
  const double projected = evaluate(m.trial, m.trial_t, m.trial_natural);
  if (projected <= std::max(result.relative, tolerance)) result.relative = projected, m.best = m.trial;
  return result;
}

bool stick_everywhere(ScaledProblem& problem, NewtonMemory& m) {
  using Kind = ReducedSet::Kind;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets[i];
    m.reduced[static_cast<std::size_t>(i)].kind = set.size() == 1      ? Kind::Line
                                                  : set.friction > 0.0 ? Kind::Stick
                                                                       : Kind::Normal;
  }
  if (!problem.system->factor_reduced(m.reduced, kStickDelta)) return false;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const Index o = problem.sets[i].offset;
    const bool normal = m.reduced[static_cast<std::size_t>(i)].kind == Kind::Normal;
    m.rhs.segment(o, problem.sets[i].size()) = -problem.b.segment(o, problem.sets[i].size());
    if (normal) m.rhs[o] = -problem.b[o + 2];
  }
  problem.system->solve_reduced(m.rhs);
  m.jump.setZero();
  expand(problem, m.reduced, m.jump, m.rhs, m.l);
  return m.l.allFinite();
}

NewtonResult proximal_newton_iterations(ScaledProblem& problem, double tolerance, double weight, int max_factorizations,
                                        int patience, NewtonMemory& m, const IterateObserver& observe,
                                        BlockSweeps* sweeps) {
  if (sweeps) sweeps->start(problem, &m.l);  // allocates
  for (GrowVector* v : {&m.centre, &m.nearest, &m.last, &m.move}) v->resize(m.l.size());
  const NoMalloc guard;
  NewtonResult result;
  const auto evaluate = [&](const GrowVector& l) {
    problem.system->apply(l, m.t);
    m.t += problem.b;
    return natural_residual(problem, Law::Ncp, l, m.t, m.natural);
  };
  const auto watch = [&](const ConstVectorRef& l, int count) { observe(l, result.factorizations + count); };
  m.centre = m.last = m.nearest = m.l;
  m.move.setZero(m.l.size());
  double relative = evaluate(m.centre);  // of m.last
  result.relative = relative;
  double milestone = relative;
  int since = 0;  // factorisations since the residual has halved
  while (since < patience && result.relative > tolerance && result.factorizations < max_factorizations &&
         weight <= kLargestWeight) {
    const double target = std::max(kProximalGain * relative, 0.1 * tolerance);
    BlockSweeps* smoother = weight >= kLeastSweptWeight ? sweeps : nullptr;
    const int most = std::min(smoother ? kSweptSteps : kProximalSteps, max_factorizations - result.factorizations);
    m.l = m.centre;
    const NewtonResult inner =
        active_newton_iterations(problem, target, target, most, m, observe ? IterateObserver(watch) : IterateObserver(),
                                 weight, &m.centre, {}, smoother);
    ++result.iterations;
    result.factorizations += inner.factorizations;
    const double now = evaluate(m.best);
    if (std::isnan(now)) break;
    if (now < result.relative) result.relative = now, m.nearest = m.best;
    since += inner.factorizations;
    if (result.relative <= 0.5 * milestone) milestone = result.relative, since = 0;
    const bool converged = inner.relative <= std::max(kConverged * relative, tolerance);
    if (converged || now < relative) {
      m.trial = m.best - m.last;
      const bool same = m.trial.dot(m.move) > kSameDirection * m.trial.norm() * m.move.norm();
      m.move = m.trial;
      m.last = m.centre = m.best;
      if (converged && same) m.centre += m.move;
      relative = now;
    }
    if (!converged)
      weight *= kHarder;
    else if (inner.factorizations <= kFewSteps)
      weight *= kEasier;
  }
  m.best = m.nearest;
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
  const NewtonResult result = newton_iterations(
      w.problem, settings.law, 0.5 * settings.tolerance, max_iterations, w.memory,
      [&](const ConstVectorRef& l, int factorizations) { recorder.record(l, w.problem, factorizations); });
  solution.iterations = result.iterations;
  solution.factorizations = result.factorizations;
  w.problem.to_impulse(w.memory.best, solution.impulse);
  finish(problem, settings, result.iterations >= max_iterations, solution);
}

}  // namespace signorini
