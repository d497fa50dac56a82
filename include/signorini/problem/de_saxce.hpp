#pragma once

#include "signorini/problem/constraint_set.hpp"

namespace signorini {

/// correction = Gamma(velocity) = (0, 0, friction |velocity_T|) per friction cone, zero elsewhere and for Law::Ccp.
/// De Saxce and Feng 1998; docs/theory.md, (T5). correction must not be velocity.
void de_saxce_correction(const ConstraintSets& sets, Law law, const ConstVectorRef& velocity, VectorRef correction);

/// velocity += Gamma(velocity), in place.
void add_de_saxce_correction(const ConstraintSets& sets, Law law, VectorRef velocity);

}  // namespace signorini
