#pragma once

#include "signorini/solver/solution.hpp"

namespace signorini {

/// What the Gauss-Seidel methods share: an impulse and its velocity, kept up to date row by row.
struct GaussSeidel {
  SparseMatrix matrix;  ///< G
  Vector compliance;    ///< diagonal of R
  Vector impulse;
  Vector sigma;  ///< (G + R) impulse + g
  Vector best;   ///< the impulse with the smallest residual so far

  /// Sizes and fills all but sigma and best. The impulse starts at the guess, or 0.
  void setup(const ContactProblem& problem, const Guess* guess);
  /// Block of G + R on the rows of a set, in the top left corner.
  Eigen::Matrix3d block(const ConstraintSet& set) const;

  void assign(Index row, double value) {
    const double change = value - impulse[row];
    if (change == 0.0) return;
    impulse[row] = value;
    for (SparseMatrix::InnerIterator it(matrix, row); it; ++it) sigma[it.row()] += it.value() * change;
    sigma[row] += compliance[row] * change;
  }

  /// x = P_K(x - step sigma) on one set.
  void project_step(const ConstraintSet& set, double step) {
    double x[3];
    for (Index k = 0; k < set.size(); ++k) x[k] = impulse[set.offset + k] - step * sigma[set.offset + k];
    project(set, x, x);
    for (Index k = 0; k < set.size(); ++k) assign(set.offset + k, x[k]);
  }
};

}  // namespace signorini
