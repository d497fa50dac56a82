#pragma once

#include <cmath>

#include "signorini/types.hpp"

namespace signorini {

/// Whether a sum of squares has lost nothing to the ends of the range of numbers. What has is for std::hypot, several
/// times slower than the root.
inline bool in_range(double square) { return square > 1e-250 && square < 1e250; }

/// sqrt(x^2 + y^2); 0 is the rule where nothing slips.
inline double length(double x, double y) {
  const double square = x * x + y * y;
  if (in_range(square)) return std::sqrt(square);
  return x == 0.0 && y == 0.0 ? 0.0 : std::hypot(x, y);
}

/// Of 3 values or 1.
inline double length(const double* x, Index n) {
  if (n == 1) return std::abs(x[0]);
  const double square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
  return in_range(square) ? std::sqrt(square) : std::hypot(std::hypot(x[0], x[1]), x[2]);
}

}  // namespace signorini
