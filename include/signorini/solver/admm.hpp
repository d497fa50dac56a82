#pragma once

#include "signorini/solver/anderson.hpp"
#include "signorini/solver/penalty_rule.hpp"
#include "signorini/solver/scaled_problem.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

/// Memory of solve_admm, sized at the first solve.
struct AdmmWorkspace {
  ScaledProblem problem;
  Penalty penalty;
  Anderson anderson;
  BlockDiagonal damping;               ///< (eta + rho) I
  Vector f, f_last, y, y_last, z, s;   ///< the letters of Algorithm 1
  Vector w, w_next, w_last;            ///< f - z / rho: its fixed point is the solution
  Vector velocity;                     ///< A f + b
  Vector best;                         ///< y with the smallest residual so far
  Vector impulse, sigma, scratch;      ///< certificate
};

/// Proximal ADMM, Algorithm 1 of Carpentier et al. 2024, on the scaled problem, with Anderson acceleration; exactly
/// the paper's with AdmmSettings::paper(). Equations and measurements: docs/solvers_admm_pgs.md.
void solve_admm(const ContactProblem& problem, const Settings& settings, AdmmWorkspace& workspace, const Guess* guess,
                Solution& solution);

}  // namespace signorini
