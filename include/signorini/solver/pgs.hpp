#pragma once

#include <vector>

#include "signorini/solver/gauss_seidel.hpp"

namespace signorini {

/// Memory of solve_pgs, sized at the first solve.
struct PgsWorkspace {
  struct Step {
    double normal = 0.0;   ///< 1 / normal diagonal entry; of a one-row set, 1 / its entry
    double tangent = 0.0;  ///< 1 / largest eigenvalue of the tangential block
    double cone = 0.0;     ///< 1 / largest eigenvalue of the whole block
  };
  GaussSeidel rows;
  std::vector<Step> step;  ///< a set each; 0 where the block of G + R is 0
};

/// Over-relaxed projected Gauss-Seidel (Jourdan, Alart and Jean 1998), a set at a time: what robotics uses. Slow where
/// masses differ or contacts are redundant. Choices and measurements: docs/solvers_admm_pgs.md.
void solve_pgs(const ContactProblem& problem, const Settings& settings, PgsWorkspace& workspace, const Guess* guess,
               Solution& solution);

}  // namespace signorini
