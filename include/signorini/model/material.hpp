#pragma once

#include <cstdint>
#include <limits>

namespace signorini {

/// Of two coefficients of friction.
enum class FrictionMix : std::uint8_t { Geometric, Maximum };

/// How a surface behaves in contact. Two materials make a contact's by mix().
struct Material {
  double friction = 0.8;     ///< Coulomb's coefficient, >= 0
  double restitution = 0.0;  ///< share of the approach speed that comes back, in [0, 1]
  /// Normal stiffness of a contact patch [N/m], shared equally by its points; infinite: rigid.
  double stiffness = std::numeric_limits<double>::infinity();
  double damping = 0.0;  ///< of the same patch [N s/m]; without effect when rigid
  /// Largest moment about the normal over the normal force [m], >= 0 (docs/simulation.md, S16).
  double torsion = 0.0;
  double rolling = 0.0;  ///< the same about the tangents
  FrictionMix friction_mix = FrictionMix::Geometric;
  /// What friction there is, as in MuJoCo: 1 none, 3 sliding, 4 torsion too, 6 rolling too; 0: what the coefficients
  /// ask for, 3 at least. Of two materials the larger counts, then both's coefficients.
  int condim = 0;
  int priority = 0;  ///< of two, the material with the higher one counts alone

  /// Raises InvalidInput naming `field`, the value and the allowed range.
  void validate(const char* field) const;
};

/// Of equal priority: friction sqrt(mu_a mu_b), or max(mu_a, mu_b) where both say Maximum; the larger torsion, rolling
/// and restitution; springs in series, 1/k = 1/k_a + 1/k_b, so that a rigid side leaves the other's stiffness as it is;
/// damping k (d_a / k_a + d_b / k_b) weighted by compliance: (k_b d_a + k_a d_b) / (k_a + k_b), the other's where one
/// is rigid.
Material mix(const Material& a, const Material& b);
/// Coefficients that condim leaves out are 0.
Material as_in_contact(Material material);

}  // namespace signorini
