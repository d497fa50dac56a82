#include "signorini/problem/de_saxce.hpp"

#include "length.hpp"

namespace signorini {

void de_saxce_correction(const ConstraintSets& sets, Law law, const ConstVectorRef& velocity, VectorRef correction) {
  correction.setZero();
  if (law == Law::Ccp) return;
  for (const ConstraintSet& set : sets) {
    if (set.type != SetType::FrictionCone) continue;
    const double* v = velocity.data() + set.offset;
    correction[set.offset + 2] = set.friction * length(v[0], v[1]);
  }
}

void add_de_saxce_correction(const ConstraintSets& sets, Law law, VectorRef velocity) {
  if (law == Law::Ccp) return;
  for (const ConstraintSet& set : sets) {
    if (set.type != SetType::FrictionCone) continue;
    double* v = velocity.data() + set.offset;
    v[2] += set.friction * length(v[0], v[1]);
  }
}

}  // namespace signorini
