// Algorithm 2 of Carpentier et al. 2024 (section IV), with the correction of each proximal step in closed form: R has
// no coupling between contacts, so that s = Gamma(sigma) needs not be that of the iterate before (docs/theory.md,
// section 13).
#include "signorini/solver/inverse.hpp"

#include <algorithm>
#include <cmath>

#include "length.hpp"
#include "require.hpp"

namespace signorini {
namespace {

constexpr double kOverflow = 1e100;  // beyond: no number to work with
constexpr double kGain = 0.1, kNoGain = 0.9;
constexpr double kBorder = 1e-12;  // share of the cone's radius that is rounding
// InverseSettings::keep: share of an impulse, and of the tolerance times the largest one, by which it may move.
constexpr double kMoves = 1e-3, kMovesOfLargest = 100.0;

using Row3 = Eigen::Vector3d;

/// sigma + Gamma(sigma) of a friction cone.
Row3 corrected(double friction, Law law, const Row3& sigma) {
  Row3 s = sigma;
  if (law == Law::Ncp) s[2] += friction * length(sigma[0], sigma[1]);
  return s;
}

/// dist(-s, N_K(impulse)) at a point of a friction cone: K's polar cone at 0, a ray on the border, 0 inside.
double distance_to_normals(double friction, const Row3& impulse, const Row3& s) {
  if (impulse.isZero(0.0)) {
    Row3 beyond = -s;  // what the polar cone does not hold of it (Moreau)
    project_friction_cone(friction, beyond.data(), beyond.data());
    return length(beyond.data(), 3);
  }
  if (friction == 0.0) return std::abs(s[2]);
  const double tangent = length(impulse[0], impulse[1]);
  if (tangent < (1.0 - kBorder) * friction * impulse[2]) return length(s.data(), 3);
  const Row3 ray = Row3(impulse[0] / tangent, impulse[1] / tangent, -friction) / std::hypot(1.0, friction);
  const Row3 left = s + std::max(0.0, -s.dot(ray)) * ray;
  return length(left.data(), 3);
}

/// The same for one row: N_K is the line below, above, or all of it at both ends of an interval of length 0.
double distance_to_normals(const ConstraintSet& set, double impulse, double s) {
  double lower = -1.0 / 0.0, upper = 1.0 / 0.0;
  if (set.type == SetType::HalfLine) lower = 0.0;
  if (set.type == SetType::Interval) lower = set.lower, upper = set.upper;
  if (impulse <= lower) s = std::min(s, 0.0);
  if (impulse >= upper) s = std::max(s, 0.0);
  return std::abs(s);
}

double set_residual(const ConstraintSet& set, Law law, const double* impulse, const double* sigma) {
  if (set.type != SetType::FrictionCone) return distance_to_normals(set, *impulse, *sigma);
  const Row3 x(impulse[0], impulse[1], impulse[2]);
  return distance_to_normals(set.friction, x, corrected(set.friction, law, Row3(sigma[0], sigma[1], sigma[2])));
}

/// Least change of c with which an impulse exists; 0 where compliance gives way.
double infeasibility(const ConstraintSet& set, Law law, const double* c, const double* compliance) {
  if (compliance[set.size() - 1] > 0.0) return 0.0;
  switch (set.type) {
    case SetType::FrictionCone: {
      if (law == Law::Ncp || compliance[0] > 0.0) return std::max(0.0, -c[2]);
      Row3 beyond(-c[0], -c[1], -c[2]);  // the CCP holds c in K*
      project_friction_cone(set.friction, beyond.data(), beyond.data());
      return length(beyond.data(), 3);
    }
    case SetType::HalfLine:
      return std::max(0.0, -*c);
    case SetType::Interval:
      return std::isinf(*c > 0.0 ? set.lower : set.upper) ? std::abs(*c) : 0.0;
    case SetType::Equality:
      return std::abs(*c);
  }
  return 0.0;
}

/// Impulse of a friction cone for R = diag(d_t, d_t, d_n) > 0, which is unique.
Row3 cone_impulse(double friction, Law law, const Row3& c, double d_t, double d_n) {
  Row3 x;
  if (law == Law::Ccp) {  // the projection in the metric of R (48)
    const double root_t = std::sqrt(d_t), root_n = std::sqrt(d_n);
    x = Row3(-c[0] / root_t, -c[1] / root_t, -c[2] / root_n);
    project_friction_cone(friction * root_t / root_n, x.data(), x.data());
    return Row3(x[0] / root_t, x[1] / root_t, x[2] / root_n);
  }
  x = Row3(-c[0] / d_t, -c[1] / d_t, std::max(0.0, -c[2] / d_n));  // Signorini knows nothing of the tangents ...
  const double tangent = length(x[0], x[1]), radius = friction * x[2];
  if (tangent > radius || radius == 0.0)
    x.head<2>() *= tangent > 0.0 ? radius / tangent : 0.0;  // ... and Coulomb takes what is left
  return x;
}

/// One proximal step: the unique solution with D = R, and rho where R = 0, at c - rho impulse. A rigid contact that
/// separates no faster than is allowed keeps its normal impulse, which rounding over rho would move.
void proximal_step(const ConstraintSet& set, const InverseSettings& settings, const double* c, const double* r,
                   double allowed, double* impulse) {
  const double rho = settings.proximal_weight;
  const auto weight = [&](Index k) { return r[k] > 0.0 ? r[k] : rho; };
  const auto shifted = [&](Index k) { return r[k] > 0.0 ? c[k] : c[k] - rho * impulse[k]; };
  if (set.type == SetType::FrictionCone) {
    const bool touches = settings.law == Law::Ncp && r[2] == 0.0 && std::abs(c[2]) <= allowed;
    const double normal = touches ? -rho * impulse[2] : shifted(2);
    const Row3 x = cone_impulse(set.friction, settings.law, Row3(shifted(0), shifted(1), normal), weight(0), weight(2));
    Eigen::Map<Row3>{impulse} = x;
  } else {
    *impulse = -shifted(0) / weight(0);
    project(set, impulse, impulse);
  }
}

/// The impulse of a rigid contact that slides as c says, opposite to it on the border of the cone, nearest to
/// `impulse`: for the NCP the one with the same normal, of which Coulomb's law says nothing (T46).
Row3 sliding_impulse(double friction, Law law, const double* c, const double* impulse) {
  const double speed = length(c[0], c[1]);
  const double t0 = -c[0] / speed, t1 = -c[1] / speed;
  double normal = impulse[2];
  if (law == Law::Ccp)
    normal = std::max(0.0, (normal + friction * (t0 * impulse[0] + t1 * impulse[1])) / (1.0 + friction * friction));
  return Row3(friction * normal * t0, friction * normal * t1, normal);
}

/// Proximal steps of one set from `impulse`, in K. A start that is good enough stays what it is, one that is but for
/// the border of the cone is put there: over rho the rounding of c would move it far. Else the steps go on past
/// `allowed` as long as they gain much; where there is no solution what is nearest to the start stays, not what steps
/// led to.
Status solve_set(const ConstraintSet& set, const InverseSettings& settings, const double* c, const double* r,
                 double allowed, double* impulse, int& iterations) {
  const Index rows = set.size();
  const auto own_residual = [&](const double* x) {
    double sigma[3];
    for (Index k = 0; k < rows; ++k) sigma[k] = r[k] * x[k] + c[k];
    return set_residual(set, settings.law, x, sigma);
  };
  double residual = own_residual(impulse);
  if (residual <= allowed) return Status::Solved;
  double nearest[3], least = residual;  // to a solution, of what is next to the start
  std::copy_n(impulse, rows, nearest);
  if (set.type == SetType::FrictionCone && r[0] == 0.0 && r[2] == 0.0 && (c[0] != 0.0 || c[1] != 0.0)) {
    const Row3 slides = sliding_impulse(set.friction, settings.law, c, impulse);
    const double sliding = own_residual(slides.data());
    if (sliding < least) least = sliding, Eigen::Map<Row3>(nearest) = slides;
    if (least <= allowed) {
      Eigen::Map<Row3>{impulse} = slides;
      return Status::Solved;
    }
  }
  for (iterations = 1; iterations <= settings.max_iterations; ++iterations) {
    double next[3];
    std::copy_n(impulse, rows, next);
    proximal_step(set, settings, c, r, allowed, next);
    const double before = residual;
    residual = own_residual(next);
    if (!(residual <= kOverflow && std::all_of(next, next + rows, [](double x) { return std::isfinite(x); })))
      return Status::Invalid;
    if (before <= allowed && residual > kGain * before) return Status::Solved;
    std::copy_n(next, rows, impulse);
    if (residual == 0.0) return Status::Solved;
    // An infeasible set's residual does not fall while its impulse grows without bound.
    if (residual > allowed && residual > kNoGain * before && infeasibility(set, settings.law, c, r) > allowed) {
      if (residual > kNoGain * least) std::copy_n(nearest, rows, impulse);
      return Status::Infeasible;
    }
  }
  --iterations;
  return residual <= allowed ? Status::Solved : Status::MaxIterations;
}

/// The worst status of a set is the whole's.
int severity(Status status) {
  return status == Status::Solved ? 0 : status == Status::MaxIterations ? 1 : status == Status::Infeasible ? 2 : 3;
}

void check_input(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets,
                 const ConstVectorRef* guess, double speed) {
  const auto check_size = [&](const char* field, const ConstVectorRef& x) {
    if (x.size() != sets.size())
      throw InvalidInput(field, "has " + std::to_string(x.size()) + " entries, must have " +
                                    std::to_string(sets.size()) + ", the rows of the constraints");
    require_finite(field, x);
  };
  sets.validate();
  check_size("contact_velocity", velocity);
  check_size("compliance", compliance);
  if (guess) check_size("guess", *guess);
  require(speed >= 0.0 && speed <= kOverflow, "speed", speed, "in [0, 1e100] m/s");
  for (Index i = 0; i < compliance.size(); ++i)
    if (!(compliance[i] >= 0.0)) require(false, "compliance[" + std::to_string(i) + "]", compliance[i], "at least 0");
  for (const ConstraintSet& set : sets) {
    if (set.type != SetType::FrictionCone || compliance[set.offset] == compliance[set.offset + 1]) continue;
    require(false, "compliance[" + std::to_string(set.offset + 1) + "]", compliance[set.offset + 1],
            "equal to that of the other tangent of its contact, or the cone is no cone in the metric of R");
  }
}

/// What velocities are small against: as given, or the largest c or R impulse of a set.
double reference_speed(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets,
                       const ConstVectorRef& impulse, double speed) {
  if (speed > 0.0) return speed;
  for (const ConstraintSet& set : sets) {
    const Index at = set.offset, rows = set.size();
    double springs[3];
    for (Index k = 0; k < rows; ++k) springs[k] = compliance[at + k] * impulse[at + k];
    speed = std::max({speed, length(velocity.data() + at, rows), length(springs, rows)});
  }
  return std::min(speed, kOverflow);
}

void judge(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets, Law law,
           double speed, InverseSolution& solution) {
  const GrowVector& x = solution.impulse;
  solution.velocity.resize(sets.size());
  solution.velocity = velocity + compliance.cwiseProduct(x);
  solution.residual = 0.0;
  solution.worst = sets.num_sets() > 0 ? 0 : -1;
  for (Index i = 0; i < sets.num_sets(); ++i) {
    const ConstraintSet& set = sets[i];
    const double own = set_residual(set, law, x.data() + set.offset, solution.velocity.data() + set.offset);
    if (own > solution.residual || own != own) solution.residual = own, solution.worst = i;
    if (own != own) break;
  }
  solution.relative = solution.residual;
  if (solution.residual > 0.0) solution.relative /= speed;
}

}  // namespace

void InverseSettings::validate() const {
  require(proximal_weight > 0.0 && proximal_weight <= 1e6, "proximal_weight", proximal_weight, "in (0, 1e6] 1/kg");
  require(tolerance > 0.0 && tolerance < 1.0, "tolerance", tolerance, "in (0, 1)");
  require(max_iterations >= 1, "max_iterations", max_iterations, "at least 1");
}

void judge_inverse(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets,
                   Law law, double speed, InverseSolution& solution) {
  const ConstVectorRef impulse(solution.impulse);
  check_input(velocity, compliance, sets, &impulse, speed);
  judge(velocity, compliance, sets, law, reference_speed(velocity, compliance, sets, impulse, speed), solution);
}

void solve_inverse(const ConstVectorRef& velocity, const ConstVectorRef& compliance, const ConstraintSets& sets,
                   const InverseSettings& settings, InverseSolution& solution, const ConstVectorRef* guess,
                   double speed) {
  settings.validate();
  check_input(velocity, compliance, sets, guess, speed);
  GrowVector& x = solution.impulse;
  x.resize(sets.size());
  if (guess)
    sets.project(*guess, x);
  else
    for (const ConstraintSet& set : sets) {  // an interval needs not hold 0
      x.segment(set.offset, set.size()).setZero();
      project(set, x.data() + set.offset, x.data() + set.offset);
    }
  speed = reference_speed(velocity, compliance, sets, x, speed);
  const double allowed = settings.tolerance * speed;
  solution.status = Status::Solved;
  solution.iterations = 0;
  double largest = 0.0;
  for (const ConstraintSet& set : sets) largest = std::max(largest, length(x.data() + set.offset, set.size()));
  for (const ConstraintSet& set : sets) {  // none feels another
    const Index at = set.offset, rows = set.size();
    double start[3], moved[3];
    std::copy_n(x.data() + at, rows, start);
    int iterations = 0;
    Status own =
        solve_set(set, settings, velocity.data() + at, compliance.data() + at, allowed, x.data() + at, iterations);
    solution.iterations = std::max(solution.iterations, iterations);
    for (Index k = 0; k < rows; ++k) moved[k] = x[at + k] - start[k];
    const double near = kMoves * length(start, rows) + kMovesOfLargest * settings.tolerance * largest;
    if (settings.keep && !(length(moved, rows) <= near)) {
      std::copy_n(start, rows, x.data() + at);
      own = Status::MaxIterations;
    }
    if (severity(own) > severity(solution.status)) solution.status = own;
  }
  judge(velocity, compliance, sets, settings.law, speed, solution);
}

}  // namespace signorini
