#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "signorini/model/material.hpp"
#include "signorini/model/placement.hpp"
#include "signorini/model/shape.hpp"
#include "signorini/types.hpp"

namespace signorini {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Configuration and velocity values: Free 7 (position, quaternion x y z w) and 6 (linear, angular, both in the body
/// frame); Ball 4 and 3; Revolute and Prismatic 1 and 1.
enum class JointType : std::uint8_t { Free, Ball, Revolute, Prismatic };

struct Joint {
  std::string name;
  JointType type = JointType::Revolute;
  Vector3 axis = Vector3::UnitZ();   ///< Revolute, Prismatic: in the body frame; any length but 0
  Vector3 anchor = Vector3::Zero();  ///< Ball, Revolute: a point of the axis, in the body frame [m]
  double reference = 0.0;            ///< Revolute, Prismatic: value at which the body has its placement [rad, m]
  /// Revolute, Prismatic: limits [rad, m]. Ball: upper, the largest angle from where its body was placed [rad].
  double lower = -kInfinity, upper = kInfinity;
  double limit_stiffness = kInfinity;  ///< of a limit [N m/rad, N/m]; infinite: rigid
  double limit_damping = 0.0;          ///< of a limit [N m s/rad, N s/m]
  double armature = 0.0;               ///< inertia of the drive, added to the diagonal of M [kg m^2, kg]
  double damping = 0.0;                ///< viscous [N m s, N s/m]
  double friction = 0.0;               ///< dry: largest friction torque or force [N m, N]
  double stiffness = 0.0;              ///< spring towards spring_reference [N m/rad, N/m]; Revolute, Prismatic
  double spring_reference = 0.0;       ///< [rad, m]
  // Filled by WorldBuilder::build():
  int body = 0;                    ///< that the joint moves
  Index q_index = 0, v_index = 0;  ///< first entries in q and v

  Index num_q() const { return type == JointType::Free ? 7 : type == JointType::Ball ? 4 : 1; }
  Index num_v() const { return type == JointType::Free ? 6 : type == JointType::Ball ? 3 : 1; }
};

struct Body {
  std::string name;
  int parent = 0;                     ///< body; 0 is the world
  Placement placement;                ///< in the parent body, with all joints at their reference
  double mass = 0.0;                  ///< [kg]
  Vector3 center = Vector3::Zero();   ///< of mass, in the body frame [m]
  Matrix3 inertia = Matrix3::Zero();  ///< about the centre of mass, axes of the body frame [kg m^2]
  double gravity_compensation = 0.0;  ///< share of its weight that something else carries, at its centre of mass
  std::vector<Joint> joints;          ///< from the parent outwards; none: fixed to the parent
  // Filled by WorldBuilder::build():
  int frame = 0;       ///< what it moves with: 0 the world, else one frame a moving body
  Placement in_frame;  ///< of the body frame in `frame`
};

/// Why no body can have this mass [kg] and this symmetric inertia about its centre of mass [kg m^2]; "" when one can. A
/// point mass, a thin rod and a frame without mass are bodies. Principal moments may miss the triangle inequality by a
/// thousandth: files are written with few digits.
std::string inertia_fault(double mass, const Matrix3& inertia);

struct Geometry {
  std::string name;
  int body = 0;
  Shape shape;
  Placement placement;  ///< in the body frame
  Material material;
  std::uint32_t group = 1, mask = 1;  ///< two geometries may touch if (group_a & mask_b) | (group_b & mask_a)
};

/// Two geometries that may touch whatever their groups and bodies say, with a material of their own.
struct ContactPair {
  int geometry_a = 0, geometry_b = 0;
  Material material;
};

/// A string over pulleys on joints, or a linkage: its length is a sum of joint values, each times a coefficient. It
/// resists as a joint does.
struct Tendon {
  struct Term {
    int joint = 0;  ///< Revolute or Prismatic
    double coefficient = 1.0;
  };
  std::string name;
  std::vector<Term> terms;
  double lower = -kInfinity, upper = kInfinity;  ///< of the length; its unit is that of coefficient times value
  double limit_stiffness = kInfinity, limit_damping = 0.0;
  double stiffness = 0.0;  ///< towards the interval of the spring
  double spring_lower = 0.0, spring_upper = 0.0;
  double damping = 0.0, friction = 0.0;  ///< viscous, dry
};

enum class ConstraintType : std::uint8_t {
  Connect,  ///< a point of body a and one of body b coincide: 3 rows
  Weld,     ///< the frames placement_a and placement_b coincide: 6 rows
  Coupling  ///< q_b - q_b0 = polynomial(q_a - q_a0) of two one-value joints or tendons, or of b alone: 1 row
};

/// An equality between bodies or joints; rigid, or a spring with damper in each row.
struct EqualityConstraint {
  std::string name;
  ConstraintType type = ConstraintType::Connect;
  int body_a = 0, body_b = 0;                          ///< Connect, Weld
  Placement placement_a, placement_b;                  ///< in the body frames; Connect: translations only
  int joint_a = -1, joint_b = -1;                      ///< Coupling; without an a, q_b is held at coefficients[0]
  int tendon_a = -1, tendon_b = -1;                    ///< Coupling: in place of the joint
  double coefficients[5] = {0.0, 1.0, 0.0, 0.0, 0.0};  ///< of the polynomial, constant first
  double reference_a = 0.0, reference_b = 0.0;         ///< q_a0, q_b0
  double stiffness = kInfinity;                        ///< [N/m, N m/rad]; infinite: rigid
  double damping = 0.0;                                ///< [N s/m, N m s/rad]
  double turn_stiffness = kInfinity;                   ///< Weld: of rotations, in place of the above
  double turn_damping = 0.0;
};

enum class Activation : std::uint8_t {
  None,        ///< input = control
  Integrator,  ///< d input / dt = control
  Filter       ///< d input / dt = (control - input) / time_constant
};

/// Pulls along one velocity of a joint, a tendon, or pushes a body. With the length l = gear q (tendon: gear times its
/// length; ball and free joints, bodies: 0) and its rate l',
///     effort = gain . (1, l, l') input + bias . (1, l, l'),      force on the joint or tendon = gear effort,
/// implicit in l and l' where it resists them, as springs and dampers are.
struct Actuator {
  std::string name;
  int joint = -1;     ///< one of joint, tendon and body
  int component = 0;  ///< which of the joint's velocities (Ball 0-2, Free 0-5)
  int tendon = -1;
  int body = -1;                          ///< pushed at `placement` with the wrench effort gear (wrench)
  Placement placement;                    ///< in the body
  double wrench[6] = {0, 0, 0, 0, 0, 0};  ///< force, moment, axes of `placement`
  double gear = 1.0;
  Vector3 gain{1.0, 0.0, 0.0}, bias{0.0, 0.0, 0.0};
  Activation activation = Activation::None;
  double time_constant = 0.0;                                    ///< Filter [s]
  double control_lower = -kInfinity, control_upper = kInfinity;  ///< controls are clipped to this
  double activation_lower = -kInfinity, activation_upper = kInfinity;
  double force_lower = -kInfinity, force_upper = kInfinity;  ///< of the effort
};

/// Robots, objects and ground, constant after it is built; simulators share it between threads.
class World {
 public:
  struct Impl;
  explicit World(std::unique_ptr<Impl> impl);
  ~World();

  Index num_q() const;
  Index num_v() const;
  Index num_controls() const;
  /// Frames that contacts are found in: the world, the articulated joints, the free bodies.
  int num_frames() const;
  const std::vector<Body>& bodies() const;  ///< bodies()[0] is the world
  const std::vector<Joint>& joints() const;
  const std::vector<Geometry>& geometries() const;
  const std::vector<EqualityConstraint>& constraints() const;
  const std::vector<Tendon>& tendons() const;
  const std::vector<Actuator>& actuators() const;
  const std::vector<ContactPair>& contact_pairs() const;
  /// Of contacts between two geometries: mixed, or their pair's own.
  Material material(int geometry_a, int geometry_b) const;
  /// Pairs of geometries (a < b) that never touch although their groups would let them.
  const std::vector<std::pair<int, int>>& excluded_pairs() const;
  /// True when the geometries of these two may touch: not on one frame, and a contact pair, or not parent and child,
  /// groups agree, not excluded.
  bool may_touch(int geometry_a, int geometry_b) const;
  const Vector3& gravity() const;
  /// Joints at their reference, or at the limit next to it; free bodies where they were built.
  const Vector& initial_q() const;

  /// q advanced along v for a time step, on the manifold of configurations.
  void integrate(const ConstVectorRef& q, const ConstVectorRef& v, double time_step, VectorRef q_next) const;
  /// q with its quaternions made unit. Raises InvalidInput for `field` when one is zero or a value is not finite, and
  /// leaves q.
  void normalize(VectorRef q, const char* field) const;

  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace signorini
