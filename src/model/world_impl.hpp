#pragma once

#include <cstdint>
#include <memory>
#include <unordered_set>

#include "signorini/model/world.hpp"

namespace signorini {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// A frame of a tree, and the joint it moves by.
struct ArticulatedJoint {
  JointType type = JointType::Revolute;
  int parent = 0;                   ///< frame; 0 is the world
  Placement placement;              ///< in the parent's frame, at q = 0
  Vector3 axis = Vector3::UnitZ();  ///< unit
  Index q = 0, v = 0;               ///< first entries in q and v
  double armature = 0.0;
  double mass = 0.0;                  ///< of what moves with the frame
  Vector3 center = Vector3::Zero();   ///< of mass, in the frame
  Matrix3 inertia = Matrix3::Zero();  ///< about the centre of mass

  Index num_v() const { return type == JointType::Free ? 6 : type == JointType::Ball ? 3 : 1; }
};

/// A body on a free joint without armature and dry friction, nothing moving on it: closed forms, so that piles of
/// thousands cost what they have to.
struct FreeBody {
  int body = 0;
  Index q = 0, v = 0;  ///< first entries of its joint in q and v
  double mass = 0.0;
  Vector3 center = Vector3::Zero();                                      ///< of mass, in the frame of the body
  Matrix3 inertia = Matrix3::Zero(), inverse_inertia = Matrix3::Zero();  ///< about the centre of mass
  Matrix6 mass_matrix = Matrix6::Zero();  ///< about the frame's origin, (linear, angular)
};

struct World::Impl {
  Vector3 gravity;
  std::vector<Body> bodies;
  std::vector<Joint> joints;
  std::vector<Geometry> geometries;
  std::vector<EqualityConstraint> constraints;
  std::vector<Tendon> tendons;
  std::vector<Actuator> actuators;
  std::vector<ContactPair> contact_pairs;             // a < b, sorted
  std::vector<std::pair<int, int>> excluded;          // geometries, a < b, sorted
  std::unordered_set<std::uint64_t> excluded_bodies;  // pair_key of bodies
  std::vector<int> moving_parent;                     // for each frame of a body, that of the body it hangs on
  /// By frame, parents first; frame 0 is the world, the free bodies' frames follow. Velocities and values have the same
  /// order.
  std::vector<ArticulatedJoint> articulated;
  int num_articulated_frames = 1;
  Index nq_articulated = 0, nv_articulated = 0;
  std::vector<int> parent_dof;  // of its velocities: the one before it on the way to the root, or -1
  /// The same in the elimination tree of M^, which tendons make denser: paths in it hold those in parent_dof.
  std::vector<int> factor_parent;
  struct Pull {
    int v = 0;
    double coefficient = 1.0;
  };
  std::vector<std::vector<Pull>> tendon_pulls;  // by tendon: length' = sum of coefficient v
  std::vector<std::uint8_t> tendon_resists;     // by tendon: adds to M^
  std::vector<FreeBody> free_bodies;
  Index num_q = 0, num_v = 0;
  Vector initial_q;

  const ContactPair* find_pair(int a, int b) const;

  static std::uint64_t pair_key(int a, int b) {
    if (a > b) std::swap(a, b);
    return (static_cast<std::uint64_t>(static_cast<std::uint32_t>(a)) << 32) | static_cast<std::uint32_t>(b);
  }
};

}  // namespace signorini
