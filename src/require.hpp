#pragma once

#include <sstream>
#include <string>

#include "signorini/errors.hpp"

namespace signorini {

/// Raises InvalidInput "<field>: is <value>, must be <range>" unless allowed.
inline void require(bool allowed, const std::string& field, double value, const char* range) {
  if (allowed) return;
  std::ostringstream message;
  message << "is " << value << ", must be " << range;
  throw InvalidInput(field, message.str());
}

}  // namespace signorini
