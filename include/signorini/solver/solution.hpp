#pragma once

#include <vector>

#include "signorini/problem/residual.hpp"
#include "signorini/solver/settings.hpp"

namespace signorini {

enum class Status {
  Solved,         ///< the certificate is within the tolerance; said of nothing else
  MaxIterations,  ///< out of iterations; impulse is the best seen
  Stalled,        ///< the method cannot go on, or has solved its own model; impulse is the best seen
  Infeasible,     ///< auto: a ray rules out solutions of reasonable size (T49); inverse: nothing allows the motion
  Invalid         ///< no finite impulse was found; impulse is zero
};

struct IterationRecord {
  int iteration = 0;
  int factorizations = 0;  ///< so far; auto: of all islands, one after the other
  double penalty = 0.0;    ///< ADMM's rho, 0 elsewhere
  Residual residual;       ///< of the true problem, at this iteration's impulse
};

/// Complete also when a solve fails.
struct Solution {
  Status status = Status::Invalid;
  SolverType solver = SolverType::Auto;  ///< the method that produced the answer, of the largest island
  GrowVector impulse;                    ///< lambda [N s]
  GrowVector velocity;                   ///< sigma = (G + R) lambda + g [m/s], without Gamma
  Residual residual;                     ///< the certificate of `impulse`
  /// Relative residual of the model that the solver really solves (docs/models.md); of those that solve the law itself,
  /// residual.relative.
  double model_residual = 0.0;
  int iterations = 0;      ///< auto: of the island that took the most
  int factorizations = 0;  ///< likewise
  double seconds = 0.0;    ///< wall time of the solve, symbolic analysis included
  double penalty = 0.0;    ///< ADMM's last rho, for a warm start; 0 elsewhere
  /// One record an iterate; newton, interior point and convex-newton begin with their start, iteration 0; of auto those
  /// of each method in each island, one after the other, counted through.
  std::vector<IterationRecord> history;
};

/// Where to start. The impulse needs not be feasible. Raises InvalidInput when sizes differ or entries are not finite.
struct Guess {
  GrowVector impulse;    ///< n values [N s]
  double penalty = 0.0;  ///< ADMM's rho of the last solve; 0: chosen by the rule
  /// It has solved a problem that differs in places: auto keeps it on islands where it still does.
  bool answers = false;
};

const char* name(Status status);

}  // namespace signorini
