#pragma once

#include <cmath>
#include <cstdlib>
#include <limits>
#include <sstream>
#include <string>
#include <type_traits>

#include "signorini/errors.hpp"
#include "signorini/types.hpp"

namespace signorini {

/// A number in as many digits as tell it from its neighbours, six or more.
inline std::string in_full(double value) {
  std::string text;
  for (int digits = 6; digits <= std::numeric_limits<double>::max_digits10; ++digits) {
    std::ostringstream out;
    out.precision(digits);
    out << value;
    text = out.str();
    if (std::strtod(text.c_str(), nullptr) == value) break;
  }
  return text;
}

template <typename Integer, typename = std::enable_if_t<std::is_integral_v<Integer>>>
std::string in_full(Integer value) {
  return std::to_string(value);
}

/// Raises InvalidInput "<field>: is <value>, must be <range>" unless allowed.
template <typename Field, typename Value>
void require(bool allowed, const Field& field, Value value, const char* range) {
  if (!allowed) throw InvalidInput(field, "is " + in_full(value) + ", must be " + range);
}

inline void require_size(const char* field, Index size, Index wanted, bool may_be_empty = false) {
  if (size == wanted || (may_be_empty && size == 0)) return;
  throw InvalidInput(field, "has " + std::to_string(size) + " values, must have " + std::to_string(wanted));
}

/// Whether the sum of all |values| is at most 1e100: then each of them is a number, and as small.
inline bool sum_is_bounded(const double* values, Index count) {
  double sums[4] = {0.0, 0.0, 0.0, 0.0};
  Index k = 0;
  for (; k + 4 <= count; k += 4)
    for (Index j = 0; j < 4; ++j) sums[j] += std::abs(values[k + j]);
  for (; k < count; ++k) sums[0] += std::abs(values[k]);
  return sums[0] + sums[1] + sums[2] + sums[3] <= 1e100;
}

/// Raises InvalidInput "<field>[i]: ..." unless all values are finite and within +-1e100.
inline void require_finite(const char* field, const ConstVectorRef& values) {
  if (sum_is_bounded(values.data(), values.size())) return;
  for (Index i = 0; i < values.size(); ++i)
    if (!(std::abs(values[i]) <= 1e100))
      require(false, std::string(field) + "[" + std::to_string(i) + "]", values[i], "within +-1e100");
}

/// The same of one entry of a matrix: "<field>[row, column]: ...".
inline void require_finite(const char* field, Index row, Index column, double value) {
  if (!(std::abs(value) <= 1e100))
    require(false, std::string(field) + "[" + std::to_string(row) + ", " + std::to_string(column) + "]", value,
            "within +-1e100");
}

inline void require_finite(const char* field, const SparseMatrix& matrix) {
  for (Index c = 0; c < matrix.outerSize(); ++c)
    for (SparseMatrix::InnerIterator it(matrix, c); it; ++it) require_finite(field, it.row(), c, it.value());
}

}  // namespace signorini
