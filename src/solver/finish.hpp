#pragma once

#include "signorini/solver/solution.hpp"

namespace signorini {

/// Certifies solution.impulse on the true problem: fills velocity, residual and status.
void finish(const ContactProblem& problem, const Settings& settings, bool out_of_iterations, Solution& solution);

}  // namespace signorini
