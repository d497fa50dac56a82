#include "signorini/delassus/delassus_operator.hpp"

namespace signorini {

void DelassusOperator::prepare_part(const ConstraintSets& sets, const std::vector<int>& part,
                                    const ConstraintSets& part_sets, const ConstVectorRef& scale,
                                    const ConstVectorRef& compliance, std::unique_ptr<ScaledDelassus>& system) const {
  std::vector<Index> rows;
  for (const int i : part)
    for (Index k = 0; k < sets[i].size(); ++k) rows.push_back(sets[i].offset + k);
  restrict(rows)->prepare(part_sets, scale, compliance, system);
}

}  // namespace signorini
