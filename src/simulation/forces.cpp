#include "forces.hpp"

#include <algorithm>

namespace signorini {

Forces::Forces(const World& world) : world_(world) {
  for (std::size_t j = 0; j < world.joints().size(); ++j) {
    const Joint& joint = world.joints()[j];
    if (joint.damping > 0.0 || joint.stiffness > 0.0) passive_joints_.push_back(static_cast<int>(j));
  }
}

void Forces::add(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v, const Vector* control,
                 const Matrix* wrenches, double dt, VectorRef force, VectorRef implicit) const {
  const auto add_implicit = [&](Index at, double stiffness, double damping) {
    const double d = damping + dt * stiffness;
    force[at] -= d * v[at];
    implicit[at] += dt * d;
  };
  for (const int j : passive_joints_) {
    const Joint& joint = world_.joints()[static_cast<std::size_t>(j)];
    if (joint.stiffness > 0.0) force[joint.v_index] -= joint.stiffness * (q[joint.q_index] - joint.spring_reference);
    for (Index k = 0; k < joint.num_v(); ++k) add_implicit(joint.v_index + k, joint.stiffness, joint.damping);
  }
  for (std::size_t i = 0; control && i < world_.actuators().size(); ++i) {
    const Actuator& a = world_.actuators()[i];
    const Joint& joint = world_.joints()[static_cast<std::size_t>(a.joint)];
    const Index at = joint.v_index + a.component;
    const double u = std::clamp((*control)[static_cast<Index>(i)], a.control_lower, a.control_upper);
    double effort = u;
    if (a.type == ActuatorType::Position) effort = a.kp * (u - a.gear * q[joint.q_index]) - a.kv * a.gear * v[at];
    if (a.type == ActuatorType::Velocity) effort = a.kv * (u - a.gear * v[at]);
    const double clipped = std::clamp(effort, a.force_lower, a.force_upper);
    force[at] += a.gear * clipped;
    if (a.type == ActuatorType::Motor || clipped != effort) continue;  // a saturated drive does not depend on v
    // effort holds the damping at the old velocity already; what is left is its change over the step.
    const double gear2 = a.gear * a.gear;
    const double stiffness = a.type == ActuatorType::Position ? gear2 * a.kp : 0.0;
    force[at] -= dt * stiffness * v[at];
    implicit[at] += dt * (gear2 * a.kv + dt * stiffness);
  }
  if (wrenches && !wrenches->isZero(0.0)) add_wrenches(dynamics, *wrenches, force);
}

void Forces::add_wrenches(const Dynamics& dynamics, const Matrix& wrenches, VectorRef force) const {
  for (std::size_t b = 1; b < world_.bodies().size(); ++b) {
    const auto given = wrenches.col(static_cast<Index>(b));
    if (given.isZero(0.0)) continue;
    const Body& body = world_.bodies()[b];
    const Placement& frame = dynamics.frames()[static_cast<std::size_t>(body.frame)];
    const Vector3 f = given.head<3>(), moment = given.tail<3>();
    const Vector3 point = frame * body.in_frame.translation;
    const int free = dynamics.free_body(body.frame);
    if (free >= 0) {
      const Index at = dynamics.free_v(free);
      const Vector3 about = moment + (point - frame.translation).cross(f);
      force.segment<3>(at) += frame.rotation.transpose() * f;
      force.segment<3>(at + 3) += frame.rotation.transpose() * about;
    } else if (body.frame > 0) {
      const Vector3 about = moment + point.cross(f);
      for (const int k : dynamics.support(body.frame)) {
        const double* m = dynamics.motion(k);
        force[k] += m[0] * f[0] + m[1] * f[1] + m[2] * f[2] + m[3] * about[0] + m[4] * about[1] + m[5] * about[2];
      }
    }
  }
}

}  // namespace signorini
