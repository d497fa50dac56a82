#pragma once

#include <cmath>
#include <sstream>
#include <string>

#include "signorini/errors.hpp"
#include "signorini/types.hpp"

namespace signorini {

/// Raises InvalidInput "<field>: is <value>, must be <range>" unless allowed.
inline void require(bool allowed, const std::string& field, double value, const char* range) {
  if (allowed) return;
  std::ostringstream message;
  message << "is " << value << ", must be " << range;
  throw InvalidInput(field, message.str());
}

/// Raises InvalidInput "<field>[i]: ..." unless all values are finite and within +-1e100.
inline void require_finite(const char* field, const ConstVectorRef& values) {
  for (Index i = 0; i < values.size(); ++i)
    if (!(std::abs(values[i]) <= 1e100))
      require(false, std::string(field) + "[" + std::to_string(i) + "]", values[i], "within +-1e100");
}

}  // namespace signorini
