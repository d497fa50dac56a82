#include "signorini/model/material.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>

#include "signorini/errors.hpp"

namespace signorini {

void Material::validate(const char* field) const {
  const auto check = [field](const char* name, double value, bool allowed, const char* range) {
    if (allowed) return;
    std::ostringstream message;
    message << "is " << value << ", must be " << range;
    throw InvalidInput(std::string(field) + "." + name, message.str());
  };
  check("friction", friction, friction >= 0.0 && friction <= 1e6, "in [0, 1e6]");
  check("restitution", restitution, restitution >= 0.0 && restitution <= 1.0, "in [0, 1]");
  check("stiffness", stiffness, stiffness > 0.0, "> 0 N/m, or infinite for rigid");
  check("damping", damping, damping >= 0.0 && std::isfinite(damping), "finite and >= 0 N s/m");
}

Material mix(const Material& a, const Material& b) {
  if (a.priority != b.priority) {
    Material m = a.priority > b.priority ? a : b;
    if (m.frictionless) m.friction = 0.0;
    return m;
  }
  Material m;
  const bool maximum = a.friction_mix == FrictionMix::Maximum && b.friction_mix == FrictionMix::Maximum;
  m.friction_mix = maximum ? FrictionMix::Maximum : FrictionMix::Geometric;
  m.frictionless = a.frictionless && b.frictionless;
  m.priority = a.priority;
  if (m.frictionless)
    m.friction = 0.0;
  else if (maximum)
    m.friction = std::max(a.friction, b.friction);
  else
    m.friction = a.friction == b.friction ? a.friction : std::sqrt(a.friction * b.friction);
  m.restitution = std::max(a.restitution, b.restitution);
  if (std::isinf(a.stiffness)) {
    m.stiffness = b.stiffness, m.damping = b.damping;
  } else if (std::isinf(b.stiffness)) {
    m.stiffness = a.stiffness, m.damping = a.damping;
  } else {
    const double sum = a.stiffness + b.stiffness;
    m.stiffness = a.stiffness * b.stiffness / sum;
    m.damping = (b.stiffness * a.damping + a.stiffness * b.damping) / sum;
  }
  return m;
}

}  // namespace signorini
