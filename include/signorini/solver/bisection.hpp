#pragma once

#include "signorini/delassus/scaled_delassus.hpp"
#include "signorini/solver/gauss_seidel.hpp"

namespace signorini {

/// The impulse of one contact alone: 0 where it opens, the one that stops it where that is in the cone, else of those
/// on the cone that leave no normal velocity the one with the least energy 1/2 x . G x + x . c, by bisection on its
/// direction. block: G + R of the contact, inverse: its (pseudo-)inverse, c: velocity without this contact, 3 values,
/// normal last, as x.
void solve_contact_by_bisection(const Eigen::Matrix3d& block, const Eigen::Matrix3d& inverse, double friction,
                                const double* c, double* x);

/// Memory of solve_bisection, sized at the first solve.
struct BisectionWorkspace {
  GaussSeidel rows;
  BlockDiagonal block, inverse;  ///< of G + R; of a one-row set, entry (0, 0), 0 where there is no inverse
};

/// Gauss-Seidel over contacts, each solved exactly on its own, with decaying relaxation (Hwangbo, Lee and Hutter 2018,
/// RaiSim): docs/models.md. Settings::law is the certificate's alone.
void solve_bisection(const ContactProblem& problem, const Settings& settings, BisectionWorkspace& workspace,
                     const Guess* guess, Solution& solution);

}  // namespace signorini
