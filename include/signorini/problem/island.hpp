#pragma once

#include <memory>
#include <vector>

#include "signorini/problem/contact_problem.hpp"

namespace signorini {

/// A part of a contact problem that nothing outside acts on: a problem of its own.
struct Island {
  std::shared_ptr<const ContactProblem> problem;  ///< null when the whole problem is one island
  std::vector<Index> rows;                        ///< of the whole problem; empty when it is one island

  Index row(Index i) const { return problem ? rows[static_cast<std::size_t>(i)] : i; }
};

/// Splits a problem into the connected components of its contact graph.
std::vector<Island> find_islands(const ContactProblem& problem);

}  // namespace signorini
