#pragma once

#include <vector>

#include "signorini/assembly/dynamics.hpp"

namespace signorini {

/// What acts on the joints besides contact, gravity and inertia (S2): springs, dampers, actuators, wrenches on bodies.
class Forces {
 public:
  explicit Forces(const World& world);

  /// force += at the old velocity, with springs, dampers and gains taken at the end of the step: what depends on the
  /// new velocity is added to `implicit`, the diagonal of M^ - M. control: one value an actuator; null: no actuators.
  /// wrenches: 6 x bodies, as in Simulator::external_wrench(), or null. dynamics: updated at (q, v).
  void add(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v, const Vector* control,
           const Matrix* wrenches, double time_step, VectorRef force, VectorRef implicit) const;

 private:
  void add_wrenches(const Dynamics& dynamics, const Matrix& wrenches, VectorRef force) const;

  const World& world_;
  std::vector<int> passive_joints_;
};

}  // namespace signorini
