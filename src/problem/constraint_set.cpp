#include "signorini/problem/constraint_set.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "length.hpp"
#include "require.hpp"

namespace signorini {
namespace {

void check_friction(double friction, Index contact) {
  if (!(friction >= 0.0 && friction <= 1e6))
    require(false, "friction[" + std::to_string(contact) + "]", friction, "in [0, 1e6]");
}

void check_interval(double lower, double upper, Index i) {
  if (!(lower <= upper) || lower > 1e100 || upper < -1e100)
    throw InvalidInput("constraints[" + std::to_string(i) + "]",
                       "is the interval [" + in_full(lower) + ", " + in_full(upper) +
                           "], must have lower <= upper and hold an impulse within +-1e100");
}

}  // namespace

void project_friction_cone(double friction, const double* x, double* out) {
  const double t = length(x[0], x[1]), n = x[2];
  if (friction * t <= -n) {  // the polar cone; first, since it is the right answer on the ray friction = 0 too
    out[0] = out[1] = out[2] = 0.0;
  } else if (t <= friction * n) {
    out[0] = x[0], out[1] = x[1], out[2] = n;
  } else {
    const double normal = (n + friction * t) / (1.0 + friction * friction);
    const double factor = t > 0.0 ? friction * normal / t : 0.0;
    out[0] = factor * x[0], out[1] = factor * x[1], out[2] = normal;
  }
}

void project(const ConstraintSet& set, const double* x, double* out) {
  switch (set.type) {
    case SetType::FrictionCone:
      project_friction_cone(set.friction, x, out);
      break;
    case SetType::HalfLine:
      out[0] = x[0] < 0.0 ? 0.0 : x[0];  // keeps NaN
      break;
    case SetType::Interval:
      out[0] = x[0] < set.lower ? set.lower : (x[0] > set.upper ? set.upper : x[0]);
      break;
    case SetType::Equality:
      out[0] = x[0];
      break;
  }
}

void ConstraintSets::validate() const {
  Index contact = 0;
  for (std::size_t i = 0; i < sets_.size(); ++i) {
    const ConstraintSet& set = sets_[i];
    if (set.type == SetType::FrictionCone) check_friction(set.friction, contact++);
    if (set.type == SetType::Interval) check_interval(set.lower, set.upper, static_cast<Index>(i));
  }
}

ConstraintSets ConstraintSets::friction_cones(const ConstVectorRef& friction) {
  ConstraintSets sets;
  sets.sets_.reserve(static_cast<std::size_t>(friction.size()));
  for (Index i = 0; i < friction.size(); ++i) sets.add_friction_cone(friction[i]);
  return sets;
}

void ConstraintSets::add(ConstraintSet set) {
  set.offset = size_;
  size_ += set.size();
  if (set.type == SetType::FrictionCone) ++num_contacts_;
  sets_.push_back(set);
}

void ConstraintSets::set_bounds(Index i, double lower, double upper) {
  sets_[static_cast<std::size_t>(i)].lower = lower;
  sets_[static_cast<std::size_t>(i)].upper = upper;
}

void ConstraintSets::set_friction(Index i, double friction) { sets_[static_cast<std::size_t>(i)].friction = friction; }

void ConstraintSets::clear() {
  sets_.clear();
  size_ = num_contacts_ = 0;
}

void ConstraintSets::add_friction_cone(double friction) {
  check_friction(friction, num_contacts_);
  ConstraintSet set;
  set.friction = friction;
  add(set);
}

void ConstraintSets::add_half_line() {
  ConstraintSet set;
  set.type = SetType::HalfLine;
  add(set);
}

void ConstraintSets::add_interval(double lower, double upper) {
  check_interval(lower, upper, num_sets());
  ConstraintSet set;
  set.type = SetType::Interval;
  set.lower = lower;
  set.upper = upper;
  add(set);
}

void ConstraintSets::add_equality(Index count) {
  if (count < 0) throw InvalidInput("count", "is " + std::to_string(count) + ", must be >= 0");
  ConstraintSet set;
  set.type = SetType::Equality;
  for (Index i = 0; i < count; ++i) add(set);
}

void ConstraintSets::project(const ConstVectorRef& x, VectorRef out) const {
  require_size("x", x.size(), size_);
  require_size("out", out.size(), size_);
  for (const ConstraintSet& set : sets_) signorini::project(set, x.data() + set.offset, out.data() + set.offset);
}

void ConstraintSets::project_dual(const ConstVectorRef& x, VectorRef out) const {
  require_size("x", x.size(), size_);
  require_size("out", out.size(), size_);
  for (const ConstraintSet& set : sets_) {
    const double* v = x.data() + set.offset;
    double* o = out.data() + set.offset;
    switch (set.type) {
      case SetType::FrictionCone: {  // Moreau: x = P_K*(x) - P_K(-x)
        const double minus[3] = {-v[0], -v[1], -v[2]};
        double p[3];
        project_friction_cone(set.friction, minus, p);
        for (int k = 0; k < 3; ++k) o[k] = v[k] + p[k];
        break;
      }
      case SetType::HalfLine:
        o[0] = v[0] < 0.0 ? 0.0 : v[0];
        break;
      case SetType::Interval:
        o[0] = v[0];
        break;
      case SetType::Equality:
        o[0] = 0.0 * v[0];  // keeps NaN
        break;
    }
  }
}

}  // namespace signorini
