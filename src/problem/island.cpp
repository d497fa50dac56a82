#include "signorini/problem/island.hpp"

#include <algorithm>

namespace signorini {

std::vector<Island> find_islands(const ContactProblem& problem) {
  const std::vector<int> labels = problem.delassus().islands(problem.sets());
  const int count = labels.empty() ? 0 : 1 + *std::max_element(labels.begin(), labels.end());
  std::vector<Island> islands(static_cast<std::size_t>(count));
  if (count <= 1) return islands;

  std::vector<ConstraintSets> sets(islands.size());
  for (Index i = 0; i < problem.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets()[i];
    const auto label = static_cast<std::size_t>(labels[static_cast<std::size_t>(i)]);
    for (Index k = 0; k < set.size(); ++k) islands[label].rows.push_back(set.offset + k);
    sets[label].add(set);
  }
  for (std::size_t k = 0; k < islands.size(); ++k) {
    const std::vector<Index>& rows = islands[k].rows;
    Vector free_velocity(static_cast<Index>(rows.size())), compliance(free_velocity.size());
    for (std::size_t i = 0; i < rows.size(); ++i) {
      free_velocity[static_cast<Index>(i)] = problem.free_velocity()[rows[i]];
      compliance[static_cast<Index>(i)] = problem.compliance()[rows[i]];
    }
    islands[k].problem = std::make_shared<ContactProblem>(problem.delassus().restrict(rows), std::move(free_velocity),
                                                          std::move(sets[k]), std::move(compliance));
  }
  return islands;
}

}  // namespace signorini
