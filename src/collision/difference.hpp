#pragma once

#include "signorini/model/placement.hpp"
#include "solid.hpp"

namespace signorini {

/// The cores of two shapes in the frame of the first, seen through support functions.
struct Difference {
  const Solid* a = nullptr;
  const Solid* b = nullptr;
  Matrix3 rotation = Matrix3::Identity(), inverse_rotation = Matrix3::Identity();  ///< of b in the frame of a
  Vector3 translation = Vector3::Zero();

  void set(const Solid& solid_a, const Placement& place_a, const Solid& solid_b, const Placement& place_b) {
    a = &solid_a, b = &solid_b;
    rotation = place_a.rotation.transpose() * place_b.rotation;
    inverse_rotation = rotation.transpose();
    translation = place_a.rotation.transpose() * (place_b.translation - place_a.translation);
  }
  Vector3 support_a(const Vector3& direction, int& hint) const { return a->support(direction, hint); }
  Vector3 support_b(const Vector3& direction, int& hint) const {
    return rotation * b->support(inverse_rotation * direction, hint) + translation;
  }
};

}  // namespace signorini
