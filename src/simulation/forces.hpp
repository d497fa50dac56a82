#pragma once

#include <vector>

#include "signorini/assembly/dynamics.hpp"

namespace signorini {

/// What acts on the joints besides contact, gravity and inertia (S2): springs, dampers, actuators, wrenches on bodies.
class Forces {
 public:
  explicit Forces(const World& world);

  bool has_activations() const { return !active_.empty(); }
  /// What drives each actuator: its control within bounds, or its activation.
  void set_input(const ConstVectorRef& control, const ConstVectorRef& activation, VectorRef input) const;
  /// activation <- after a time step under `control`, exactly.
  void advance_activation(const ConstVectorRef& control, double time_step, VectorRef activation) const;

  /// force += at the old velocity, with springs, dampers and gains taken at the end of the step: what depends on the
  /// new velocity is added to `implicit` (Dynamics::num_implicit() values). input: one value an actuator; null: no
  /// actuators. wrenches: 6 x bodies, as in Simulator::external_wrench(), or null. dynamics: updated at (q, v).
  void add(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v, const Vector* input,
           const Matrix* wrenches, double time_step, VectorRef force, VectorRef implicit) const;

 private:
  void add_joints(const ConstVectorRef& q, const ConstVectorRef& v, double time_step, VectorRef force,
                  VectorRef implicit) const;
  void add_tendons(const ConstVectorRef& q, const ConstVectorRef& v, double time_step, VectorRef force,
                   VectorRef implicit) const;
  void add_actuator(const Dynamics& dynamics, const Actuator& actuator, double input, const ConstVectorRef& q,
                    const ConstVectorRef& v, double time_step, VectorRef force, VectorRef implicit) const;
  /// J^T of a force at a point (world) and a moment, on a body.
  void add_wrench(const Dynamics& dynamics, int body, const Vector3& point, const Vector3& f, const Vector3& moment,
                  VectorRef force) const;

  const World& world_;
  std::vector<int> passive_joints_, passive_tendons_, carried_, active_;
};

}  // namespace signorini
