#pragma once

#include <memory>
#include <string>

#include "signorini/model/world_builder.hpp"

namespace signorini::testing {

inline int add_box(WorldBuilder& builder, const std::string& name, double mass, const Vector3& half,
                   const Vector3& position, const Material& material = {}) {
  Body body;
  body.name = name;
  body.placement.translation = position;
  body.mass = mass;
  const Vector3 square = (2.0 * half).cwiseAbs2();
  body.inertia =
      (mass / 12.0 * Vector3(square[1] + square[2], square[0] + square[2], square[0] + square[1])).asDiagonal();
  Joint joint;
  joint.name = name;
  joint.type = JointType::Free;
  body.joints.push_back(joint);
  Geometry geometry;
  geometry.body = builder.add_body(body);
  geometry.shape = Shape::box(half);
  geometry.material = material;
  builder.add_geometry(geometry);
  return geometry.body;
}

inline void add_ground(WorldBuilder& builder, const Material& material = {}) {
  Geometry ground;
  ground.material = material;
  ground.shape = Shape::half_space();
  builder.add_geometry(ground);
}

/// A stack of boxes on the ground, and a chain of rods with capsules that falls on them: limits, dry friction, damping,
/// a position drive, a weld and a compliant box. ground: its material.
inline std::shared_ptr<const World> busy_world(const Material& ground = {}) {
  WorldBuilder builder;
  add_ground(builder, ground);
  for (int i = 0; i < 4; ++i)
    add_box(builder, "box" + std::to_string(i), 1.0 + i, {0.1, 0.1, 0.1}, {0.0, 0.01 * i, 0.1 + 0.2 * i});
  Material soft;
  soft.stiffness = 1e4;
  soft.damping = 20.0;
  const int first = add_box(builder, "soft", 2.0, {0.1, 0.2, 0.05}, {0.6, 0.0, 0.06}, soft);
  const int second = add_box(builder, "tied", 1.0, {0.1, 0.2, 0.05}, {0.6, 0.0, 0.2});
  EqualityConstraint weld;
  weld.name = "weld";
  weld.type = ConstraintType::Weld;
  weld.body_a = first;
  weld.body_b = second;
  weld.placement_a.translation = {0.0, 0.0, 0.14};
  builder.add_constraint(weld);
  int parent = 0;
  for (int i = 0; i < 4; ++i) {
    Body rod;
    rod.name = "rod" + std::to_string(i);
    rod.parent = parent;
    rod.placement.translation = i == 0 ? Vector3(-0.9, 0.0, 0.9) : Vector3(0.3, 0.0, 0.0);
    rod.mass = 0.5;
    rod.center = {0.15, 0.0, 0.0};
    rod.inertia = Vector3(1e-4, 4e-3, 4e-3).asDiagonal();
    Joint joint;
    joint.name = "hinge" + std::to_string(i);
    joint.axis = {0.0, 1.0, 0.1 * i};
    joint.lower = -1.0;
    joint.upper = 1.2;
    joint.friction = 0.01;
    joint.damping = 0.02;
    joint.armature = 1e-3;
    rod.joints.push_back(joint);
    parent = builder.add_body(rod);
    Geometry geometry;
    geometry.body = parent;
    geometry.shape = Shape::capsule(0.03, 0.1);
    geometry.placement.translation = {0.15, 0.0, 0.0};
    geometry.placement.rotation << 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0;
    builder.add_geometry(geometry);
  }
  Actuator drive;
  drive.name = "drive";
  drive.joint = builder.find_joint("hinge0");
  drive.gain = {20.0, 0.0, 0.0};
  drive.bias = {0.0, -20.0, -1.0};
  builder.add_actuator(drive);
  Tendon tendon;
  tendon.name = "tendon";
  tendon.terms = {{builder.find_joint("hinge1"), 1.0}, {builder.find_joint("hinge3"), -0.5}};
  tendon.upper = 0.4;
  tendon.stiffness = 2.0;
  tendon.damping = 0.05;
  tendon.friction = 0.01;
  builder.add_tendon(tendon);
  Actuator winch;
  winch.name = "winch";
  winch.tendon = 0;
  winch.gain = {1.0, -0.3, 0.0};
  winch.bias = {0.0, 0.0, -0.02};
  winch.activation = Activation::Filter;
  winch.time_constant = 0.05;
  builder.add_actuator(winch);
  Material ice;
  ice.friction = 0.01;
  builder.add_contact_pair({0, 1, ice});
  return builder.build();
}

/// Rows of boxes on the ground, some near each other, the first of each fast: a step takes rounds (S18).
inline std::shared_ptr<const World> rows_of_boxes(const Material& material = {}) {
  WorldBuilder builder;
  add_ground(builder, material);
  const double gaps[] = {0.02, 1e-4, 8e-3, 2e-3, 9e-3, 1e-4};
  for (int row = 0; row < 6; ++row) {
    double x = 0.0;
    for (int k = 0; k < 6; ++k) {
      add_box(builder, "box" + std::to_string(row) + std::to_string(k), 1.0 + row + k, {0.05, 0.05, 0.05},
              {x, 1.0 * row, 0.05 + 1e-5}, material);
      x += 0.1 + gaps[(row + k) % 6];
    }
  }
  return builder.build();
}

/// The velocity of that.
inline Vector speeds_of_rows() {
  Vector v = Vector::Zero(6 * 36);
  for (int row = 0; row < 6; ++row) v[36 * row] = 20.0 + 5.0 * row;
  return v;
}

}  // namespace signorini::testing
