#include "signorini/solver/settings.hpp"

#include <sstream>

#include "signorini/errors.hpp"

namespace signorini {
namespace {

template <typename T>
void check(bool allowed, const char* field, T value, const char* range) {
  if (allowed) return;
  std::ostringstream message;
  message << "is " << value << ", must be " << range;
  throw InvalidInput(field, message.str());
}

}  // namespace

AdmmSettings AdmmSettings::paper(double absolute_tolerance) {
  AdmmSettings settings;
  settings.penalty_rule = PenaltyRule::Spectral;
  settings.scaling = false;
  settings.anderson_memory = 0;
  settings.paper_tolerance = absolute_tolerance;
  return settings;
}

void Settings::validate() const {
  check(tolerance > 0.0 && tolerance < 1.0, "tolerance", tolerance, "in (0, 1)");
  check(aim >= 0.0 && aim <= tolerance, "aim", aim, "in (0, tolerance], or 0 for 1e-3 tolerance");
  check(max_iterations >= 0, "max_iterations", max_iterations, "at least 1, or 0 for the solver's own default");
  check(admm.penalty >= 0.0 && admm.penalty <= 1e100, "penalty", admm.penalty, "in [0, 1e100]");
  check(admm.proximal_weight > 0.0 && admm.proximal_weight <= 1e100, "proximal_weight", admm.proximal_weight,
        "in (0, 1e100]");
  check(admm.spectral_exponent >= -1.0 && admm.spectral_exponent <= 1.0, "spectral_exponent", admm.spectral_exponent,
        "in [-1, 1]");
  check(admm.spectral_increment > 0.0 && admm.spectral_increment <= 1.0, "spectral_increment", admm.spectral_increment,
        "in (0, 1]");
  check(admm.linear_factor > 1.0 && admm.linear_factor <= 1e6, "linear_factor", admm.linear_factor, "in (1, 1e6]");
  check(admm.ratio > 1.0 && admm.ratio <= 1e6, "ratio", admm.ratio, "in (1, 1e6]");
  check(admm.anderson_memory >= 0 && admm.anderson_memory <= 50, "anderson_memory", admm.anderson_memory, "in [0, 50]");
  check(admm.paper_tolerance >= 0.0 && admm.paper_tolerance < 1.0, "paper_tolerance", admm.paper_tolerance,
        "in [0, 1)");
  check(pgs.over_relaxation > 0.0 && pgs.over_relaxation < 2.0, "over_relaxation", pgs.over_relaxation, "in (0, 2)");
  check(pyramid.facets >= 4 && pyramid.facets <= 64 && pyramid.facets % 2 == 0, "facets", pyramid.facets,
        "even and in [4, 64]");
  check(convex.impedance >= 1e-3 && convex.impedance <= 1.0 - 1e-6, "impedance", convex.impedance,
        "in [0.001, 1 - 1e-6]: without compliance the impulse is no function of the velocity");
  check(bisection.least_relaxation > 0.0 && bisection.least_relaxation <= 1.0, "least_relaxation",
        bisection.least_relaxation, "in (0, 1]");
  check(bisection.relaxation_decay >= 0.0 && bisection.relaxation_decay <= 1.0, "relaxation_decay",
        bisection.relaxation_decay, "in [0, 1]");
}

const char* name(SolverType solver) {
  switch (solver) {
    case SolverType::Auto:
      return "auto";
    case SolverType::Admm:
      return "admm";
    case SolverType::Pgs:
      return "pgs";
    case SolverType::InteriorPoint:
      return "interior-point";
    case SolverType::Newton:
      return "newton";
    case SolverType::LcpPgs:
      return "lcp-pgs";
    case SolverType::ConvexNewton:
      return "convex-newton";
    case SolverType::Bisection:
      return "bisection";
  }
  return "";
}

bool solves_the_law(SolverType solver) {
  return solver != SolverType::LcpPgs && solver != SolverType::ConvexNewton && solver != SolverType::Bisection;
}

const char* name(PenaltyRule rule) {
  switch (rule) {
    case PenaltyRule::Spectral:
      return "spectral";
    case PenaltyRule::Linear:
      return "linear";
    case PenaltyRule::ResidualBalancing:
      return "residual-balancing";
    case PenaltyRule::Constant:
      return "constant";
  }
  return "";
}

}  // namespace signorini
