#pragma once

#include <algorithm>

#include "signorini/problem/contact_problem.hpp"

namespace signorini {

/// The certificate (docs/theory.md, T10 to T12): how far an impulse is from solving a problem, asked of no solver. NaN
/// as soon as anything is NaN.
/// With sigma = (G + R) impulse + g and s = sigma + Gamma(sigma), maxima over the sets:
struct Residual {
  double primal = 0.0;  ///< dist(impulse, K) [N s]
  double dual = 0.0;  ///< dist(s, K*) [m/s]; |s| for an equality or towards a bound at infinity; else 0 for an interval
  double complementarity = 0.0;  ///< |impulse . s| [J]; for an interval (x - lower) s+ + (upper - x) s-
  /// The number that judges, free of units and scale (T12): max |l - P_K(l - t)| / max(max |l|, max |g| / sqrt(d)) with
  /// l = sqrt(d) impulse, t = s / sqrt(d), d = ContactProblem::scale().
  double relative = 0.0;
  /// max |l - P_K(l - t)| over max |g| / sqrt(d), what is left of what there was to solve: an impulse that grows
  /// without bound, as in a problem without solution, makes `relative` small but not this.
  double against_free_velocity = 0.0;
  // Two physical readings, friction cones only:
  double signorini = 0.0;    ///< max of approach speed left [m/s], -min(sigma_N, 0), and pull [N s], -min(impulse_N, 0)
  double dissipation = 0.0;  ///< max |impulse_T . sigma_T + friction impulse_N |sigma_T|| [J]

  /// The certificate holds: relative within the tolerance, and against_free_velocity within its largest_share.
  bool solves(double tolerance) const {
    return relative <= tolerance && against_free_velocity <= largest_share(tolerance);  // false for NaN
  }
  /// What against_free_velocity may be: 1000 tolerances, and no more than 0.1.
  static double largest_share(double tolerance) { return std::min(0.1, 1e3 * tolerance); }
  /// The worse of the two, each over what it may be: what iterates are compared by.
  double excess(double tolerance) const {
    return std::max(relative / tolerance, against_free_velocity / largest_share(tolerance));
  }
};

/// What one set contributes to Residual::relative (T11, T12): error |l - P_K(l - t)|, size |l|, and free |g| / sqrt(d),
/// or the impulse that an interval imposes. velocity: sigma of the whole problem.
struct RelativePart {
  double error = 0.0, size = 0.0, free = 0.0;
};
RelativePart relative_part(const ContactProblem& problem, Index set, const ConstVectorRef& impulse,
                           const ConstVectorRef& velocity, Law law);

/// impulse: n values [N s]. velocity, if given, receives sigma (without Gamma).
Residual residual(const ContactProblem& problem, const ConstVectorRef& impulse, Law law = Law::Ncp,
                  Vector* velocity = nullptr);

/// The same without allocating: sigma, n values, is an output.
Residual residual(const ContactProblem& problem, const ConstVectorRef& impulse, Law law, VectorRef sigma);

}  // namespace signorini
