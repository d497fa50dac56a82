#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "signorini/simulation/simulator.hpp"
#include "signorini/solver/inverse.hpp"

namespace signorini {

/// What a wanted motion takes.
struct InverseDynamicsResult {
  /// Of the contact impulses. Solved; Infeasible: no impulse allows this motion; MaxIterations; Invalid. Of the closest
  /// motion also what the contact solver says. Numbers are filled in all cases.
  Status status = Status::Invalid;
  double residual = 0.0;  ///< InverseSolution::residual [m/s, rad/s]
  /// The same over the largest speed in sight: of contacts, or of a fall in one step. Within the tolerance when solved,
  /// but for a step of `simulator`, certified otherwise.
  double relative = 0.0;
  int iterations = 0;      ///< proximal steps
  Vector force;            ///< nv, generalised, for the step: J^T impulse / time_step is not in it [N, N m]
  Vector v_next;           ///< nv, the motion that this is for: the wanted one, or the closest feasible
  Vector contact_impulse;  ///< 3 a contact point, in its frame [N s]
};

/// Inverse dynamics of the very step that Simulator makes (docs/simulation.md, S11 to S14; Carpentier et al. 2024,
/// section IV): which generalised force and which contact impulses lead from (q, v) to v_next? Contacts, limits, joint
/// friction and equalities push by wrenches on the bodies, in one sweep of the recursive Newton-Euler algorithm: no
/// Jacobian, no mass matrix. Not thread-safe; may share a world.
class InverseDynamics {
 public:
  /// settings: of the step to invert; its solver is used for the closest motion. The law is inverse.law.
  explicit InverseDynamics(std::shared_ptr<const World> world, const SimulatorSettings& settings = {},
                           const InverseSettings& inverse = {});
  ~InverseDynamics();
  InverseDynamics(InverseDynamics&&) noexcept;

  const World& world() const;
  /// Velocities that have an actuator; without any actuator in the world, all but those of free joints.
  static std::vector<std::uint8_t> actuated(const World& world);

  /// Where the bodies are, and the contact points found there; or given: which is what the timings of others leave out.
  /// Raises InvalidInput when q has the wrong size, is not finite or has a quaternion of length 0.
  void set_configuration(const ConstVectorRef& q);
  void set_configuration(const ConstVectorRef& q, const std::vector<ContactPoint>& points);
  const std::vector<ContactPoint>& points() const;

  struct Input {
    Vector v, v_next;        ///< nv; velocities as Simulator::v() has them before and after the step
    Vector control;          ///< of actuators that act as in the step; empty: none do, their work is in `force`
    Matrix external_wrench;  ///< as Simulator::external_wrench(); empty: none
    Vector impulse_guess;    ///< 3 a point, in contact_frame(normal) [N s]; empty: 0
    Vector moment_guess;     ///< likewise, of torsion and rolling [N m s]
    const Simulator* simulator = nullptr;  ///< its last step's impulses as guess, from this configuration; or null
    bool closest = false;                ///< find the closest motion that needs no force at unactuated velocities (S14)
    std::vector<std::uint8_t> actuated;  ///< nv; empty: actuated(world)
  };
  /// At the configuration set before. Raises InvalidInput naming the field, the value and the allowed range.
  const InverseDynamicsResult& solve(const Input& input);
  /// The contacts of the last solve; none after set_configuration().
  std::vector<Contact> contacts() const;
  /// The impulses of the last solve, of all constraints: contacts first, then limits, joint friction, equalities.
  ConstVectorRef impulse() const;
  const Assembler& assembler() const;
  /// What the last residual is of, in words; empty when it is 0.
  std::string worst() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace signorini
