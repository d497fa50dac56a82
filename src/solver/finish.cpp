#include "finish.hpp"

#include "no_malloc.hpp"

namespace signorini {

void finish(const ContactProblem& problem, const Settings& settings, bool out_of_iterations, Solution& solution) {
  solution.velocity.resize(problem.size());
  if (!solution.impulse.allFinite()) {
    solution.impulse.setZero(problem.size());
    solution.residual = residual(problem, solution.impulse, settings.law, solution.velocity);
    solution.model_residual = solution.residual.relative;
    solution.status = Status::Invalid;
    return;
  }
  solution.residual = residual(problem, solution.impulse, settings.law, solution.velocity);
  solution.model_residual = solution.residual.relative;
  solution.status = solution.residual.solves(settings.tolerance) ? Status::Solved
                    : out_of_iterations                          ? Status::MaxIterations
                                                                 : Status::Stalled;
}

void Recorder::record(const ConstVectorRef& l, const ScaledProblem& scaled, int factorizations) {
  if (!settings_.record_history) return;
  const AllowMalloc allow;
  Vector impulse(problem_.size());
  scaled.to_impulse(l, impulse);
  record(impulse, factorizations);
}

void Recorder::record(const ConstVectorRef& impulse, int factorizations) {
  if (!settings_.record_history) return;
  const AllowMalloc allow;
  IterationRecord entry;
  entry.iteration = static_cast<int>(solution_.history.size());
  entry.factorizations = factorizations;
  entry.residual = residual(problem_, impulse, settings_.law);
  solution_.history.push_back(entry);
}

}  // namespace signorini
