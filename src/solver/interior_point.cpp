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

#include "cone_kernels.hpp"
#include "finish.hpp"
#include "no_malloc.hpp"

namespace signorini {
namespace {

constexpr double kToBoundary = 0.99;
constexpr double kRough = 1e-5;  // certificate above which a few digits do not matter
constexpr double kLateCentring = 0.1;
constexpr int kLateIteration = 20;   // iterations after which centring is never less than kLateCentring
constexpr int kHold = 8;             // iterations that a reduced theta is held, doubled at each recurrence
constexpr double kEquality = 1e-10;  // keeps redundant one-row sets factorable
// The weight of the proximal term: how it rises, and falls from step to step; where there is none any more, and where
// it rises no more.
constexpr double kWeightRise = 4.0, kWeightFall = 0.7, kLeastWeight = 1e-9, kMostWeight = 10.0;
// How far inside the cones it starts from a guess: at least, and of the velocity over the largest error.
constexpr double kInside = 1e-3, kInsideVelocity = 0.3;

void put(ConeBlock::Row (&rows)[3], std::size_t k, double a0, double a1, double a2) {
  rows[0][k] = a0, rows[1][k] = a1, rows[2][k] = a2;
}

}  // namespace

void InteriorPoint::start(ScaledProblem& problem, Law law, const GrowVector* l_guess) {
  const Index n = problem.size();
  problem_ = &problem;
  law_ = law;
  elements_.clear();
  elements_.reserve(static_cast<std::size_t>(problem.sets.num_sets()));
  fixed_.assign(static_cast<std::size_t>(n), 0);
  any_fixed_ = false;
  for (GrowVector* v : {&l_, &t_, &natural_, &residual_, &rhs_}) v->setZero(n);
  x_.resize(static_cast<std::size_t>(problem.sets.num_sets()));
  iterations_ = factorizations_ = negatives_ = hold_ = 0;
  hold_length_ = kHold;
  step_ = 1.0;
  theta_ = options.theta;
  weight_ = 0.0;

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

  if (any_fixed_) y_.resize(x_.size());
  arrange_cones();
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
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    put(cones.x, k, options.start_scale, 0.0, 0.0);
    put(cones.z, k, dual, 0.0, 0.0);
    if (e.line) {
      if (problem.sets[e.set].type == SetType::Interval) cones.x[0][k] = e.sign * (l_[e.row] - e.bound);
      l_[e.row] = e.bound + e.sign * cones.x[0][k];
    } else {
      l_[e.row + 2] = cones.x[0][k] / e.friction;
    }
  }
  if (l_guess) {
    for (std::size_t i = 0; i < elements_.size(); ++i) {
      const Element& e = elements_[i];
      ConeBlock& cones = block_of(i);
      const std::size_t k = i % ConeBlock::kWidth;
      const GrowVector& g = *l_guess;
      if (e.line) {
        const bool interval = problem.sets[e.set].type == SetType::Interval;
        const double room = interval ? problem.sets[e.set].upper - problem.sets[e.set].lower : 1.0;
        const double least = inside_x * std::min(1.0, room);
        double x = std::max(e.sign * (g[e.row] - e.bound), least);
        if (interval) x = std::min(x, std::max(room - least, 0.5 * room));
        cones.x[0][k] = x;
        l_[e.row] = e.bound + e.sign * x;
        cones.z[0][k] = std::max(e.sign * t_[e.row], inside_z);
        continue;
      }
      const double x1 = g[e.row], x2 = g[e.row + 1], tx = std::hypot(x1, x2);
      const double x0 = std::max(e.friction * g[e.row + 2], tx) + inside_x;
      put(cones.x, k, x0, x1, x2);
      const double z1 = t_[e.row], z2 = t_[e.row + 1], tz = std::hypot(z1, z2);
      const double normal = t_[e.row + 2] / e.friction + (law == Law::Ncp ? tz : 0.0);
      put(cones.z, k, std::max(normal, tz) + inside_z, z1, z2);
      l_[e.row] = x1, l_[e.row + 1] = x2, l_[e.row + 2] = x0 / e.friction;
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

void InteriorPoint::arrange_cones() {
  constexpr std::size_t width = ConeBlock::kWidth;
  cones_.assign((elements_.size() + width - 1) / width, ConeBlock());
  for (std::size_t i = 0; i < cones_.size() * width; ++i) {
    ConeBlock& cones = block_of(i);
    cones.x[0][i % width] = cones.z[0][i % width] = 1.0;
    cones.weight[i % width] = i < elements_.size() ? 1.0 : 0.0;
  }
}

void InteriorPoint::evaluate() {
  problem_->system->apply(l_, t_);
  t_ += problem_->b;
  relative_ = natural_residual(*problem_, law_, l_, t_, natural_);
  residual_ = -t_;
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    const ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    if (e.line) {
      residual_[e.row] += e.sign * cones.z[0][k];
      continue;
    }
    const double z1 = cones.z[1][k], z2 = cones.z[2][k];
    residual_[e.row] += z1;
    residual_[e.row + 1] += z2;
    residual_[e.row + 2] += e.friction * cones.z[0][k];
    if (law_ == Law::Ncp) residual_[e.row + 2] -= e.friction * std::sqrt(z1 * z1 + z2 * z2);
  }
  if (any_fixed_)
    for (Index i = 0; i < residual_.size(); ++i)
      if (fixed_[static_cast<std::size_t>(i)]) residual_[i] = 0.0;
  mu_ = complementarity(0.0) / std::max<double>(1.0, static_cast<double>(elements_.size()));
}

bool InteriorPoint::settled() const {
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    const ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    const double x0 = cones.x[0][k], z0 = cones.z[0][k];
    if (e.line) {
      if ((x0 > z0) != (x0 > e.sign * t_[e.row])) return false;
      continue;
    }
    const double x1 = cones.x[1][k], x2 = cones.x[2][k], z1 = cones.z[1][k], z2 = cones.z[2][k];
    const double xt = std::sqrt(x1 * x1 + x2 * x2), zt = std::sqrt(z1 * z1 + z2 * z2);
    const bool open = x0 + xt < z0 - zt, sticks = z0 + zt < x0 - xt;
    const double a0 = l_[e.row] - t_[e.row], a1 = l_[e.row + 1] - t_[e.row + 1], a2 = l_[e.row + 2] - t_[e.row + 2];
    if (open != (a2 <= 0.0) || sticks != (a2 > 0.0 && std::sqrt(a0 * a0 + a1 * a1) <= e.friction * a2)) return false;
  }
  return true;
}

bool InteriorPoint::factor() {
  const double theta = law_ == Law::Ccp ? 0.0 : theta_;
  for (Eigen::Matrix3d& block : x_) block.setZero();
  for (Index i = 0; i < problem_->sets.num_sets(); ++i)
    if (problem_->sets[i].size() == 1) x_[static_cast<std::size_t>(i)](0, 0) = kEquality;
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    const ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    Eigen::Matrix3d& block = x_[static_cast<std::size_t>(e.set)];
    const double h00 = cones.h[0][k];
    if (e.line) {
      const int row = problem_->sets[e.set].type == SetType::FrictionCone ? 2 : 0;
      block(row, row) += h00;
      continue;
    }
    const double h01 = cones.h[1][k], h02 = cones.h[2][k], h11 = cones.h[3][k], h12 = cones.h[4][k],
                 h22 = cones.h[5][k];
    const double u1 = theta * cones.u[0][k], u2 = theta * cones.u[1][k], mu = e.friction;
    // Normal last; its row is that of (I - theta E) H.
    block << h11, h12, mu * h01,  //
        h12, h22, mu * h02,       //
        mu * (h01 - u1 * h11 - u2 * h12), mu * (h02 - u1 * h12 - u2 * h22), mu * mu * (h00 - u1 * h01 - u2 * h02);
    if (weight_ > 0.0) {  // nearly none where the contact sticks, all of it where it slips or opens (T25)
      const double x = cones.x[0][k] - std::hypot(cones.x[1][k], cones.x[2][k]);
      const double z = cones.z[0][k] + std::hypot(cones.z[1][k], cones.z[2][k]);
      block.diagonal().array() += weight_ * z / (x + z);
    }
  }
  ++factorizations_;
  if (!any_fixed_) return problem_->system->factor(x_, relative_ > kRough);
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
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    const ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    const double c0 = cones.centre[0][k], c1 = cones.centre[1][k], c2 = cones.centre[2][k];
    if (e.line) {
      rhs_[e.row] += e.sign * c0;
      continue;
    }
    rhs_[e.row] += c1;
    rhs_[e.row + 1] += c2;
    rhs_[e.row + 2] += e.friction * (c0 - theta * (cones.u[0][k] * c1 + cones.u[1][k] * c2));
  }
  problem_->system->solve(rhs_);  // rhs_ is dl from here on
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    if (e.line)
      cones.dx[0][k] = e.sign * rhs_[e.row];
    else
      put(cones.dx, k, e.friction * rhs_[e.row + 2], rhs_[e.row], rhs_[e.row + 1]);
  }
  cone_kernels().dual_direction(static_cast<int>(cones_.size()), cones_.data());
}

double InteriorPoint::complementarity(double step) const {
  return cone_kernels().complementarity(static_cast<int>(cones_.size()), cones_.data(), step);
}

bool InteriorPoint::turns_away() {
  if (law_ == Law::Ccp || problem_->system->determinant_sign() >= 0) return false;
  ++negatives_;
  return true;
}

bool InteriorPoint::step() {
  const NoMalloc guard;
  const ConeKernels& kernels = cone_kernels();
  const auto num_blocks = static_cast<int>(cones_.size());
  kernels.scalings(num_blocks, cones_.data());
  if (hold_ > 0)
    --hold_;
  else
    theta_ = options.theta;
  weight_ = weight_ > kLeastWeight ? kWeightFall * weight_ : 0.0;
  if (!factor()) return false;
  // A negative determinant means a branch of the NCP that turns away: hold the impulse near where it is, or the
  // De Saxce derivative back (T25).
  while (options.weight > 0.0 && weight_ < kMostWeight && turns_away()) {
    weight_ = std::max(kWeightRise * weight_, options.weight);
    if (!factor()) return false;
  }
  while (options.weight == 0.0 && theta_ > 0.0 && turns_away()) {
    if (hold_ == 0) hold_ = hold_length_, hold_length_ *= 2;
    theta_ *= 0.5;
    if (theta_ < 0.1) theta_ = 0.0;
    if (!factor()) return false;
  }

  // Predictor: straight to complementarity 0.
  for (ConeBlock& cones : cones_)
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < ConeBlock::kWidth; ++k) cones.centre[r][k] = -cones.z[r][k];
  direction();
  const double count = std::max<double>(1.0, static_cast<double>(elements_.size()));
  const double affine = std::min(1.0, kernels.longest_step(num_blocks, cones_.data()));
  const double ratio = mu_ > 0.0 ? std::max(complementarity(affine) / count / mu_, 0.0) : 0.0;
  const bool late = negatives_ > 0 || iterations_ > kLateIteration;
  const double least = late ? std::max(kLateCentring, options.least_centring) : options.least_centring;
  const double centring = std::max(least, std::min(1.0, ratio * ratio * ratio));

  // Corrector (T21): W c = lambda \ (centring mu e - (W^-1 dx) o (W dz) - lambda o lambda).
  kernels.corrector(num_blocks, cones_.data(), centring * mu_);
  direction();
  step_ = std::min(1.0, kToBoundary * kernels.longest_step(num_blocks, cones_.data()));
  if (!std::isfinite(step_) || !rhs_.allFinite()) return false;
  for (ConeBlock& cones : cones_)
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < ConeBlock::kWidth; ++k)
        cones.x[r][k] += step_ * cones.dx[r][k], cones.z[r][k] += step_ * cones.dz[r][k];
  l_ += step_ * rhs_;
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    const Element& e = elements_[i];
    if (e.line) continue;
    const ConeBlock& cones = block_of(i);
    const std::size_t k = i % ConeBlock::kWidth;
    l_[e.row] = cones.x[1][k], l_[e.row + 1] = cones.x[2][k], l_[e.row + 2] = cones.x[0][k] / e.friction;
  }
  ++iterations_;
  evaluate();
  // Slack reset (T24): |z_T| is convex, so the step left z_0 too small; raising it stays in the cone, removes r_0.
  if (law_ == Law::Ncp) {
    bool changed = false;
    for (std::size_t i = 0; i < elements_.size(); ++i) {
      const Element& e = elements_[i];
      if (e.line || !(residual_[e.row + 2] < 0.0)) continue;
      block_of(i).z[0][i % ConeBlock::kWidth] -= residual_[e.row + 2] / e.friction;
      residual_[e.row + 2] = 0.0;
      changed = true;
    }
    if (changed) mu_ = complementarity(0.0) / count;
  }
  return std::isfinite(mu_) && !std::isnan(relative_);
}

void solve_interior_point(const ContactProblem& problem, const Settings& settings, InteriorPointWorkspace& w,
                          const Guess* guess, Solution& solution) {
  constexpr int kGiveUpAfter = 10;  // steps without halving after which a warm start is given up
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
      if (warm && ++since > kGiveUpAfter) break;
    }
    solution.factorizations += method.factorizations();
  }
  w.problem.to_impulse(w.best, solution.impulse);
  finish(problem, settings, solution.iterations >= max_iterations, solution);
}

}  // namespace signorini
