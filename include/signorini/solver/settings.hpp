#pragma once

#include "signorini/types.hpp"

namespace signorini {

/// The last three are other engines' models of contact (docs/models.md), which the certificate seldom calls solved.
enum class SolverType { Auto, Admm, Pgs, InteriorPoint, Newton, LcpPgs, ConvexNewton, Bisection };

/// How ADMM moves its penalty rho; names and numbers of Carpentier et al. 2024, section III-F.
enum class PenaltyRule {
  Spectral,           ///< (46): rho = sqrt(m L) (L/m)^p, p moved by +- spectral_increment
  Linear,             ///< (44): rho multiplied or divided by linear_factor
  ResidualBalancing,  ///< rho *= sqrt of the ratio of the relative residuals, past a threshold (OSQP)
  Constant            ///< rho = penalty throughout
};

struct AdmmSettings {
  PenaltyRule penalty_rule = PenaltyRule::ResidualBalancing;
  double penalty = 0.0;              ///< starting rho [1/kg, or 1 when scaled]; 0: chosen by the rule
  double proximal_weight = 1e-6;     ///< eta
  double spectral_exponent = 0.25;   ///< starting p of the spectral rule
  double spectral_increment = 0.05;  ///< p_inc = p_dec
  double linear_factor = 2.0;        ///< tau_inc = tau_dec
  double ratio = 10.0;               ///< alpha: residual ratio that triggers a change of rho
  bool scaling = true;               ///< one scale factor per contact
  int anderson_memory = 10;          ///< 0: no Anderson acceleration
  /// > 0: also stop when (43) holds at this absolute tolerance, as the paper's Algorithm 1 does; the status still says
  /// Solved only when the certificate holds.
  double paper_tolerance = 0.0;

  /// Algorithm 1 exactly as written: spectral rule, no scaling, no acceleration, stop test (43).
  static AdmmSettings paper(double absolute_tolerance = 1e-6);
};

struct PgsSettings {
  double over_relaxation = 1.0;  ///< in (0, 2); of LcpPgs too
};

struct PyramidSettings {
  int facets = 4;  ///< of the pyramid around the friction cone; even, in [4, 64]
};

struct ConvexSettings {
  /// MuJoCo's d, in [1e-3, 1 - 1e-6]: every set has a compliance of (1 - d) / d of the mean diagonal of its block.
  double impedance = 0.9;
};

struct BisectionSettings {
  double least_relaxation = 0.7;   ///< what the share of a new impulse tends to from 1, in (0, 1]
  double relaxation_decay = 0.99;  ///< of its distance to that, a sweep; in [0, 1]
};

/// One settings object for all solvers. Never written by a solver.
struct Settings {
  SolverType solver = SolverType::Auto;
  Law law = Law::Ncp;
  double tolerance = 1e-6;  ///< on the certificate, Residual::solves(), in (0, 1)
  /// What `auto` aims at from a guess, in (0, tolerance]: it goes on below the tolerance while that is cheap, which a
  /// stepping loop wants for its lightest bodies. A guess must be that good to be left alone. 0: 1e-3 tolerance.
  double aim = 0.0;
  /// 0: the solver's own default; else at least 1. Of `auto`: factorisations that an island may cost, about.
  int max_iterations = 0;
  bool record_history = false;  ///< Solution::history, one record an iterate
  AdmmSettings admm;
  PgsSettings pgs;
  PyramidSettings pyramid;
  ConvexSettings convex;
  BisectionSettings bisection;

  /// The law by which contacts act or not in what the solver really solves.
  Law model_law() const { return solver == SolverType::ConvexNewton ? Law::Ccp : law; }

  /// Raises InvalidInput naming the field, its value and the allowed range.
  void validate() const;
};

const char* name(SolverType solver);
/// False for other engines' models of contact.
bool solves_the_law(SolverType solver);
const char* name(PenaltyRule rule);

}  // namespace signorini
