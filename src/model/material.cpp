#include "signorini/model/material.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "require.hpp"

namespace signorini {

void Material::validate(const char* field) const {
  const auto check = [field](const char* name, double value, bool allowed, const char* range) {
    if (!allowed) require(false, std::string(field) + "." + name, value, range);
  };
  check("friction", friction, friction >= 0.0 && friction <= 1e6, "in [0, 1e6]");
  check("torsion", torsion, torsion >= 0.0 && torsion <= 1e6, "in [0, 1e6] m");
  check("rolling", rolling, rolling >= 0.0 && rolling <= 1e6, "in [0, 1e6] m");
  check("condim", condim, condim == 0 || condim == 1 || condim == 3 || condim == 4 || condim == 6,
        "1, 3, 4 or 6, or 0 for what the coefficients ask for");
  check("restitution", restitution, restitution >= 0.0 && restitution <= 1.0, "in [0, 1]");
  check("stiffness", stiffness, stiffness > 0.0, "> 0 N/m, or infinite for rigid");
  check("damping", damping, damping >= 0.0 && std::isfinite(damping), "finite and >= 0 N s/m");
}

Material as_in_contact(Material m) {
  if (m.condim == 0) m.condim = m.rolling > 0.0 ? 6 : m.torsion > 0.0 ? 4 : 3;
  if (m.condim < 3) m.friction = 0.0;
  if (m.condim < 4) m.torsion = 0.0;
  if (m.condim < 6) m.rolling = 0.0;
  return m;
}

Material mix(const Material& a, const Material& b) {
  if (a.priority != b.priority) return as_in_contact(a.priority > b.priority ? a : b);
  Material m;
  const bool maximum = a.friction_mix == FrictionMix::Maximum && b.friction_mix == FrictionMix::Maximum;
  m.friction_mix = maximum ? FrictionMix::Maximum : FrictionMix::Geometric;
  m.condim = std::max(as_in_contact(a).condim, as_in_contact(b).condim);
  m.priority = a.priority;
  if (maximum)
    m.friction = std::max(a.friction, b.friction);
  else
    m.friction = a.friction == b.friction ? a.friction : std::sqrt(a.friction * b.friction);
  m.torsion = std::max(a.torsion, b.torsion);
  m.rolling = std::max(a.rolling, b.rolling);
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
  return as_in_contact(m);
}

}  // namespace signorini
