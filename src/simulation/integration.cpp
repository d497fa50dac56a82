#include "integration.hpp"

#include <Eigen/Geometry>
#include <cmath>

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

void advance_free_body(const FreeBody& body, double dt, VectorRef q, VectorRef v) {
  const Vector3 linear = v.segment<3>(body.v), angular = v.segment<3>(body.v + 3);
  // The turn of the midpoint rule: w = (w0 + w1) / 2 with w1 = I^-1 exp(-dt w) I w0 keeps energy to O(dt^3) and angular
  // momentum exactly. The centre of mass moves straight.
  const Vector3 momentum = body.inertia * angular;
  Vector3 mean = angular, next = angular;
  for (int k = 0; k < 3; ++k) {
    next = body.inverse_inertia * (turn_by(-dt * mean) * momentum);
    mean = 0.5 * (angular + next);
  }
  const Eigen::Quaterniond by = turn_by(dt * mean);
  next = body.inverse_inertia * (by.conjugate() * momentum);
  const Vector3 center_velocity = linear + angular.cross(body.center);
  const Eigen::Quaterniond rotation(q[body.q + 6], q[body.q + 3], q[body.q + 4], q[body.q + 5]);
  const Vector3 moved = dt * center_velocity + body.center - by * body.center;
  q.segment<3>(body.q) += rotation * moved;
  turn(q, body.q + 3, by);
  v.segment<3>(body.v + 3) = next;
  v.segment<3>(body.v) = by.conjugate() * center_velocity - next.cross(body.center);
}

}  // namespace

void advance(const World& world, double dt, VectorRef q, VectorRef v) {
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
  for (const FreeBody& body : w.free_bodies) advance_free_body(body, dt, q, v);
}

}  // namespace signorini
