#include "signorini/solver/settings.hpp"

#include "require.hpp"

namespace signorini {
AdmmSettings AdmmSettings::paper(double absolute_tolerance) {
  AdmmSettings settings;
  settings.penalty_rule = PenaltyRule::Spectral;
  settings.scaling = false;
  settings.anderson_memory = 0;
  settings.paper_tolerance = absolute_tolerance;
  return settings;
}

void Settings::validate() const {
  require(tolerance > 0.0 && tolerance < 1.0, "tolerance", tolerance, "in (0, 1)");
  require(aim >= 0.0 && aim <= tolerance, "aim", aim, "in (0, tolerance], or 0 for 1e-3 tolerance");
  require(max_iterations >= 0, "max_iterations", max_iterations, "at least 1, or 0 for the solver's own default");
  require(admm.penalty >= 0.0 && admm.penalty <= 1e100, "penalty", admm.penalty, "in [0, 1e100]");
  require(admm.proximal_weight > 0.0 && admm.proximal_weight <= 1e100, "proximal_weight", admm.proximal_weight,
          "in (0, 1e100]");
  require(admm.spectral_exponent >= -1.0 && admm.spectral_exponent <= 1.0, "spectral_exponent", admm.spectral_exponent,
          "in [-1, 1]");
  require(admm.spectral_increment > 0.0 && admm.spectral_increment <= 1.0, "spectral_increment",
          admm.spectral_increment, "in (0, 1]");
  require(admm.linear_factor > 1.0 && admm.linear_factor <= 1e6, "linear_factor", admm.linear_factor, "in (1, 1e6]");
  require(admm.ratio > 1.0 && admm.ratio <= 1e6, "ratio", admm.ratio, "in (1, 1e6]");
  require(admm.anderson_memory >= 0 && admm.anderson_memory <= 50, "anderson_memory", admm.anderson_memory,
          "in [0, 50]");
  require(admm.paper_tolerance >= 0.0 && admm.paper_tolerance < 1.0, "paper_tolerance", admm.paper_tolerance,
          "in [0, 1)");
  require(pgs.over_relaxation > 0.0 && pgs.over_relaxation < 2.0, "over_relaxation", pgs.over_relaxation, "in (0, 2)");
  require(pyramid.facets >= 4 && pyramid.facets <= 64 && pyramid.facets % 2 == 0, "facets", pyramid.facets,
          "even and in [4, 64]");
  require(convex.impedance >= 1e-3 && convex.impedance <= 1.0 - 1e-6, "impedance", convex.impedance,
          "in [0.001, 1 - 1e-6]: without compliance the impulse is no function of the velocity");
  require(bisection.least_relaxation > 0.0 && bisection.least_relaxation <= 1.0, "least_relaxation",
          bisection.least_relaxation, "in (0, 1]");
  require(bisection.relaxation_decay >= 0.0 && bisection.relaxation_decay <= 1.0, "relaxation_decay",
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
