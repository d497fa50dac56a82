#include "signorini/solver/scaled_problem.hpp"

#include <algorithm>
#include <cmath>

#include "signorini/problem/de_saxce.hpp"

namespace signorini {

void ScaledProblem::setup(const ContactProblem& problem, double tolerance, bool scaled) {
  share_weight = tolerance / (0.5 * Residual::kLargestShare);
  const Index n = problem.size();
  scale = scaled ? Vector(problem.scale().cwiseSqrt().cwiseInverse()) : Vector::Ones(n);
  b = scale.cwiseProduct(problem.free_velocity());
  unit = 1.0;
  if (scaled && n > 0) {
    const double largest = b.cwiseAbs().maxCoeff();
    if (largest > 0.0) unit = std::max(largest, 1e-200);
    b /= unit;
  }
  reference = 0.0;
  sets = ConstraintSets();
  for (const ConstraintSet& set : problem.sets()) {
    reference = std::max(reference, b.segment(set.offset, set.size()).norm());
    ConstraintSet scaled_set = set;
    const double factor = 1.0 / (scale[set.offset] * unit);
    scaled_set.lower *= factor, scaled_set.upper *= factor;
    if (set.type == SetType::Interval) {
      const double zero = 0.0;
      double imposed;
      project(scaled_set, &zero, &imposed);
      reference = std::max(reference, std::abs(imposed));
    }
    sets.add(scaled_set);
  }
  problem.delassus().prepare(problem.sets(), scale, problem.compliance(), system);
}

void ScaledProblem::regularize(const ContactProblem& problem, double weight) {
  const Vector compliance = problem.compliance() + weight * scale.cwiseAbs2().cwiseInverse();
  problem.delassus().prepare(problem.sets(), scale, compliance, system);
}

double natural_residual(const ScaledProblem& problem, Law law, const ConstVectorRef& l, const ConstVectorRef& t,
                        VectorRef natural) {
  double error = 0.0, largest = problem.reference;
  for (const ConstraintSet& set : problem.sets) {
    const Index o = set.offset;
    if (set.type == SetType::FrictionCone) {
      double shifted[3] = {l[o] - t[o], l[o + 1] - t[o + 1], l[o + 2] - t[o + 2]};
      if (law == Law::Ncp) shifted[2] -= set.friction * std::sqrt(t[o] * t[o] + t[o + 1] * t[o + 1]);
      project_friction_cone(set.friction, shifted, shifted);
      double e = 0.0, m = 0.0;
      for (Index k = 0; k < 3; ++k) {
        const double v = natural[o + k] = l[o + k] - shifted[k];
        e += v * v, m += l[o + k] * l[o + k];
      }
      e = std::sqrt(e), m = std::sqrt(m);
      if (!(e <= error)) error = std::isnan(error) ? error : e;
      if (m > largest) largest = m;
    } else {
      double p = l[o] - t[o];
      project(set, &p, &p);
      natural[o] = l[o] - p;
      const double e = std::abs(natural[o]);
      if (!(e <= error)) error = std::isnan(error) ? error : e;
      if (std::abs(l[o]) > largest) largest = std::abs(l[o]);
    }
  }
  if (!(largest > 0.0)) return error;
  const double relative = error / largest;
  const double share = problem.reference > 0.0 ? problem.share_weight * error / problem.reference : 0.0;
  return share > relative ? share : relative;  // NaN stays
}

}  // namespace signorini
