#include "forces.hpp"

#include <algorithm>
#include <cmath>

#include "model/world_impl.hpp"

namespace signorini {
namespace {

double rate_of(const std::vector<World::Impl::Pull>& pulls, const ConstVectorRef& v) {
  double rate = 0.0;
  for (const auto& pull : pulls) rate += pull.coefficient * v[pull.v];
  return rate;
}

void pull(const std::vector<World::Impl::Pull>& pulls, double tension, VectorRef force) {
  for (const auto& pull : pulls) force[pull.v] += pull.coefficient * tension;
}

}  // namespace

Forces::Forces(const World& world) : world_(world) {
  const auto list = [](auto& elements, auto&& wanted, std::vector<int>& found) {
    for (std::size_t i = 0; i < elements.size(); ++i)
      if (wanted(elements[i])) found.push_back(static_cast<int>(i));
  };
  const auto resists = [](const auto& x) { return x.damping > 0.0 || x.stiffness > 0.0; };
  list(world.joints(), resists, passive_joints_);
  list(world.tendons(), resists, passive_tendons_);
  list(world.bodies(), [](const Body& body) { return body.gravity_compensation != 0.0; }, carried_);
  list(world.actuators(), [](const Actuator& a) { return a.activation != Activation::None; }, active_);
}

void Forces::set_input(const ConstVectorRef& control, const ConstVectorRef& activation, VectorRef input) const {
  for (std::size_t i = 0; i < world_.actuators().size(); ++i) {
    const Actuator& a = world_.actuators()[i];
    const auto at = static_cast<Index>(i);
    input[at] = std::clamp(control[at], a.control_lower, a.control_upper);
    if (a.activation != Activation::None)
      input[at] = std::clamp(activation[at], a.activation_lower, a.activation_upper);
  }
}

void Forces::advance_activation(const ConstVectorRef& control, double dt, VectorRef activation) const {
  for (const int i : active_) {
    const Actuator& a = world_.actuators()[static_cast<std::size_t>(i)];
    const double u = std::clamp(control[i], a.control_lower, a.control_upper);
    double& x = activation[i];
    if (a.activation == Activation::Integrator)
      x += dt * u;
    else
      x += (u - x) * -std::expm1(-dt / a.time_constant);
    x = std::clamp(x, a.activation_lower, a.activation_upper);
  }
}

void Forces::add(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v, const Vector* input,
                 const Matrix* wrenches, double dt, VectorRef force, VectorRef implicit) const {
  add_joints(q, v, dt, force, implicit);
  add_tendons(q, v, dt, force, implicit);
  for (std::size_t i = 0; input && i < world_.actuators().size(); ++i)
    add_actuator(dynamics, world_.actuators()[i], (*input)[static_cast<Index>(i)], q, v, dt, force, implicit);
  for (const int b : carried_) {
    const Body& body = world_.bodies()[static_cast<std::size_t>(b)];
    const Vector3 center = dynamics.frames()[static_cast<std::size_t>(body.frame)] * (body.in_frame * body.center);
    const Vector3 lift = -body.gravity_compensation * body.mass * world_.gravity();
    add_wrench(dynamics, b, center, lift, Vector3::Zero(), force);
  }
  if (!wrenches || wrenches->isZero(0.0)) return;
  for (std::size_t b = 1; b < world_.bodies().size(); ++b) {
    const auto given = wrenches->col(static_cast<Index>(b));
    if (given.isZero(0.0)) continue;
    const Body& body = world_.bodies()[b];
    const Vector3 point = dynamics.frames()[static_cast<std::size_t>(body.frame)] * body.in_frame.translation;
    add_wrench(dynamics, static_cast<int>(b), point, given.head<3>(), given.tail<3>(), force);
  }
}

void Forces::add_joints(const ConstVectorRef& q, const ConstVectorRef& v, double dt, VectorRef force,
                        VectorRef implicit) const {
  for (const int j : passive_joints_) {
    const Joint& joint = world_.joints()[static_cast<std::size_t>(j)];
    if (joint.stiffness > 0.0) force[joint.v_index] -= joint.stiffness * (q[joint.q_index] - joint.spring_reference);
    const double resistance = joint.damping + dt * joint.stiffness;
    for (Index k = joint.v_index; k < joint.v_index + joint.num_v(); ++k) {
      force[k] -= resistance * v[k];
      implicit[k] += dt * resistance;
    }
  }
}

void Forces::add_tendons(const ConstVectorRef& q, const ConstVectorRef& v, double dt, VectorRef force,
                         VectorRef implicit) const {
  for (const int t : passive_tendons_) {
    const Tendon& tendon = world_.tendons()[static_cast<std::size_t>(t)];
    const auto& pulls = world_.impl().tendon_pulls[static_cast<std::size_t>(t)];
    const double length = tendon_length(world_, tendon, q);
    const double stretch = length - std::clamp(length, tendon.spring_lower, tendon.spring_upper);
    const double stiffness = stretch != 0.0 || tendon.spring_lower == tendon.spring_upper ? tendon.stiffness : 0.0;
    const double resistance = tendon.damping + dt * stiffness;
    pull(pulls, -stiffness * stretch - resistance * rate_of(pulls, v), force);
    implicit[world_.num_v() + t] += dt * resistance;
  }
}

void Forces::add_actuator(const Dynamics& dynamics, const Actuator& a, double input, const ConstVectorRef& q,
                          const ConstVectorRef& v, double dt, VectorRef force, VectorRef implicit) const {
  double length = 0.0, rate = 0.0;
  Index at = -1;
  if (a.tendon >= 0) {
    length = a.gear * tendon_length(world_, world_.tendons()[static_cast<std::size_t>(a.tendon)], q);
    rate = a.gear * rate_of(world_.impl().tendon_pulls[static_cast<std::size_t>(a.tendon)], v);
  } else if (a.joint >= 0) {
    const Joint& joint = world_.joints()[static_cast<std::size_t>(a.joint)];
    at = joint.v_index + a.component;
    if (joint.num_v() == 1) length = a.gear * q[joint.q_index];
    rate = a.gear * v[at];
  }
  const double effort =
      (a.gain[0] + a.gain[1] * length + a.gain[2] * rate) * input + a.bias[0] + a.bias[1] * length + a.bias[2] * rate;
  const double clipped = std::clamp(effort, a.force_lower, a.force_upper);
  // The effort holds the damping at the old velocity already; what is left is its change over the step. Only what
  // resists is implicit, and a clipped drive does not depend on v.
  const double stiffness = std::max(0.0, -(a.gain[1] * input + a.bias[1]));
  const double damping = std::max(0.0, -(a.gain[2] * input + a.bias[2]));
  const bool resists = clipped == effort && (stiffness > 0.0 || damping > 0.0);
  const double tension = a.gear * (resists ? clipped - dt * stiffness * rate : clipped);
  const double resistance = resists ? dt * a.gear * a.gear * (damping + dt * stiffness) : 0.0;
  if (a.tendon >= 0) {
    pull(world_.impl().tendon_pulls[static_cast<std::size_t>(a.tendon)], tension, force);
    implicit[world_.num_v() + a.tendon] += resistance;
  } else if (a.joint >= 0) {
    force[at] += tension;
    implicit[at] += resistance;
  } else {
    const Body& body = world_.bodies()[static_cast<std::size_t>(a.body)];
    const Placement place = dynamics.frames()[static_cast<std::size_t>(body.frame)] * body.in_frame * a.placement;
    const Vector3 f(a.wrench[0], a.wrench[1], a.wrench[2]), moment(a.wrench[3], a.wrench[4], a.wrench[5]);
    add_wrench(dynamics, a.body, place.translation, tension * (place.rotation * f), tension * (place.rotation * moment),
               force);
  }
}

void Forces::add_wrench(const Dynamics& dynamics, int b, const Vector3& point, const Vector3& f, const Vector3& moment,
                        VectorRef force) const {
  const Body& body = world_.bodies()[static_cast<std::size_t>(b)];
  const Placement& frame = dynamics.frames()[static_cast<std::size_t>(body.frame)];
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

}  // namespace signorini
