#pragma once

#include <Eigen/Core>

namespace signorini {

using Vector3 = Eigen::Vector3d;
using Matrix3 = Eigen::Matrix3d;

/// A rigid placement: x_outer = rotation x_inner + translation.
struct Placement {
  Matrix3 rotation = Matrix3::Identity();
  Vector3 translation = Vector3::Zero();  ///< [m]

  Vector3 operator*(const Vector3& point) const { return rotation * point + translation; }
  Placement operator*(const Placement& inner) const {
    return {rotation * inner.rotation, rotation * inner.translation + translation};
  }
  Placement inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation)}; }
};

}  // namespace signorini
