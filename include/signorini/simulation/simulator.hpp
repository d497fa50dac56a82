#pragma once

#include <memory>
#include <string>
#include <vector>

#include "signorini/assembly/assembler.hpp"
#include "signorini/collision/detector.hpp"
#include "signorini/solver/solve.hpp"

namespace signorini {

struct SimulatorSettings {
  double time_step = 1e-3;  ///< [s], in [1e-6, 0.1]
  Settings solver;          ///< law, method, tolerance
  /// Share of an overlap that a step of 1 ms or more takes back, less in shorter ones in proportion (S6), in [0, 1];
  /// rigid contact.
  double baumgarte = 0.2;
  double max_correction_speed = 1.0;    ///< of that, and of loops that come apart [m/s, rad/s]
  double restitution_threshold = 0.05;  ///< approach speed below which nothing bounces [m/s]
  /// Points with a gap up to this, or up to 0.1 um, are part of the problem [m]; < 0: 2 mm, and 3 m/s times the time
  /// step. What may come nearer by more than either in a step is swept.
  double contact_margin = -1.0;

  /// Raises InvalidInput naming the field, the value and the allowed range.
  void validate() const;
};

enum class ContactMode : std::uint8_t { Open, Stick, Slide };

/// A contact of the last step.
struct Contact {
  int geometry_a = 0, geometry_b = 0;
  Vector3 position = Vector3::Zero();   ///< world [m], at the start of the step
  Matrix3 frame = Matrix3::Identity();  ///< columns t1, t2, n in the world; n from a to b
  double distance = 0.0;                ///< at the start of the step [m]
  Vector3 force = Vector3::Zero();      ///< on b, (t1, t2, n) [N], mean over the step
  Vector3 moment = Vector3::Zero();     ///< on b about the contact's position, of torsion and rolling, likewise [N m]
  Vector3 velocity = Vector3::Zero();   ///< of b relative to a at the end of the step, (t1, t2, n) [m/s]
  ContactMode mode = ContactMode::Open;
  std::uint64_t id = 0;
};

/// What the last step did, and counts since the start.
struct StepReport {
  Status status = Status::Solved;
  SolverType solver = SolverType::Auto;
  Residual residual;
  int iterations = 0, factorizations = 0;  ///< of all rounds of the step (S18)
  Index num_contacts = 0;                  ///< contact points within the margin
  Index num_constraints = 0;               ///< sets in the problem: of contacts and limits, those that may act
  double deepest_overlap = 0.0;            ///< of a contact at the start of the step [m], >= 0
  std::uint64_t steps = 0;                 ///< since the simulator was made or reset
  std::uint64_t unsolved = 0;              ///< of these
};

/// Two geometries near each other, and their smallest distance [m].
struct TouchingPair {
  int geometry_a = 0, geometry_b = 0;
  double distance = 0.0;
};

/// The pairs of geometries that may touch and are no further apart than margin [m] at q.
std::vector<TouchingPair> touching_pairs(const std::shared_ptr<const World>& world, const ConstVectorRef& q,
                                         double margin);

/// Steps one world. One step: placements, mass matrix, contacts -> velocity without contact -> contact problem ->
/// impulses
/// -> velocity -> position (docs/simulation.md). Not thread-safe; many simulators may share a world.
class Simulator {
 public:
  Simulator(std::shared_ptr<const World> world, const SimulatorSettings& settings = {});
  ~Simulator();
  Simulator(Simulator&&) noexcept;

  const World& world() const;
  std::shared_ptr<const World> world_ptr() const;
  const SimulatorSettings& settings() const;

  // Inputs; written by the caller between steps.
  Vector& q();  ///< nq values
  Vector& v();  ///< nv values
  const Vector& v() const;
  double& time();           ///< [s]
  Vector& control();        ///< one value an actuator
  Vector& activation();     ///< likewise, of those that have one; a part of the state
  Vector& applied_force();  ///< nv values, generalised [N, N m], added to everything else
  /// Wrench on each body: force, then moment about the body frame's origin, both in world axes [N, N m]. 6 x bodies.
  Matrix& external_wrench();

  /// One time step. Raises InvalidInput when the state, the control or a force is not finite, and leaves the state as
  /// it was. A contact problem that is not solved is stepped with the best impulse found and counted in the report; an
  /// impulse that is not finite is replaced by none.
  void step();

  /// The next step starts from impulses found elsewhere at this configuration, by inverse dynamics say, and not from
  /// the last step's: a rigid problem may have several solutions, and this is where one is chosen. Without effect when
  /// that step has other contacts. sets, impulse: of the assembler there.
  void warm_start(const std::vector<Assembler::Set>& sets, const ConstVectorRef& impulse);

  /// Of the last step. Contacts and problem are empty before the first one and after reset() and restore().
  const StepReport& report() const;
  std::vector<Contact> contacts() const;
  /// Force of geometries on body b by those on body a, world axes [N].
  Vector3 contact_force(int body_a, int body_b) const;
  const Assembler& assembler() const;
  const std::vector<ContactPoint>& points() const;  ///< of the assembler's contacts
  /// Whether that step began at q and v.
  bool stepped_from(const ConstVectorRef& q, const ConstVectorRef& v) const;
  /// Of the last step, with all its sets; and the impulse that solved it [N s].
  ContactProblem contact_problem();
  ConstVectorRef impulse() const;

  double kinetic_energy();
  double potential_energy();
  Eigen::Matrix<double, 6, 1> momentum();
  const std::vector<Placement>& frames();  ///< placements at the present q
  Matrix mass_matrix();

  /// Back to the world's initial configuration, at rest, time 0; forgets warm starts.
  void reset();
  /// Everything that the next step depends on. restore() of these bytes, in a simulator of an equal world and equal
  /// settings, goes on bit for bit. Raises InvalidInput("bytes", ...) on anything else and leaves the state: a checksum
  /// is among the bytes.
  std::string save() const;
  void restore(const std::string& bytes);
  /// 64-bit FNV-1a hash of q, v and time.
  std::uint64_t state_hash() const;

 private:
  friend class InverseDynamics;
  /// The velocity that a step from q and v finds, in the frames held still, with all force and what is implicit (S2)
  /// given; started from impulses as by warm_start(). Leaves points() and assembler() as that step does, and the rest
  /// as after reset().
  const Vector& rehearse(const ConstVectorRef& q, const ConstVectorRef& v, const Vector& force, const Vector& implicit,
                         const std::vector<Assembler::Set>& sets, const ConstVectorRef& impulse);

  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace signorini
