#include "integration.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <tuple>
#include <utility>

#include "model/world_impl.hpp"

namespace signorini {
namespace {

/// exp of half the rotation vector: the quaternion that turns by it.
Eigen::Quaterniond turn_by(const Vector3& rotation_vector) {
  const Vector3 half = 0.5 * rotation_vector;
  const double angle = half.norm();
  const double s = angle < 1e-4 ? 1.0 - angle * angle / 6.0 : std::sin(angle) / angle;
  return Eigen::Quaterniond(std::cos(angle), s * half[0], s * half[1], s * half[2]);
}

void turn(VectorRef q, Index at, const Eigen::Quaterniond& by) {
  Eigen::Quaterniond rotation(q[at + 3], q[at], q[at + 1], q[at + 2]);
  rotation = rotation * by;
  rotation.normalize();
  q[at] = rotation.x(), q[at + 1] = rotation.y(), q[at + 2] = rotation.z(), q[at + 3] = rotation.w();
}

/// The mean angular velocity w = (w0 + w1) / 2 of the midpoint rule, w1 = I^-1 exp(-dt w) I w0: keeps energy to O(dt^3)
/// and angular momentum I w0 exactly (S5).
inline Vector3 midpoint(const FreeBody& body, double dt, const Vector3& angular, const Vector3& momentum) {
  Vector3 mean = angular;
  for (int k = 0; k < 3; ++k) {
    const Vector3 next = body.inverse_inertia * (turn_by(-dt * mean) * momentum);
    mean = 0.5 * (angular + next);
  }
  return mean;
}

/// Its turn, and the angular velocity after it. share: of the turn that it takes.
std::pair<Eigen::Quaterniond, Vector3> midpoint_turn(const FreeBody& body, double dt, const Vector3& angular,
                                                     double share = 1.0) {
  const Vector3 momentum = body.inertia * angular;
  const Eigen::Quaterniond by = turn_by(share * dt * midpoint(body, dt, angular, momentum));
  return {by, body.inverse_inertia * (by.conjugate() * momentum)};
}

/// The centre of mass moves straight.
void advance_free_body(const FreeBody& body, double dt, double share, VectorRef q, VectorRef v) {
  const Vector3 linear = v.segment<3>(body.v), angular = v.segment<3>(body.v + 3);
  const auto [by, next] = midpoint_turn(body, dt, angular, share);
  const Vector3 center_velocity = linear + angular.cross(body.center);
  const Eigen::Quaterniond rotation(q[body.q + 6], q[body.q + 3], q[body.q + 4], q[body.q + 5]);
  const Vector3 moved = share * dt * center_velocity + body.center - by * body.center;
  q.segment<3>(body.q) += rotation * moved;
  turn(q, body.q + 3, by);
  v.segment<3>(body.v + 3) = next;
  v.segment<3>(body.v) = by.conjugate() * center_velocity - next.cross(body.center);
}

}  // namespace

Vector3 mean_angular_velocity(const FreeBody& body, double dt, const Vector3& angular) {
  return midpoint(body, dt, angular, body.inertia * angular);
}

void advance(const World& world, double dt, VectorRef q, VectorRef v, const std::vector<double>& shares) {
  const World::Impl& w = world.impl();
  for (const Joint& joint : w.joints) {
    const Index iq = joint.q_index, iv = joint.v_index;
    if (iv >= w.nv_articulated) break;  // free bodies come last
    if (joint.num_q() == 1) {
      q[iq] += dt * v[iv];
    } else if (joint.type == JointType::Ball) {
      turn(q, iq, turn_by(dt * v.segment<3>(iv)));
    } else {
      const Vector3 linear = v.segment<3>(iv);
      const Eigen::Quaterniond by = turn_by(dt * v.segment<3>(iv + 3));
      q.segment<3>(iq) += dt * (Eigen::Quaterniond(q[iq + 6], q[iq + 3], q[iq + 4], q[iq + 5]) * linear);
      turn(q, iq + 3, by);
      v.segment<3>(iv) = by.conjugate() * linear;
    }
  }
  std::size_t frame = shares.size() - w.free_bodies.size();
  for (const FreeBody& body : w.free_bodies) advance_free_body(body, dt, shares.empty() ? 1.0 : shares[frame++], q, v);
}

bool turn_back(const World& world, double dt, VectorRef v) {
  const World::Impl& w = world.impl();
  for (const Joint& joint : w.joints) {
    const Index at = joint.v_index;
    if (at >= w.nv_articulated) break;
    if (joint.type == JointType::Free)
      v.segment<3>(at) = turn_by(dt * v.segment<3>(at + 3)) * Vector3(v.segment<3>(at));
  }
  for (const FreeBody& body : w.free_bodies) {
    const Vector3 next = v.segment<3>(body.v + 3), momentum = body.inertia * next;  // at the end, in the frame there
    const Vector3 next_center = v.segment<3>(body.v) + next.cross(body.center);
    Vector3 angular = next;
    Eigen::Quaterniond by = Eigen::Quaterniond::Identity();
    bool found = false;
    for (int k = 0; k < 60 && !found; ++k) {
      Vector3 after;
      std::tie(by, after) = midpoint_turn(body, dt, angular);
      found = (after - next).norm() <= 1e-14 * next.norm();
      if (!found) angular = body.inverse_inertia * (by * momentum);
    }
    if (!found) {  // rounding may keep it from 1e-14
      const auto [last, after] = midpoint_turn(body, dt, angular);
      if (!((after - next).norm() <= 1e-11 * next.norm())) return false;
      by = last;
    }
    v.segment<3>(body.v + 3) = angular;
    v.segment<3>(body.v) = by * next_center - angular.cross(body.center);
  }
  return true;
}

}  // namespace signorini
