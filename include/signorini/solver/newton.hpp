#pragma once

#include <functional>
#include <limits>
#include <vector>

#include "signorini/solver/block_sweeps.hpp"
#include "signorini/solver/scaled_problem.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

/// Vectors of the semismooth Newton methods, sized once.
struct NewtonMemory {
  GrowVector l, t, natural, direction, trial, trial_t, trial_natural, best;
  BlockDiagonal x, y;
  std::vector<ReducedSet> reduced;
  GrowVector jump, rhs;
  GrowVector centre, nearest, last, move;
  void resize(Index size, Index num_sets);
};

/// Called with each iterate (scaled impulse) and the factorisations so far; empty: not called.
using IterateObserver = std::function<void(const ConstVectorRef& l, int factorizations)>;

struct NewtonResult {
  double relative = 0.0;  ///< certificate of NewtonMemory::best
  int iterations = 0;
  int factorizations = 0;
};

/// Semismooth Newton on the natural map l - P_K(l - t - Gamma(t)) of a scaled problem (docs/theory.md, section 9), from
/// memory.l. Quadratic near a solution, nothing promised far from one: made to finish and to warm-start. memory.best is
/// the best iterate seen.
NewtonResult newton_iterations(ScaledProblem& problem, Law law, double tolerance, int max_iterations,
                               NewtonMemory& memory, const IterateObserver& observe = {});

/// How active_newton_iterations() is damped, and when it gives up.
struct ActiveSearch {
  double delta = 1e-2;                                         ///< damping, of the residual to the power below
  double most_left = std::numeric_limits<double>::infinity();  ///< of the residual by an iteration, else it gives up
  bool velocity_known = false;                                 ///< memory.t is that of memory.l
  double power = 1.0;
};

/// Semismooth Newton on Alart and Curnier's equations of the NCP, reduced to the rows that are active (section 9 of
/// docs/theory.md): smaller systems, and symmetric ones where nothing slips. Made for warm starts: from memory.l, a
/// factor is used again while it gains, so that the answer is often far better than `tolerance`; stops at `aim` <=
/// tolerance, or at the tolerance once a step gains nothing. For systems that reduce() only.
/// centre: of the problem with A + weight I and b - weight centre instead; sweeps: smooth what its steps leave.
NewtonResult active_newton_iterations(ScaledProblem& problem, double tolerance, double aim, int max_iterations,
                                      NewtonMemory& memory, const IterateObserver& observe = {}, double weight = 0.0,
                                      const GrowVector* centre = nullptr, const ActiveSearch& search = {},
                                      BlockSweeps* sweeps = nullptr);

/// memory.l: the impulse with which every contact sticks and every bound acts, one linear system. False when that is
/// singular. For systems that reduce() only.
bool stick_everywhere(ScaledProblem& problem, NewtonMemory& memory);

/// Proximal point method on the NCP: each step solves, by active_newton_iterations(), the problem with a quadratic term
/// that holds the impulse near the last one. Far more robust than Newton alone where redundant contacts leave the
/// impulse nearly free. For systems that reduce() only. weight: of that term in the first step. patience:
/// factorisations without halving the residual after which it gives up. sweeps: for large islands, where some contact
/// changes its state in nearly every step and would shorten it for all: full steps, smoothed by Gauss-Seidel.
NewtonResult proximal_newton_iterations(ScaledProblem& problem, double tolerance, double weight, int max_factorizations,
                                        int patience, NewtonMemory& memory, const IterateObserver& observe = {},
                                        BlockSweeps* sweeps = nullptr);

struct NewtonWorkspace {
  ScaledProblem problem;
  NewtonMemory memory;
};

void solve_newton(const ContactProblem& problem, const Settings& settings, NewtonWorkspace& workspace,
                  const Guess* guess, Solution& solution);

}  // namespace signorini
