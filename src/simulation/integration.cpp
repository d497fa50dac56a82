#include "integration.hpp"

#include <Eigen/Geometry>
#include <algorithm>
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

constexpr int kFixedPoint = 3, kNewton = 12;  // iterations
constexpr double kSettled = 1e-14;            // of the angular velocity
// [rad] of a part of a step: Newton's method finds it for any inertia. No round number: spins may be multiples of
// those, and rounding would decide on the parts.
constexpr double kLongestTurn = 0.2971828;
constexpr int kMostParts = 64;
constexpr double kNoMethod = 100.0;  // [rad] of a part: numbers would overflow

Matrix3 cross_matrix(const Vector3& x) {
  Matrix3 matrix;
  matrix << 0.0, -x[2], x[1], x[2], 0.0, -x[0], -x[1], x[0], 0.0;
  return matrix;
}

/// d exp(-x) p = (exp(-x) p) x (J dx).
Matrix3 right_jacobian(const Vector3& x) {
  const Matrix3 cross = cross_matrix(x);
  const double square = x.squaredNorm(), angle = std::sqrt(square);
  const double first = angle < 1e-3 ? 0.5 - square / 24.0 : (1.0 - std::cos(angle)) / square;
  const double second = angle < 1e-3 ? (1.0 - square / 20.0) / 6.0 : (angle - std::sin(angle)) / (square * angle);
  return Matrix3::Identity() - first * cross + second * cross * cross;
}

/// The angular velocity w' after dt by the midpoint rule, I w' = exp(-dt w_m) I w, w_m = (w + w') / 2 (S5). Fixed-point
/// iterations do where a body turns little in a step; of thin bodies they diverge, where Newton's method does not.
Vector3 midpoint(const FreeBody& body, double dt, const Vector3& w, const Vector3& momentum) {
  const double settled = kSettled * w.norm();
  Vector3 next = w, last;
  for (int k = 0; k < kFixedPoint; ++k) {
    last = next;
    next = body.inverse_inertia * (turn_by(-0.5 * dt * (w + next)) * momentum);
    if (!((next - last).norm() > settled)) return next;
  }
  const Vector3 fallback = next;
  if (!(std::abs(dt) * w.norm() <= kNoMethod)) return fallback;
  if (!((next - last).norm() < 1e-3 * w.norm())) next = w;
  for (int k = 0; k < kNewton; ++k) {
    const Vector3 turn = 0.5 * dt * (w + next), turned = turn_by(-turn) * momentum;
    const Matrix3 slope = body.inertia - 0.5 * dt * cross_matrix(turned) * right_jacobian(turn);
    const Vector3 change = slope.inverse() * (turned - body.inertia * next);
    next += change;
    if (!(change.norm() > settled)) break;
  }
  return next.allFinite() ? next : fallback;
}

int num_parts(double dt, const Vector3& w) {
  return static_cast<int>(std::clamp(std::ceil(dt * w.norm() / kLongestTurn), 1.0, static_cast<double>(kMostParts)));
}

/// The rotation vector of a turn next to another vector: of a turn by more than pi, too.
Vector3 rotation_vector_near(const Eigen::Quaterniond& turn, const Vector3& near) {
  const double sine = turn.vec().norm(), angle = 2.0 * std::atan2(sine, turn.w()), full = 2.0 * EIGEN_PI;
  const Vector3 axis = sine > 1e-12 ? Vector3(turn.vec() / sine) : Vector3(near.normalized());
  return (angle + full * std::round((near.dot(axis) - angle) / full)) * axis;
}

/// dt times the constant angular velocity that turns a free body as a step does, in its frame at the start.
Vector3 whole_turn(const FreeBody& body, double dt, const Vector3& angular) {
  const int parts = num_parts(dt, angular);
  const double part = dt / parts;
  Vector3 w = angular, momentum = body.inertia * angular, sum = Vector3::Zero();
  Eigen::Quaterniond all = Eigen::Quaterniond::Identity();
  for (int k = 0; k < parts; ++k) {
    const Vector3 turn = 0.5 * part * (w + midpoint(body, part, w, momentum));
    if (parts == 1) return turn;
    const Eigen::Quaterniond by = turn_by(turn);
    momentum = by.conjugate() * momentum;
    w = body.inverse_inertia * momentum;
    all = all * by;
    sum += turn;
  }
  return rotation_vector_near(all, sum);
}

/// Its turn, and the angular velocity after it.
std::pair<Eigen::Quaterniond, Vector3> free_turn(const FreeBody& body, double dt, const Vector3& angular) {
  const Eigen::Quaterniond by = turn_by(whole_turn(body, dt, angular));
  return {by, body.inverse_inertia * (by.conjugate() * (body.inertia * angular))};
}

/// The angular velocity before a step of so many parts.
Vector3 before_free_turn(const FreeBody& body, double dt, const Vector3& angular, int parts) {
  const double part = dt / parts;
  Vector3 w = angular, momentum = body.inertia * angular;
  for (int k = 0; k < parts; ++k) {
    momentum = turn_by(0.5 * part * (w + midpoint(body, -part, w, momentum))) * momentum;
    w = body.inverse_inertia * momentum;
  }
  return w;
}

/// The centre of mass moves straight.
void advance_free_body(const FreeBody& body, double dt, double share, VectorRef q, VectorRef v) {
  const Vector3 linear = v.segment<3>(body.v), angular = v.segment<3>(body.v + 3);
  // A share is one of the way that was swept, at a constant rate; on it (S5) keeps energy at the end alone.
  auto [by, next] = free_turn(body, share * dt, angular);
  if (share < 1.0) by = turn_by(share * whole_turn(body, dt, angular));
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
  return whole_turn(body, dt, angular) / dt;
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
    const Vector3 next = v.segment<3>(body.v + 3);  // at the end, in the frame there
    const Vector3 next_center = v.segment<3>(body.v) + next.cross(body.center);
    const double momentum = (body.inertia * next).norm();
    const int parts = num_parts(dt, next);  // of the step back; the step itself may have had others
    Vector3 angular = next;
    Eigen::Quaterniond by = Eigen::Quaterniond::Identity();
    bool found = false;
    for (int k = 0; k < 2 * parts && !found; ++k) {
      Vector3 after;
      angular = before_free_turn(body, dt, next, k % 2 == 0 ? parts - k / 2 : parts + (k + 1) / 2);
      std::tie(by, after) = free_turn(body, dt, angular);
      found = (body.inertia * (after - next)).norm() <= 1e-9 * momentum;  // rounding spins thin bodies about themselves
    }
    if (!found) return false;
    v.segment<3>(body.v + 3) = angular;
    v.segment<3>(body.v) = by * next_center - angular.cross(body.center);
  }
  return true;
}

}  // namespace signorini
