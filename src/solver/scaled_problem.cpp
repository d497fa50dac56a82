#include "signorini/solver/scaled_problem.hpp"

#include <algorithm>
#include <cmath>

#include "cone_kernels.hpp"

namespace signorini {

void ScaledProblem::take(const ContactProblem& problem, const std::vector<int>* part, double tolerance, bool scaled) {
  share_weight = tolerance / Residual::largest_share(tolerance);
  const Index count = part ? static_cast<Index>(part->size()) : problem.num_sets();
  sets.clear();
  sets.reserve(count);
  for (Index i = 0; i < count; ++i) sets.add(problem.sets()[part ? (*part)[i] : i]);
  for (GrowVector* v : {&scale, &b, &compliance_}) v->resize(sets.size());
  double largest = 0.0;
  for (Index i = 0; i < count; ++i) {
    const Index size = sets[i].size(), to = sets[i].offset, from = problem.sets()[part ? (*part)[i] : i].offset;
    const double factor = scaled ? 1.0 / std::sqrt(problem.scale()[from]) : 1.0;
    for (Index k = 0; k < size; ++k) {
      scale[to + k] = factor;
      b[to + k] = factor * problem.free_velocity()[from + k];
      compliance_[to + k] = problem.compliance()[from + k];
      largest = std::max(largest, std::abs(b[to + k]));
    }
  }
  unit = scaled && largest > 0.0 ? std::max(largest, 1e-200) : 1.0;
  b /= unit;
  reference = 0.0;
  for (Index i = 0; i < count; ++i) {
    const ConstraintSet& set = sets[i];
    reference = std::max(reference, set.size() == 3 ? b.segment<3>(set.offset).norm() : std::abs(b[set.offset]));
    if (set.type != SetType::Interval) continue;
    const double factor = 1.0 / (scale[set.offset] * unit), zero = 0.0;
    sets.set_bounds(i, set.lower * factor, set.upper * factor);
    double imposed;
    project(set, &zero, &imposed);
    reference = std::max(reference, std::abs(imposed));
  }
}

void ScaledProblem::setup(const ContactProblem& problem, double tolerance, bool scaled) {
  take(problem, nullptr, tolerance, scaled);
  problem.delassus().prepare(sets, scale, compliance_, system);
}

void ScaledProblem::setup_part(const ContactProblem& problem, const std::vector<int>& part, double tolerance) {
  take(problem, &part, tolerance, true);
  problem.delassus().prepare_part(problem.sets(), part, sets, scale, compliance_, system);
}

void ScaledProblem::regularize(const ContactProblem& problem, double weight) {
  const Vector compliance = problem.compliance() + weight * scale.cwiseAbs2().cwiseInverse();
  problem.delassus().prepare(problem.sets(), scale, compliance, system);
}

double natural_residual(const ScaledProblem& problem, Law law, const ConstVectorRef& l, const ConstVectorRef& t,
                        VectorRef natural) {
  double error = 0.0, largest = problem.reference, cone_error = 0.0, largest_cone = 0.0;  // the latter two squared
  if (3 * problem.sets.num_contacts() == problem.sets.size() && problem.sets.num_contacts() >= 8) {
    static_assert(sizeof(ConstraintSet) % sizeof(double) == 0);
    constexpr int stride = static_cast<int>(sizeof(ConstraintSet) / sizeof(double));
    cone_error = cone_kernels().natural_map(static_cast<int>(problem.sets.num_contacts()), &problem.sets[0].friction,
                                            stride, law == Law::Ncp, l.data(), t.data(), natural.data(), largest_cone);
  } else
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
        if (!(e <= cone_error)) cone_error = std::isnan(cone_error) ? cone_error : e;
        if (m > largest_cone) largest_cone = m;
      } else {
        double p = l[o] - t[o];
        project(set, &p, &p);
        natural[o] = l[o] - p;
        const double e = std::abs(natural[o]);
        if (!(e <= error)) error = std::isnan(error) ? error : e;
        if (std::abs(l[o]) > largest) largest = std::abs(l[o]);
      }
    }
  const double e = std::sqrt(cone_error);
  if (!(e <= error)) error = std::isnan(error) ? error : e;
  largest = std::max(largest, std::sqrt(largest_cone));
  if (!(largest > 0.0)) return error;
  const double relative = error / largest;
  const double share = problem.reference > 0.0 ? problem.share_weight * error / problem.reference : 0.0;
  return share > relative ? share : relative;  // NaN stays
}

}  // namespace signorini
