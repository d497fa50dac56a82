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
  BlockDiagonal damping;              ///< (eta + rho) I
  Vector f, f_last, y, y_last, z, s;  ///< the letters of Algorithm 1
  Vector w, w_next, w_plain;          ///< f - z / rho: y and z are functions of it
  Vector velocity;                    ///< A f + b
  Vector best;                        ///< the y with the smallest residual so far
  Vector impulse, sigma, scratch;     ///< for the certificate
};

/// Proximal ADMM, Algorithm 1 of Carpentier et al. 2024, with Anderson acceleration on the scaled problem; exactly the
/// paper's with AdmmSettings::paper(). Method, defaults and the measurements behind them: docs/solvers_admm_pgs.md.
void solve_admm(const ContactProblem& problem, const Settings& settings, AdmmWorkspace& workspace, const Guess* guess,
                Solution& solution);

}  // namespace signorini
