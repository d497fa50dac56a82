#pragma once

#include "signorini/model/world.hpp"

namespace signorini {

/// Collects bodies, geometries and what ties them, checks each at the door, and makes a World of them. Body 0 is the
/// world; parents come before children. Every error is an InvalidInput that names the element, the value and the range.
class WorldBuilder {
 public:
  explicit WorldBuilder(const Vector3& gravity = {0.0, 0.0, -9.81});

  /// Returns the body's index. Names of bodies, and of joints, are unique and not empty. A body that moves relative to
  /// its parent needs mass, itself or in a body further out that is tied to it.
  int add_body(Body body);
  /// Returns the geometry's index; an empty name is made up.
  int add_geometry(Geometry geometry);
  int add_tendon(Tendon tendon);
  int add_constraint(EqualityConstraint constraint);
  int add_actuator(Actuator actuator);
  /// The geometries of these bodies never touch, unless a contact pair that is added later says so.
  void exclude_bodies(int body_a, int body_b);
  void exclude_geometries(int geometry_a, int geometry_b);
  /// These two may touch whatever else was said, with a material of their own, which replaces that of an earlier pair;
  /// not when they move as one.
  void add_contact_pair(ContactPair pair);

  int find_body(const std::string& name) const;   ///< -1: none
  int find_joint(const std::string& name) const;  ///< index in the order of addition; -1: none

  std::shared_ptr<const World> build() const;

 private:
  void require_one_value(int joint, const std::string& field) const;

  Vector3 gravity_;
  std::vector<Body> bodies_;
  std::vector<std::pair<int, int>> joints_;  // (body, place in it)
  std::vector<Geometry> geometries_;
  std::vector<EqualityConstraint> constraints_;
  std::vector<Tendon> tendons_;
  std::vector<Actuator> actuators_;
  std::vector<ContactPair> contact_pairs_;
  std::vector<std::pair<int, int>> excluded_bodies_, excluded_geometries_;
};

}  // namespace signorini
