#pragma once

#include <stdexcept>
#include <string>

namespace signorini {

/// Bad input, refused at the door. The message names the field, the value and the allowed range.
class InvalidInput : public std::invalid_argument {
 public:
  InvalidInput(const std::string& field, const std::string& message)
      : std::invalid_argument(field + ": " + message), field_(field) {}
  const std::string& field() const { return field_; }

 private:
  std::string field_;
};

}  // namespace signorini
