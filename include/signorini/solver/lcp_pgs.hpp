#pragma once

#include <vector>

#include "signorini/solver/gauss_seidel.hpp"

namespace signorini {

/// Memory of solve_lcp_pgs, sized at the first solve.
struct LcpPgsWorkspace {
  struct Row {
    double x = 0.0, y = 0.0;  ///< its direction in the tangential plane
    double share = 0.0;       ///< impulse along it [N s]
    double step = 0.0;        ///< 1 / its diagonal entry; 0 where that is 0
  };
  GaussSeidel rows;
  std::vector<double> normal_step;  ///< a set each: 1 / diagonal entry of its last row
  std::vector<Row> tangent;         ///< facets / 2 a set, used by contacts only
};

/// A friction pyramid with Signorini's normal, as a linear complementarity problem with box-coupled rows, by projected
/// Gauss-Seidel row by row: the model of ODE, PhysX and DART (docs/models.md). Settings::law is the certificate's
/// alone.
void solve_lcp_pgs(const ContactProblem& problem, const Settings& settings, LcpPgsWorkspace& workspace,
                   const Guess* guess, Solution& solution);

}  // namespace signorini
