#include "finish.hpp"

namespace signorini {

void finish(const ContactProblem& problem, const Settings& settings, bool out_of_iterations, Solution& solution) {
  if (!solution.impulse.allFinite()) {
    solution.impulse.setZero(problem.size());
    solution.residual = residual(problem, solution.impulse, settings.law, &solution.velocity);
    solution.status = Status::Invalid;
    return;
  }
  solution.residual = residual(problem, solution.impulse, settings.law, &solution.velocity);
  solution.status = solution.residual.solves(settings.tolerance) ? Status::Solved
                    : out_of_iterations                          ? Status::MaxIterations
                                                                 : Status::Stalled;
}

}  // namespace signorini
