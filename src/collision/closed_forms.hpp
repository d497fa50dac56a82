#pragma once

#include "manifold.hpp"
#include "signorini/model/placement.hpp"

namespace signorini {

/// Contacts that formulas give; each leaves no point where the shapes are more than `margin` apart. For the pairs of
/// the table in docs/collision.md; `half_space` and `sphere` are a in the result.
void half_space_against(const Placement& half_space, const Solid& b, const Placement& place_b, double margin, int& hint,
                        Manifold& out);
void sphere_against(double radius, const Vector3& centre, const Solid& b, const Placement& place_b, double margin,
                    Manifold& out);
void capsule_capsule(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b, double margin,
                     Manifold& out);

}  // namespace signorini
