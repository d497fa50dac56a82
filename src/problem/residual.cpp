#include "signorini/problem/residual.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "signorini/problem/de_saxce.hpp"

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

double norm(const double* x, Index n) { return n == 3 ? std::hypot(std::hypot(x[0], x[1]), x[2]) : std::abs(x[0]); }

}  // namespace

Residual residual(const ContactProblem& problem, const ConstVectorRef& impulse, Law law, VectorRef sigma,
                  VectorRef scratch) {
  problem.velocity(impulse, sigma);
  VectorRef& s = scratch;
  s = sigma;
  add_de_saxce_correction(problem.sets(), law, s);

  Residual r;
  double error = 0.0, largest = 0.0, free = 0.0;
  for (const ConstraintSet& set : problem.sets()) {
    const Index o = set.offset, n = set.size();
    const double* x = impulse.data() + o;
    const double* v = s.data() + o;
    double p[3], e[3];

    project(set, x, p);
    for (Index k = 0; k < n; ++k) e[k] = x[k] - p[k];
    raise(r.primal, norm(e, n));

    const double minus[3] = {-v[0], n == 3 ? -v[1] : 0.0, n == 3 ? -v[2] : 0.0};
    switch (set.type) {
      case SetType::FrictionCone: {
        project_friction_cone(set.friction, minus, p);  // dist(s, K*) = |P_K(-s)|
        raise(r.dual, norm(p, 3));
        raise(r.complementarity, std::abs(x[0] * v[0] + x[1] * v[1] + x[2] * v[2]));
        const double* w = sigma.data() + o;
        raise(r.signorini, w[2] < 0.0 ? -w[2] : 0.0 * w[2]);
        raise(r.signorini, x[2] < 0.0 ? -x[2] : 0.0 * x[2]);
        raise(r.dissipation, std::abs(x[0] * w[0] + x[1] * w[1] + set.friction * x[2] * std::hypot(w[0], w[1])));
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

    // relative, in the scaled variables l = sqrt(d) impulse, t = s / sqrt(d) (T11, T12)
    const double root = std::sqrt(problem.scale()[o]);
    double l[3], t[3];
    for (Index k = 0; k < n; ++k) l[k] = root * x[k], t[k] = v[k] / root;
    ConstraintSet scaled = set;
    scaled.lower *= root, scaled.upper *= root;
    natural_map(scaled, l, t, e);
    raise(error, norm(e, n));
    raise(largest, norm(l, n));
    raise(free, norm(problem.free_velocity().data() + o, n) / root);
    const double zero[3] = {0.0, 0.0, 0.0};
    project(scaled, zero, p);
    raise(free, norm(p, n));  // impulses that an interval imposes
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
  Vector sigma(problem.size()), scratch(problem.size());
  const Residual r = residual(problem, impulse, law, sigma, scratch);
  if (velocity) *velocity = std::move(sigma);
  return r;
}

}  // namespace signorini
