#pragma once

#include "signorini/solver/scaled_problem.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

/// Certifies solution.impulse on the true problem: fills velocity, residual, model_residual (of a solver
/// of the law itself) and status.
void finish(const ContactProblem& problem, const Settings& settings, bool out_of_iterations, Solution& solution);

/// Writes Solution::history when settings.record_history asks for it.
class Recorder {
 public:
  Recorder(const ContactProblem& problem, const Settings& settings, Solution& solution)
      : problem_(problem), settings_(settings), solution_(solution) {}

  /// One more iterate: scaled impulse l of the whole problem.
  void record(const ConstVectorRef& l, const ScaledProblem& scaled, int factorizations);
  /// The same for an impulse that is already in N s.
  void record(const ConstVectorRef& impulse, int factorizations);

 private:
  const ContactProblem& problem_;
  const Settings& settings_;
  Solution& solution_;
};

}  // namespace signorini
