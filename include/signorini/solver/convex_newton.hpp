#pragma once

#include "signorini/solver/scaled_problem.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

/// Memory of solve_convex_newton, sized at the first solve.
struct ConvexNewtonWorkspace {
  ScaledProblem problem;
  GrowVector l, u;         ///< the unknown, as an impulse, and its velocity A l + b
  GrowVector impulse;      ///< P_K(-u / r)
  GrowVector step, moved;  ///< Newton step in l, and in u
  GrowVector gradient;     ///< A (l - impulse)
  BlockDiagonal x, y;
};

/// The CCP with a compliance on every row, as a convex cost of the velocity, by Newton with an exact line search: the
/// model of MuJoCo and of Drake's SAP (docs/models.md). Settings::law is the certificate's alone.
void solve_convex_newton(const ContactProblem& problem, const Settings& settings, ConvexNewtonWorkspace& workspace,
                         const Guess* guess, Solution& solution);

}  // namespace signorini
