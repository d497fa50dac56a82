// Primal-dual interior point (docs/theory.md, section 8). Letters in this file, per friction cone in Jordan coordinates
// (normal first): x = (mu l_N, l_T), z = (s_N / mu, t_T) with s = t + Gamma(t), both in the second-order cone
// {x_0 >= |x_T|} (T17);  e = (1, 0, 0).
//   r = s - (A l + b) - Gamma (T18)  H = W^-2, W the Nesterov-Todd scaling: W z = W^-1 x (T19)
//   E = e z_T^T / |z_T|, the derivative of Gamma (T22)
// Newton step: (A + (I - theta E) H) dx = (I - theta E) c + r (T23), dz = c - H dx, c from centrality (T21).
#include "signorini/solver/interior_point.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "no_malloc.hpp"

namespace signorini {
namespace {

constexpr double kToBoundary = 0.99;
constexpr double kLateCentring = 0.1;
constexpr int kLateIteration = 20;   // iterations after which centring is never less than kLateCentring
constexpr int kHold = 8;             // iterations that a reduced theta is held, doubled at each recurrence
constexpr double kEquality = 1e-10;  // keeps redundant one-row sets factorable
// How far inside the cones it starts from a guess: at least, and of the velocity over the largest error.
constexpr double kInside = 1e-3, kInsideVelocity = 0.3;

using Vector3 = std::array<double, 3>;

double dot(const Vector3& a, const Vector3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/// x_0^2 - |x_T|^2 as a product, which keeps its digits near the boundary.
double determinant(const Vector3& x) {
  const double t = std::sqrt(x[1] * x[1] + x[2] * x[2]);
  return (x[0] - t) * (x[0] + t);
}

Vector3 jordan_product(const Vector3& a, const Vector3& b) {
  return {dot(a, b), a[0] * b[1] + b[0] * a[1], a[0] * b[2] + b[0] * a[2]};
}

/// Solves jordan_product(a, x) = b.
Vector3 jordan_divide(const Vector3& a, const Vector3& b) {
  const double inverse = 1.0 / a[0], x0 = (a[0] * b[0] - a[1] * b[1] - a[2] * b[2]) / determinant(a);
  return {x0, (b[1] - x0 * a[1]) * inverse, (b[2] - x0 * a[2]) * inverse};
}

/// Quadratic representation's square root for unit-determinant w: [w0, w_T'; w_T, I + share w_T w_T'], share =
/// 1 / (1 + w0).
Vector3 scale(const Vector3& w, double share, const Vector3& v) {
  const double t = w[1] * v[1] + w[2] * v[2], f = v[0] + t * share;
  return {w[0] * v[0] + t, v[1] + f * w[1], v[2] + f * w[2]};
}

Vector3 reflect(const Vector3& w) { return {w[0], -w[1], -w[2]}; }

Vector3 times(double a, const Vector3& v) { return {a * v[0], a * v[1], a * v[2]}; }

/// Largest a with x + a dx in the second-order cone, c = determinant(x): the smallest positive root of
/// det(dx) a^2 + 2 b a + c.
double step_to_boundary(const Vector3& x, double c, const Vector3& dx) {
  const double a = dx[0] * dx[0] - dx[1] * dx[1] - dx[2] * dx[2], b = x[0] * dx[0] - x[1] * dx[1] - x[2] * dx[2];
  const double discriminant = b * b - a * c;
  if (discriminant >= 0.0) {
    const double root = std::sqrt(discriminant);
    if (b <= 0.0) {
      if (root > b) return c / (root - b);
    } else if (a < 0.0) {
      return (root + b) / -a;
    }
  }
  return dx[0] < 0.0 ? -x[0] / dx[0] : std::numeric_limits<double>::infinity();
}

}  // namespace

void InteriorPoint::start(ScaledProblem& problem, Law law, const GrowVector* l_guess) {
  const Index n = problem.size();
  problem_ = &problem;
  law_ = law;
  elements_.clear();
  fixed_.assign(static_cast<std::size_t>(n), 0);
  any_fixed_ = false;
  for (GrowVector* v : {&l_, &t_, &natural_, &residual_, &rhs_}) v->setZero(n);
  x_.resize(static_cast<std::size_t>(problem.sets.num_sets()));
  y_.resize(x_.size());
  iterations_ = factorizations_ = negatives_ = hold_ = 0;
  hold_length_ = kHold;
  step_ = 1.0;
  theta_ = options.theta;

  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets[i];
    Element e;
    e.set = static_cast<int>(i);
    e.row = static_cast<int>(set.offset);
    const auto fix = [&](Index row, double value) {
      fixed_[static_cast<std::size_t>(row)] = 1;
      any_fixed_ = true;
      l_[row] = value;
    };
    switch (set.type) {
      case SetType::FrictionCone:
        if (set.friction > 0.0) {
          e.friction = set.friction;
          elements_.push_back(e);
          break;
        }
        fix(set.offset, 0.0);
        fix(set.offset + 1, 0.0);
        e.row += 2;
        e.line = true;
        elements_.push_back(e);
        break;
      case SetType::HalfLine:
        e.line = true;
        elements_.push_back(e);
        break;
      case SetType::Interval: {
        e.line = true;
        if (set.lower == set.upper) {
          fix(set.offset, set.lower);
          break;
        }
        const bool below = std::isfinite(set.lower), above = std::isfinite(set.upper);
        l_[set.offset] = below && above ? 0.5 * (set.lower + set.upper)
                         : below        ? set.lower + 1.0
                         : above        ? set.upper - 1.0
                                        : 0.0;
        e.bound = set.lower;
        if (below) elements_.push_back(e);
        e.sign = -1.0;
        e.bound = set.upper;
        if (above) elements_.push_back(e);
        break;
      }
      case SetType::Equality:
        break;
    }
  }

  const double dual = 1.0 + (n > 0 ? problem.b.cwiseAbs().maxCoeff() : 0.0);
  // Around a guess and its velocity, as far inside the cones as the guess is off.
  double inside_x = kInside, inside_z = kInside;
  if (l_guess) {
    problem.system->apply(*l_guess, t_);
    t_ += problem.b;
    natural_residual(problem, law, *l_guess, t_, natural_);
    const double error = natural_.lpNorm<Eigen::Infinity>();
    if (std::isfinite(error))
      inside_x = std::max(error, kInside), inside_z = std::max(kInsideVelocity * error, kInside);
  }
  for (Element& e : elements_) {
    e.x = {options.start_scale, 0.0, 0.0};
    e.z = {dual, 0.0, 0.0};
    if (e.line) {
      if (problem.sets[e.set].type == SetType::Interval) e.x[0] = e.sign * (l_[e.row] - e.bound);
      l_[e.row] = e.bound + e.sign * e.x[0];
    } else {
      l_[e.row + 2] = e.x[0] / e.friction;
    }
  }
  if (l_guess) {
    for (Element& e : elements_) {
      const GrowVector& g = *l_guess;
      if (e.line) {
        const bool interval = problem.sets[e.set].type == SetType::Interval;
        const double room = interval ? problem.sets[e.set].upper - problem.sets[e.set].lower : 1.0;
        const double least = inside_x * std::min(1.0, room);
        double x = std::max(e.sign * (g[e.row] - e.bound), least);
        if (interval) x = std::min(x, std::max(room - least, 0.5 * room));
        e.x[0] = x;
        l_[e.row] = e.bound + e.sign * x;
        e.z[0] = std::max(e.sign * t_[e.row], inside_z);
        continue;
      }
      e.x = {e.friction * g[e.row + 2], g[e.row], g[e.row + 1]};
      const double tx = std::hypot(e.x[1], e.x[2]);
      e.x[0] = std::max(e.x[0], tx) + inside_x;
      e.z = {t_[e.row + 2] / e.friction, t_[e.row], t_[e.row + 1]};
      const double tz = std::hypot(e.z[1], e.z[2]);
      e.z[0] = std::max(e.z[0] + (law == Law::Ncp ? tz : 0.0), tz) + inside_z;
      l_[e.row] = e.x[1], l_[e.row + 1] = e.x[2], l_[e.row + 2] = e.x[0] / e.friction;
    }
    for (Index i = 0; i < problem.sets.num_sets(); ++i) {
      const ConstraintSet& set = problem.sets[i];
      const bool free = set.type == SetType::Equality ||
                        (set.type == SetType::Interval && std::isinf(set.lower) && std::isinf(set.upper));
      if (free) l_[set.offset] = (*l_guess)[set.offset];
    }
  }
  evaluate();
}

void InteriorPoint::evaluate() {
  problem_->system->apply(l_, t_);
  t_ += problem_->b;
  relative_ = natural_residual(*problem_, law_, l_, t_, natural_);
  residual_ = -t_;
  mu_ = 0.0;
  for (const Element& e : elements_) {
    mu_ += dot(e.x, e.z);
    if (e.line) {
      residual_[e.row] += e.sign * e.z[0];
      continue;
    }
    residual_[e.row] += e.z[1];
    residual_[e.row + 1] += e.z[2];
    residual_[e.row + 2] += e.friction * e.z[0];
    if (law_ == Law::Ncp) residual_[e.row + 2] -= e.friction * std::sqrt(e.z[1] * e.z[1] + e.z[2] * e.z[2]);
  }
  if (any_fixed_)
    for (Index i = 0; i < residual_.size(); ++i)
      if (fixed_[static_cast<std::size_t>(i)]) residual_[i] = 0.0;
  mu_ /= std::max<double>(1.0, static_cast<double>(elements_.size()));
}

void InteriorPoint::scalings() {
  for (Element& e : elements_) {
    e.det_x = std::max(determinant(e.x), 1e-300), e.det_z = std::max(determinant(e.z), 1e-300);
    const double dx = std::sqrt(e.det_x), dz = std::sqrt(e.det_z), over_x = 1.0 / dx, over_z = 1.0 / dz;
    const Vector3 xb = times(over_x, e.x), zb = times(over_z, e.z);
    const double factor = 0.5 / std::sqrt(0.5 * (1.0 + dot(xb, zb)));
    e.w = {factor * (xb[0] + zb[0]), factor * (xb[1] - zb[1]), factor * (xb[2] - zb[2])};
    e.share = 1.0 / (1.0 + e.w[0]);
    const double s = dz * over_x;
    e.over_eta = std::sqrt(s), e.eta = dx * over_z * e.over_eta;
    const Vector3 j = reflect(e.w);  // H = (2 Jw w'J - J) / eta^2
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) e.h[r][c] = 2.0 * s * j[r] * j[c] + (r == c ? (r == 0 ? -s : s) : 0.0);
    e.lambda = times(e.over_eta, scale(j, e.share, e.x));
    const double over_speed = 1.0 / std::max(std::sqrt(e.z[1] * e.z[1] + e.z[2] * e.z[2]), 1e-300);
    e.u1 = e.z[1] * over_speed, e.u2 = e.z[2] * over_speed;
  }
}

bool InteriorPoint::factor() {
  const double theta = law_ == Law::Ccp ? 0.0 : theta_;
  for (Eigen::Matrix3d& block : x_) block.setZero();
  for (Index i = 0; i < problem_->sets.num_sets(); ++i)
    if (problem_->sets[i].size() == 1) x_[static_cast<std::size_t>(i)](0, 0) = kEquality;
  for (const Element& e : elements_) {
    Eigen::Matrix3d& block = x_[static_cast<std::size_t>(e.set)];
    if (e.line) {
      const int k = problem_->sets[e.set].type == SetType::FrictionCone ? 2 : 0;
      block(k, k) += e.h[0][0];
      continue;
    }
    const double u1 = theta * e.u1, u2 = theta * e.u2, mu = e.friction;
    double top[3];  // first row of (I - theta E) H
    for (int c = 0; c < 3; ++c) top[c] = e.h[0][c] - u1 * e.h[1][c] - u2 * e.h[2][c];
    block << e.h[1][1], e.h[1][2], mu * e.h[1][0],  //
        e.h[2][1], e.h[2][2], mu * e.h[2][0],       //
        mu * top[1], mu * top[2], mu * mu * top[0];
  }
  ++factorizations_;
  if (!any_fixed_) return problem_->system->factor(x_);
  for (Index i = 0; i < problem_->sets.num_sets(); ++i) {  // a fixed row reads dl = 0
    const ConstraintSet& set = problem_->sets[i];
    Eigen::Matrix3d& y = y_[static_cast<std::size_t>(i)];
    y.setIdentity();
    for (Index k = 0; k < set.size(); ++k) {
      if (!fixed_[static_cast<std::size_t>(set.offset + k)]) continue;
      y(k, k) = 0.0;
      x_[static_cast<std::size_t>(i)](k, k) = 1.0;
    }
  }
  return problem_->system->factor(x_, y_);
}

void InteriorPoint::direction() {
  const double theta = law_ == Law::Ccp ? 0.0 : theta_;
  rhs_ = residual_;
  for (const Element& e : elements_) {
    if (e.line) {
      rhs_[e.row] += e.sign * e.centre[0];
      continue;
    }
    const double along = theta * (e.u1 * e.centre[1] + e.u2 * e.centre[2]);
    rhs_[e.row] += e.centre[1];
    rhs_[e.row + 1] += e.centre[2];
    rhs_[e.row + 2] += e.friction * (e.centre[0] - along);
  }
  problem_->system->solve(rhs_);  // rhs_ is dl from here on
  for (Element& e : elements_) {
    if (e.line) {
      e.dx = {e.sign * rhs_[e.row], 0.0, 0.0};
      e.dz = {e.centre[0] - e.h[0][0] * e.dx[0], 0.0, 0.0};
      continue;
    }
    e.dx = {e.friction * rhs_[e.row + 2], rhs_[e.row], rhs_[e.row + 1]};
    for (int r = 0; r < 3; ++r) e.dz[r] = e.centre[r] - e.h[r][0] * e.dx[0] - e.h[r][1] * e.dx[1] - e.h[r][2] * e.dx[2];
  }
}

double InteriorPoint::longest_step() const {
  double step = std::numeric_limits<double>::infinity();
  for (const Element& e : elements_) {
    if (e.line) {
      if (e.dx[0] < 0.0) step = std::min(step, -e.x[0] / e.dx[0]);
      if (e.dz[0] < 0.0) step = std::min(step, -e.z[0] / e.dz[0]);
    } else {
      step = std::min(step, std::min(step_to_boundary(e.x, e.det_x, e.dx), step_to_boundary(e.z, e.det_z, e.dz)));
    }
  }
  return step;
}

double InteriorPoint::complementarity(double step) const {
  double sum = 0.0;
  for (const Element& e : elements_)
    for (int k = 0; k < 3; ++k) sum += (e.x[k] + step * e.dx[k]) * (e.z[k] + step * e.dz[k]);
  return sum;
}

bool InteriorPoint::step() {
  const NoMalloc guard;
  scalings();
  if (hold_ > 0)
    --hold_;
  else
    theta_ = options.theta;
  if (!factor()) return false;
  // A negative determinant means a branch of the NCP that turns away: hold the De Saxce derivative back (T25).
  while (law_ == Law::Ncp && theta_ > 0.0 && problem_->system->determinant_sign() < 0) {
    ++negatives_;
    if (hold_ == 0) hold_ = hold_length_, hold_length_ *= 2;
    theta_ *= 0.5;
    if (theta_ < 0.1) theta_ = 0.0;
    if (!factor()) return false;
  }

  // Predictor: straight to complementarity 0.
  for (Element& e : elements_) e.centre = times(-1.0, e.z);
  direction();
  const double count = std::max<double>(1.0, static_cast<double>(elements_.size()));
  const double affine = std::min(1.0, longest_step());
  const double ratio = mu_ > 0.0 ? std::max(complementarity(affine) / count / mu_, 0.0) : 0.0;
  const bool late = negatives_ > 0 || iterations_ > kLateIteration;
  const double least = late ? std::max(kLateCentring, options.least_centring) : options.least_centring;
  const double centring = std::max(least, std::min(1.0, ratio * ratio * ratio));

  // Corrector (T21): W c = lambda \ (centring mu e - (W^-1 dx) o (W dz) - lambda o lambda).
  for (Element& e : elements_) {
    const Vector3 sx = times(e.over_eta, scale(reflect(e.w), e.share, e.dx));
    const Vector3 sz = times(e.eta, scale(e.w, e.share, e.dz));
    const Vector3 second = jordan_product(sx, sz), square = jordan_product(e.lambda, e.lambda);
    Vector3 c;
    for (int k = 0; k < 3; ++k) c[k] = -second[k] - square[k];
    c[0] += centring * mu_;
    e.centre = times(e.over_eta, scale(reflect(e.w), e.share, jordan_divide(e.lambda, c)));
  }
  direction();
  step_ = std::min(1.0, kToBoundary * longest_step());
  if (!std::isfinite(step_) || !rhs_.allFinite()) return false;
  for (Element& e : elements_)
    for (int k = 0; k < 3; ++k) e.x[k] += step_ * e.dx[k], e.z[k] += step_ * e.dz[k];
  l_ += step_ * rhs_;
  for (const Element& e : elements_) {
    if (e.line) continue;
    l_[e.row] = e.x[1], l_[e.row + 1] = e.x[2], l_[e.row + 2] = e.x[0] / e.friction;
  }
  ++iterations_;
  evaluate();
  // Slack reset (T24): |z_T| is convex, so the step left z_0 too small; raising it stays in the cone, removes r_0.
  if (law_ == Law::Ncp) {
    bool changed = false;
    for (Element& e : elements_) {
      if (e.line || !(residual_[e.row + 2] < 0.0)) continue;
      e.z[0] -= residual_[e.row + 2] / e.friction;
      residual_[e.row + 2] = 0.0;
      changed = true;
    }
    if (changed) mu_ = complementarity(0.0) / count;
  }
  return std::isfinite(mu_) && !std::isnan(relative_);
}

void solve_interior_point(const ContactProblem& problem, const Settings& settings, InteriorPointWorkspace& w,
                          const Guess* guess, Solution& solution) {
  constexpr int kWarmPatience = 10;  // steps without halving after which a warm start is given up
  w.problem.setup(problem, 0.5 * settings.tolerance);
  InteriorPoint& method = w.method;
  Recorder recorder(problem, settings, solution);
  const double aim = 0.5 * settings.tolerance;
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : 100;
  w.best.setZero(problem.size());
  w.scratch.resize(problem.size());
  double best = natural_residual(w.problem, settings.law, w.best, w.problem.b, w.scratch);  // of no impulse at all
  recorder.record(w.best, w.problem, 0);
  if (guess) w.problem.from_impulse(guess->impulse, w.scratch);
  for (const bool warm : {true, false}) {
    if ((warm && !guess) || best <= aim) continue;
    method.start(w.problem, settings.law, warm ? &w.scratch : nullptr);
    double milestone = method.relative();
    int since = 0;
    while (best > aim && solution.iterations < max_iterations && method.step()) {
      ++solution.iterations;
      if (method.relative() < best) best = method.relative(), w.best = method.impulse();
      recorder.record(method.impulse(), w.problem, solution.factorizations + method.factorizations());
      if (method.relative() <= 0.5 * milestone) milestone = method.relative(), since = 0;
      if (warm && ++since > kWarmPatience) break;
    }
    solution.factorizations += method.factorizations();
  }
  w.problem.to_impulse(w.best, solution.impulse);
  finish(problem, settings, solution.iterations >= max_iterations, solution);
}

}  // namespace signorini
