#include "signorini/problem/residual.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "length.hpp"

namespace signorini {
namespace {

/// Maximum that keeps a NaN, unlike std::max.
void raise(double& maximum, double value) {
  if (!(value <= maximum)) maximum = std::isnan(maximum) ? maximum : value;
}

/// e = l - P_K(l - t), for impulses that dwarf the velocity too: where l - t is l but for rounding, e is still t.
void natural_map(const ConstraintSet& set, const double* l, const double* t, double* e) {
  switch (set.type) {
    case SetType::FrictionCone: {
      double a[3], p[3];
      for (Index k = 0; k < 3; ++k) a[k] = l[k] - t[k];
      project(set, a, p);
      const bool sticks = p[0] == a[0] && p[1] == a[1] && p[2] == a[2];
      for (Index k = 0; k < 3; ++k)
        e[k] = sticks ? t[k] : std::abs(t[k]) < std::abs(l[k]) ? t[k] - (p[k] - a[k]) : l[k] - p[k];
      break;
    }
    case SetType::HalfLine:
      e[0] = std::min(l[0], t[0]);
      break;
    case SetType::Interval:
      e[0] = std::min(std::max(t[0], l[0] - set.upper), l[0] - set.lower);
      break;
    case SetType::Equality:
      e[0] = t[0];
      break;
  }
}

/// v: sigma + Gamma(sigma) of the set.
RelativePart relative_part(const ContactProblem& problem, const ConstraintSet& set, const double* x, const double* v) {
  const Index o = set.offset, n = set.size();
  const double root = std::sqrt(problem.scale()[o]);
  double l[3] = {0.0, 0.0, 0.0}, t[3] = {0.0, 0.0, 0.0}, e[3] = {0.0, 0.0, 0.0};
  for (Index k = 0; k < n; ++k) l[k] = root * x[k], t[k] = v[k] / root;
  ConstraintSet scaled = set;
  scaled.lower *= root, scaled.upper *= root;
  natural_map(scaled, l, t, e);
  RelativePart part{length(e, n), length(l, n), length(problem.free_velocity().data() + o, n) / root};
  if (set.type == SetType::Interval) {
    const double zero[3] = {};
    double imposed[3];
    project(scaled, zero, imposed);
    part.free = std::max(part.free, std::abs(imposed[0]));
  }
  return part;
}

/// v = sigma + Gamma(sigma) of one set, whose rows w points at; returns |sigma_T|.
double add_correction(const ConstraintSet& set, Law law, const double* w, double* v) {
  v[0] = w[0];
  if (set.type != SetType::FrictionCone) return 0.0;
  const double speed = length(w[0], w[1]);
  v[1] = w[1], v[2] = w[2] + (law == Law::Ncp ? set.friction * speed : 0.0);
  return speed;
}

}  // namespace

RelativePart relative_part(const ContactProblem& problem, Index i, const ConstVectorRef& impulse,
                           const ConstVectorRef& velocity, Law law) {
  const ConstraintSet& set = problem.sets()[i];
  double v[3];
  add_correction(set, law, velocity.data() + set.offset, v);
  return relative_part(problem, set, impulse.data() + set.offset, v);
}

Residual residual(const ContactProblem& problem, const ConstVectorRef& impulse, Law law, VectorRef sigma) {
  problem.velocity(impulse, sigma);
  Residual r;
  double error = 0.0, largest = 0.0, free = problem.reference();
  for (const ConstraintSet& set : problem.sets()) {
    const Index o = set.offset, n = set.size();
    const double* x = impulse.data() + o;
    const double* w = sigma.data() + o;
    double v[3], p[3], e[3];
    const double speed = add_correction(set, law, w, v);

    project(set, x, p);
    for (Index k = 0; k < n; ++k) e[k] = x[k] - p[k];
    raise(r.primal, length(e, n));

    switch (set.type) {
      case SetType::FrictionCone: {
        const double minus[3] = {-v[0], -v[1], -v[2]};
        project_friction_cone(set.friction, minus, p);  // dist(s, K*) = |P_K(-s)|
        raise(r.dual, length(p, 3));
        raise(r.complementarity, std::abs(x[0] * v[0] + x[1] * v[1] + x[2] * v[2]));
        raise(r.signorini, w[2] < 0.0 ? -w[2] : 0.0 * w[2]);
        raise(r.signorini, x[2] < 0.0 ? -x[2] : 0.0 * x[2]);
        raise(r.dissipation, std::abs(x[0] * w[0] + x[1] * w[1] + set.friction * x[2] * speed));
        break;
      }
      case SetType::HalfLine:
        raise(r.dual, v[0] < 0.0 ? -v[0] : 0.0);
        raise(r.complementarity, std::abs(x[0] * v[0]));
        break;
      case SetType::Interval: {
        const double distance = v[0] > 0.0 ? x[0] - set.lower : set.upper - x[0];
        if (std::isinf(distance))  // no bound on that side that could answer for v
          raise(r.dual, std::abs(v[0]));
        else
          raise(r.complementarity, std::abs(distance * v[0]));
        break;
      }
      case SetType::Equality:
        raise(r.dual, std::abs(v[0]));
        break;
    }

    const RelativePart part = relative_part(problem, set, x, v);
    raise(error, part.error);
    raise(largest, part.size);
    raise(free, part.free);
  }
  raise(largest, free);
  r.relative = largest > 0.0 ? error / largest : error;
  r.against_free_velocity = error == 0.0 ? 0.0 : error / free;  // infinite when nothing asked for an impulse
  if (std::isnan(r.relative) || !sigma.allFinite() || !impulse.allFinite()) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    r = {nan, nan, nan, nan, nan, nan, nan};
  }
  return r;
}

Residual residual(const ContactProblem& problem, const ConstVectorRef& impulse, Law law, Vector* velocity) {
  Vector sigma(problem.size());
  const Residual r = residual(problem, impulse, law, sigma);
  if (velocity) *velocity = std::move(sigma);
  return r;
}

}  // namespace signorini
