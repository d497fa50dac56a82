#pragma once

#include <array>

#include "signorini/types.hpp"

namespace signorini {

/// Ties the load of a moment to the normal impulse of its contact (docs/simulation.md, S16): add(row, column, value)
/// for each entry that w (load - r normal)^2 / 2 has in G. normal: row of the contact; first: of the moment's three,
/// the load last; nothing: which of the others no velocity moves, and get w so that G stays definite there.
template <typename Add>
void tie_load(Index normal, Index first, const std::array<bool, 2>& nothing, double w, double r, const Add& add) {
  const Index load = first + 2;
  add(load, load, w);
  for (Index k = 0; k < 2; ++k)
    if (nothing[static_cast<std::size_t>(k)]) add(first + k, first + k, w);
  add(normal, normal, w * r * r);
  add(load, normal, -w * r);
  add(normal, load, -w * r);
}

}  // namespace signorini
