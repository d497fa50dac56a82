// Letters in this file: l, t  scaled impulse and its velocity A l + b;  x, u  those of one contact while it is visited.
#include "signorini/solver/block_sweeps.hpp"

#include <algorithm>
#include <cmath>

#include "no_malloc.hpp"

namespace signorini {
namespace {

constexpr double kDecoupled = 1e-12;  // of the normal entry: what counts as none between rows

double inverse_or_zero(double x) { return x > 0.0 ? 1.0 / x : 0.0; }

}  // namespace

SweptSet::SweptSet(const ConstraintSet& set, const Eigen::Matrix3d& of_set) : block(of_set) {
  if (set.size() == 1) {
    normal = inverse_or_zero(block(0, 0));
    return;
  }
  normal = inverse_or_zero(block(2, 2));
  const double mean = 0.5 * (block(0, 0) + block(1, 1)), half = 0.5 * (block(0, 0) - block(1, 1));
  tangent = inverse_or_zero(mean + std::sqrt(half * half + block(0, 1) * block(0, 1)));
}

void SweptSet::take_one_step_if_exact() {
  const double coupling = std::max(
      {std::abs(block(0, 1)), std::abs(block(0, 2)), std::abs(block(1, 2)), std::abs(block(0, 0) - block(1, 1))});
  if (coupling <= kDecoupled * block(2, 2)) steps = 1;
}

bool visit_set(const ConstraintSet& set, const SweptSet& s, double* l, const double* t, double* change, bool& slips) {
  slips = false;
  if (set.type != SetType::FrictionCone) {
    double x = *l - s.normal * *t;
    project(set, &x, &x);
    *change = x - *l;
    *l = x;
    return *change != 0.0;
  }
  if (l[0] == 0.0 && l[1] == 0.0 && l[2] == 0.0 && t[2] >= 0.0) return false;  // stays open
  const Eigen::Matrix3d& a = s.block;
  double x[3] = {l[0], l[1], l[2]}, u[3] = {t[0], t[1], t[2]};
  for (int step = 0; step < s.steps; ++step) {
    double normal = x[2] - s.normal * u[2];
    if (normal < 0.0) normal = 0.0;
    const double rise = normal - x[2];
    x[2] = normal;
    u[0] += a(0, 2) * rise, u[1] += a(1, 2) * rise;
    double x0 = x[0] - s.tangent * u[0], x1 = x[1] - s.tangent * u[1];
    const double square = x0 * x0 + x1 * x1, radius = set.friction * normal;
    slips = radius > 0.0 && square > radius * radius;
    if (square > radius * radius) {
      const double shrink = radius / std::sqrt(square);
      x0 *= shrink, x1 *= shrink;
    }
    const double d0 = x0 - x[0], d1 = x1 - x[1];
    x[0] = x0, x[1] = x1;
    u[0] += a(0, 0) * d0 + a(0, 1) * d1;
    u[1] += a(1, 0) * d0 + a(1, 1) * d1;
    u[2] += a(2, 0) * d0 + a(2, 1) * d1 + a(2, 2) * rise;
  }
  for (int k = 0; k < 3; ++k) change[k] = x[k] - l[k], l[k] = x[k];
  return change[0] != 0.0 || change[1] != 0.0 || change[2] != 0.0;
}

void BlockSweeps::start(const ScaledProblem& problem, const GrowVector* start, double weight,
                        const GrowVector* centre) {
  weight_ = weight;
  const Index num_sets = problem.sets.num_sets();
  sets_.resize(static_cast<std::size_t>(num_sets));
  for (Index i = 0; i < num_sets; ++i) {
    Eigen::Matrix3d block = problem.system->diagonal_block(i);
    block.diagonal().array() += weight;
    sets_[static_cast<std::size_t>(i)] = SweptSet(problem.sets[i], block);
  }
  natural_.resize(problem.size());
  if (start) {
    l_.resize(problem.size()), t_.resize(problem.size());
    problem.sets.project(*start, l_);
    problem.system->apply(l_, t_);
    t_ += problem.b;
    if (centre) t_ += weight * (l_ - *centre);
  } else {
    l_.setZero(problem.size());
    t_ = problem.b;
    if (centre) t_ -= weight * *centre;
  }
}

double BlockSweeps::relative(const ScaledProblem& problem) {
  return natural_residual(problem, Law::Ncp, l_, t_, natural_);
}

void BlockSweeps::sweep(const ScaledProblem& problem) {
  const NoMalloc guard;
  slipping_ = pressing_ = 0;
  for (Index i = 0; i < problem.sets.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets[i];
    double* l = l_.data() + set.offset;
    double change[3];
    bool slips;
    const bool moved = visit_set(set, sets_[static_cast<std::size_t>(i)], l, t_.data() + set.offset, change, slips);
    slipping_ += slips, pressing_ += set.type == SetType::FrictionCone && l[2] > 0.0;
    if (!moved) continue;
    for (Index k = 0; k < set.size(); ++k) t_[set.offset + k] += weight_ * change[k];
    problem.system->add_columns(i, change, t_.data());
  }
}

}  // namespace signorini
