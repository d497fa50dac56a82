#include "signorini/model/world_builder.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>

#include "require.hpp"
#include "world_impl.hpp"

namespace signorini {
namespace {

void require_finite(const Vector3& v, const std::string& field) {
  for (int k = 0; k < 3; ++k)
    require(std::abs(v[k]) <= 1e9, field + "[" + std::to_string(k) + "]", v[k], "within +-1e9");
}

void require_placement(const Placement& p, const std::string& field) {
  require_finite(p.translation, field + ".position");
  const double error = (p.rotation.transpose() * p.rotation - Matrix3::Identity()).cwiseAbs().maxCoeff();
  require(error <= 1e-6 && p.rotation.determinant() > 0.0, field + ".orientation: |R^T R - 1|", error,
          "a rotation, at most 1e-6");
}

template <class Element, class Matches>
void remove_if(std::vector<Element>& list, Matches&& matches) {
  list.erase(std::remove_if(list.begin(), list.end(), matches), list.end());
}

/// Either may be infinite, so that nothing is bounded there; a value has to be left between them.
void validate_range(double lower, double upper, const std::string& name, const char* low, const char* high) {
  require(lower < kInfinity, name + low, lower, "less than infinity");
  require(lower <= upper, name + high, upper, "at least the lower bound");
  require(upper > -kInfinity, name + high, upper, "more than -infinity");
}

void validate_limit(double stiffness, double damping, const std::string& name) {
  require(stiffness > 0.0, name + "limit_stiffness", stiffness, "> 0, infinite for rigid");
  require(damping >= 0.0 && damping <= 1e15, name + "limit_damping", damping, "in [0, 1e15]");
}

void validate(const Joint& joint, const std::string& field) {
  if (joint.name.empty()) throw InvalidInput(field, "has a joint without a name");
  const std::string name = "joint '" + joint.name + "'.";
  require_finite(joint.axis, name + "axis");
  require_finite(joint.anchor, name + "anchor");
  const bool one_value = joint.type == JointType::Revolute || joint.type == JointType::Prismatic;
  if (one_value) require(joint.axis.norm() > 1e-9, name + "axis norm", joint.axis.norm(), "> 0");
  require(std::abs(joint.reference) <= 1e9, name + "reference", joint.reference, "within +-1e9");
  validate_range(joint.lower, joint.upper, name, "lower", "upper");
  if (!one_value) {
    require(joint.lower == -kInfinity, name + "lower", joint.lower,
            "-infinity: only revolute and prismatic joints have a lower limit");
    const bool turns = joint.type == JointType::Ball && joint.upper > 0.0;
    require(turns || joint.upper == kInfinity, name + "upper", joint.upper,
            "infinite, or > 0: the largest angle of a ball joint");
  }
  validate_limit(joint.limit_stiffness, joint.limit_damping, name);
  const std::pair<const char*, double> values[] = {{"armature", joint.armature},
                                                   {"damping", joint.damping},
                                                   {"friction", joint.friction},
                                                   {"stiffness", joint.stiffness}};
  for (const auto& [key, value] : values) require(value >= 0.0 && value <= 1e12, name + key, value, "in [0, 1e12]");
  require(one_value || joint.stiffness == 0.0, name + "stiffness", joint.stiffness,
          "0: only revolute and prismatic joints have springs");
  require(std::abs(joint.spring_reference) <= 1e9, name + "spring_reference", joint.spring_reference, "within +-1e9");
}

constexpr double kTriangle = 1e-3;  // share by which moments may miss the triangle inequality
constexpr double kPoint = 1e-6;     // [m] moments below mass times its square are rounding

Matrix3 skew(const Vector3& v) {
  Matrix3 m;
  m << 0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0;
  return m;
}

/// Mass, centre and inertia of what moves together, in one frame.
struct Lump {
  double mass = 0.0;
  Vector3 first = Vector3::Zero();   // mass times centre
  Matrix3 second = Matrix3::Zero();  // inertia about the origin
  void add(const Body& body, const Placement& in_frame) {
    const Vector3 c = in_frame * body.center;
    mass += body.mass;
    first += body.mass * c;
    second += in_frame.rotation * body.inertia * in_frame.rotation.transpose() - body.mass * skew(c) * skew(c);
  }
};

void find_tendon_pulls(World::Impl& w) {
  for (const Tendon& tendon : w.tendons) {
    w.tendon_pulls.emplace_back();
    for (const Tendon::Term& term : tendon.terms)
      w.tendon_pulls.back().push_back(
          {static_cast<int>(w.joints[static_cast<std::size_t>(term.joint)].v_index), term.coefficient});
    w.tendon_resists.push_back(tendon.stiffness > 0.0 || tendon.damping > 0.0);
  }
  for (const Actuator& a : w.actuators)
    if (a.tendon >= 0 && (!a.gain.tail<2>().isZero(0.0) || !a.bias.tail<2>().isZero(0.0)))
      w.tendon_resists[static_cast<std::size_t>(a.tendon)] = 1;
}

/// Of M^ = L^T D L, which eliminates the last velocity first: a velocity's parent is the last one before it that its
/// row of L has an entry for. Without tendons that resist it is the tree of the joints.
void find_elimination_tree(World::Impl& w) {
  w.factor_parent = w.parent_dof;
  if (std::none_of(w.tendon_resists.begin(), w.tendon_resists.end(), [](std::uint8_t r) { return r != 0; })) return;
  std::vector<std::set<int>> row(w.parent_dof.size());
  for (std::size_t k = 0; k < row.size(); ++k)
    for (int i = w.parent_dof[k]; i >= 0; i = w.parent_dof[static_cast<std::size_t>(i)]) row[k].insert(i);
  for (std::size_t t = 0; t < w.tendon_pulls.size(); ++t) {
    if (!w.tendon_resists[t]) continue;
    for (const auto& a : w.tendon_pulls[t])
      for (const auto& b : w.tendon_pulls[t])
        if (b.v < a.v) row[static_cast<std::size_t>(a.v)].insert(b.v);
  }
  for (std::size_t k = row.size(); k-- > 0;) {
    w.factor_parent[k] = row[k].empty() ? -1 : *row[k].rbegin();
    if (row[k].empty()) continue;
    std::set<int>& above = row[static_cast<std::size_t>(w.factor_parent[k])];
    for (const int i : row[k])
      if (i < w.factor_parent[k]) above.insert(i);
  }
}

}  // namespace

std::string inertia_fault(double mass, const Matrix3& inertia) {
  const Vector3 moments = Eigen::SelfAdjointEigenSolver<Matrix3>(inertia, Eigen::EigenvaluesOnly).eigenvalues();
  const double largest = moments.cwiseAbs().maxCoeff();
  if (mass == 0.0) return largest > 0.0 ? "the mass is 0 and the inertia is not" : "";
  std::ostringstream out;
  out << "the principal moments are " << moments[0] << ", " << moments[1] << ", " << moments[2] << ", ";
  if (moments[0] < -1e-9 * largest) return out.str() + "none may be negative";
  if (largest < mass * kPoint * kPoint) return "";
  if (moments[0] + moments[1] >= moments[2] * (1.0 - kTriangle)) return "";
  return out.str() + "each must be at most the sum of the other two";
}

WorldBuilder::WorldBuilder(const Vector3& gravity) : gravity_(gravity) {
  require_finite(gravity, "gravity");
  Body world;
  world.name = "world";
  bodies_.push_back(world);
}

int WorldBuilder::find_body(const std::string& name) const {
  for (std::size_t i = 0; i < bodies_.size(); ++i)
    if (bodies_[i].name == name) return static_cast<int>(i);
  return -1;
}

int WorldBuilder::find_joint(const std::string& name) const {
  for (std::size_t i = 0; i < joints_.size(); ++i)
    if (bodies_[joints_[i].first].joints[joints_[i].second].name == name) return static_cast<int>(i);
  return -1;
}

int WorldBuilder::add_body(Body body) {
  if (body.name.empty()) throw InvalidInput("body", "has no name");
  const std::string field = "body '" + body.name + "'";
  if (find_body(body.name) >= 0) throw InvalidInput(field, "is there already; names of bodies are unique");
  const int index = static_cast<int>(bodies_.size());
  require(body.parent >= 0 && body.parent < index, field + ".parent", body.parent, "a body added before");
  require_placement(body.placement, field);
  require(body.mass >= 0.0 && body.mass <= 1e15, field + ".mass", body.mass, "in [0, 1e15] kg");
  require_finite(body.center, field + ".center");
  for (int k = 0; k < 9; ++k)
    require(std::abs(body.inertia.data()[k]) <= 1e15, field + ".inertia", body.inertia.data()[k], "within +-1e15");
  require(std::abs(body.gravity_compensation) <= 1e6, field + ".gravity_compensation", body.gravity_compensation,
          "within +-1e6");
  const double size = body.inertia.cwiseAbs().maxCoeff();
  require((body.inertia - body.inertia.transpose()).cwiseAbs().maxCoeff() <= 1e-6 * size, field + ".inertia asymmetry",
          (body.inertia - body.inertia.transpose()).cwiseAbs().maxCoeff(), "0: an inertia is symmetric");
  body.inertia = 0.5 * (body.inertia + body.inertia.transpose()).eval();
  require(body.mass > 0.0 || size == 0.0, field + ".mass", body.mass, "> 0 where there is an inertia");
  const std::string fault = inertia_fault(body.mass, body.inertia);
  if (!fault.empty()) throw InvalidInput(field + ".inertia", fault);
  for (std::size_t k = 0; k < body.joints.size(); ++k) {
    Joint& joint = body.joints[k];
    validate(joint, field);
    bool taken = find_joint(joint.name) >= 0;
    for (std::size_t other = 0; other < k; ++other) taken = taken || body.joints[other].name == joint.name;
    if (taken) throw InvalidInput("joint '" + joint.name + "'", "is there already; names of joints are unique");
    if (joint.type == JointType::Free && (body.parent != 0 || body.joints.size() != 1))
      throw InvalidInput("joint '" + joint.name + "'", "is free, must be its body's only joint and hang on the world");
  }
  bodies_.push_back(std::move(body));
  for (std::size_t k = 0; k < bodies_.back().joints.size(); ++k) joints_.emplace_back(index, static_cast<int>(k));
  return index;
}

int WorldBuilder::add_geometry(Geometry geometry) {
  const int index = static_cast<int>(geometries_.size());
  if (geometry.name.empty()) geometry.name = "geometry " + std::to_string(index);
  const std::string field = "geometry '" + geometry.name + "'";
  require(geometry.body >= 0 && geometry.body < static_cast<int>(bodies_.size()), field + ".body", geometry.body,
          "a body added before");
  require_placement(geometry.placement, field);
  geometry.shape.validate(field.c_str());
  geometry.material.validate(field.c_str());
  const bool half_space = geometry.shape.type == ShapeType::HalfSpace;
  if (half_space || geometry.shape.type == ShapeType::HeightField) {
    for (int b = geometry.body; b != 0; b = bodies_[b].parent)
      if (!bodies_[b].joints.empty())
        throw InvalidInput(field, std::string("is a ") + (half_space ? "half space" : "height field") +
                                      ", must be fixed to the world");
  }
  geometries_.push_back(std::move(geometry));
  return index;
}

int WorldBuilder::add_tendon(Tendon tendon) {
  const std::string field = "tendon '" + tendon.name + "'";
  if (tendon.name.empty()) throw InvalidInput("tendon", "has no name");
  for (const Tendon& other : tendons_)
    if (other.name == tendon.name) throw InvalidInput(field, "is there already; names of tendons are unique");
  if (tendon.terms.empty()) throw InvalidInput(field + ".terms", "is empty, must name a joint");
  for (const Tendon::Term& term : tendon.terms) {
    require_one_value(term.joint, field + ".terms");
    require(std::abs(term.coefficient) <= 1e9, field + ".coefficient", term.coefficient, "within +-1e9");
  }
  validate_range(tendon.lower, tendon.upper, field + ".", "lower", "upper");
  validate_limit(tendon.limit_stiffness, tendon.limit_damping, field + ".");
  for (const auto& [key, value] :
       {std::make_pair("stiffness", tendon.stiffness), {"damping", tendon.damping}, {"friction", tendon.friction}})
    require(value >= 0.0 && value <= 1e12, field + "." + key, value, "in [0, 1e12]");
  require(std::abs(tendon.spring_lower) <= 1e9, field + ".spring_lower", tendon.spring_lower, "within +-1e9");
  require(tendon.spring_upper >= tendon.spring_lower && tendon.spring_upper <= 1e9, field + ".spring_upper",
          tendon.spring_upper, "at least spring_lower");
  tendons_.push_back(std::move(tendon));
  return static_cast<int>(tendons_.size()) - 1;
}

void WorldBuilder::require_one_value(int joint, const std::string& field) const {
  require(joint >= 0 && joint < static_cast<int>(joints_.size()), field, joint, "a joint added before");
  const JointType type = bodies_[joints_[joint].first].joints[joints_[joint].second].type;
  if (type != JointType::Revolute && type != JointType::Prismatic)
    throw InvalidInput(field, "must be a revolute or prismatic joint");
}

int WorldBuilder::add_constraint(EqualityConstraint constraint) {
  const int index = static_cast<int>(constraints_.size());
  if (constraint.name.empty()) constraint.name = "constraint " + std::to_string(index);
  const std::string field = "constraint '" + constraint.name + "'";
  const auto body = [&](int b, const char* key) {
    require(b >= 0 && b < static_cast<int>(bodies_.size()), field + key, b, "a body added before");
  };
  const auto coordinate = [&](int joint, int tendon, const char* key) {
    if (tendon < 0) return require_one_value(joint, field + key);
    require(tendon < static_cast<int>(tendons_.size()), field + key, tendon, "a tendon added before");
  };
  if (constraint.type == ConstraintType::Coupling) {
    coordinate(constraint.joint_b, constraint.tendon_b, ".joint");
    if (constraint.joint_a >= 0 || constraint.tendon_a >= 0)
      coordinate(constraint.joint_a, constraint.tendon_a, ".driver");
    const bool same = constraint.tendon_b >= 0 ? constraint.tendon_a == constraint.tendon_b
                                               : constraint.tendon_a < 0 && constraint.joint_a == constraint.joint_b;
    if (same) throw InvalidInput(field + ".driver", "is the joint itself");
    for (const double c : constraint.coefficients)
      require(std::abs(c) <= 1e9, field + ".coefficients", c, "within +-1e9");
  } else {
    body(constraint.body_a, ".body_a");
    body(constraint.body_b, ".body_b");
    if (constraint.body_a == constraint.body_b) throw InvalidInput(field + ".body_b", "is body_a");
    require_placement(constraint.placement_a, field + ".placement_a");
    require_placement(constraint.placement_b, field + ".placement_b");
  }
  require(constraint.stiffness > 0.0, field + ".stiffness", constraint.stiffness, "> 0, infinite for rigid");
  require(constraint.damping >= 0.0 && constraint.damping <= 1e15, field + ".damping", constraint.damping,
          "in [0, 1e15]");
  require(constraint.turn_stiffness > 0.0, field + ".turn_stiffness", constraint.turn_stiffness,
          "> 0, infinite for rigid");
  require(constraint.turn_damping >= 0.0 && constraint.turn_damping <= 1e15, field + ".turn_damping",
          constraint.turn_damping, "in [0, 1e15]");
  constraints_.push_back(std::move(constraint));
  return index;
}

int WorldBuilder::add_actuator(Actuator actuator) {
  const std::string field = "actuator '" + actuator.name + "'";
  if (actuator.name.empty()) throw InvalidInput("actuator", "has no name");
  for (const Actuator& other : actuators_)
    if (other.name == actuator.name) throw InvalidInput(field, "is there already; names of actuators are unique");
  const auto given = static_cast<int>(actuator.joint >= 0) + static_cast<int>(actuator.tendon >= 0) +
                     static_cast<int>(actuator.body >= 0);
  require(given == 1, field + ": joints, tendons and bodies that it acts on", given, "1");
  if (actuator.joint >= 0) {
    require(actuator.joint < static_cast<int>(joints_.size()), field + ".joint", actuator.joint,
            "a joint added before");
    const Joint& joint = bodies_[joints_[actuator.joint].first].joints[joints_[actuator.joint].second];
    require(actuator.component >= 0 && actuator.component < joint.num_v(), field + ".component", actuator.component,
            "one of the joint's velocities");
    if (joint.num_v() != 1)
      require(actuator.gain[1] == 0.0 && actuator.bias[1] == 0.0, field + ".bias[1]", actuator.bias[1],
              "0: only revolute and prismatic joints have a length");
  } else if (actuator.tendon >= 0) {
    require(actuator.tendon < static_cast<int>(tendons_.size()), field + ".tendon", actuator.tendon,
            "a tendon added before");
  } else {
    require(actuator.body < static_cast<int>(bodies_.size()), field + ".body", actuator.body, "a body added before");
    require_placement(actuator.placement, field);
    for (const double x : actuator.wrench) require(std::abs(x) <= 1e9, field + ".wrench", x, "within +-1e9");
    for (int k = 1; k < 3; ++k)
      require(actuator.gain[k] == 0.0 && actuator.bias[k] == 0.0, field + ".bias", actuator.bias[k],
              "0: what pushes a body has no length");
  }
  require(std::abs(actuator.gear) <= 1e9 && actuator.gear != 0.0, field + ".gear", actuator.gear,
          "within +-1e9 and not 0");
  for (int k = 0; k < 3; ++k) {
    require(std::abs(actuator.gain[k]) <= 1e12, field + ".gain", actuator.gain[k], "within +-1e12");
    require(std::abs(actuator.bias[k]) <= 1e12, field + ".bias", actuator.bias[k], "within +-1e12");
  }
  if (actuator.activation == Activation::Filter)
    require(actuator.time_constant > 0.0 && actuator.time_constant <= 1e9, field + ".time_constant",
            actuator.time_constant, "in (0, 1e9] s");
  validate_range(actuator.activation_lower, actuator.activation_upper, field + ".activation_range", "[0]", "[1]");
  validate_range(actuator.control_lower, actuator.control_upper, field + ".control_range", "[0]", "[1]");
  validate_range(actuator.force_lower, actuator.force_upper, field + ".force_range", "[0]", "[1]");
  actuators_.push_back(std::move(actuator));
  return static_cast<int>(actuators_.size()) - 1;
}

void WorldBuilder::exclude_bodies(int body_a, int body_b) {
  for (const int b : {body_a, body_b})
    require(b >= 0 && b < static_cast<int>(bodies_.size()), "exclude", b, "a body added before");
  excluded_bodies_.emplace_back(body_a, body_b);
  remove_if(contact_pairs_, [&](const ContactPair& pair) {
    const int a = geometries_[pair.geometry_a].body, b = geometries_[pair.geometry_b].body;
    return (a == body_a && b == body_b) || (a == body_b && b == body_a);
  });
}

void WorldBuilder::exclude_geometries(int geometry_a, int geometry_b) {
  for (const int g : {geometry_a, geometry_b})
    require(g >= 0 && g < static_cast<int>(geometries_.size()), "exclude", g, "a geometry added before");
  const int a = std::min(geometry_a, geometry_b), b = std::max(geometry_a, geometry_b);
  excluded_geometries_.emplace_back(a, b);
  remove_if(contact_pairs_, [&](const ContactPair& pair) { return pair.geometry_a == a && pair.geometry_b == b; });
}

void WorldBuilder::add_contact_pair(ContactPair pair) {
  for (const int g : {pair.geometry_a, pair.geometry_b})
    require(g >= 0 && g < static_cast<int>(geometries_.size()), "contact pair", g, "a geometry added before");
  if (pair.geometry_a == pair.geometry_b) throw InvalidInput("contact pair", "is of a geometry with itself");
  if (pair.geometry_a > pair.geometry_b) std::swap(pair.geometry_a, pair.geometry_b);
  const std::string field =
      "contact pair (" + geometries_[pair.geometry_a].name + ", " + geometries_[pair.geometry_b].name + ")";
  pair.material.validate(field.c_str());
  pair.material = as_in_contact(pair.material);
  remove_if(contact_pairs_, [&](const ContactPair& other) {
    return other.geometry_a == pair.geometry_a && other.geometry_b == pair.geometry_b;
  });
  contact_pairs_.push_back(std::move(pair));
}

std::shared_ptr<const World> WorldBuilder::build() const {
  auto impl = std::make_unique<World::Impl>();
  impl->gravity = gravity_;
  impl->bodies = bodies_;
  impl->geometries = geometries_;
  impl->constraints = constraints_;
  impl->tendons = tendons_;
  impl->actuators = actuators_;
  std::vector<Body>& bodies = impl->bodies;
  const auto count = bodies.size();

  // Depth-first order, so that the velocities of a subtree are in one piece.
  std::vector<std::vector<int>> children(count);
  for (std::size_t b = 1; b < count; ++b) children[bodies[b].parent].push_back(static_cast<int>(b));
  std::vector<int> order, stack{0};
  while (!stack.empty()) {
    const int b = stack.back();
    stack.pop_back();
    order.push_back(b);
    for (auto c = children[b].rbegin(); c != children[b].rend(); ++c) stack.push_back(*c);
  }
  // Free bodies: a free joint without armature and dry friction, and nothing but fixed bodies on it.
  std::vector<int> free_root(count, 0);  // the free body that a body is fixed to
  std::vector<std::uint8_t> articulated(count, 0);
  for (auto b = order.rbegin(); b != order.rend(); ++b)
    for (const int c : children[*b])
      if (articulated[c] || !bodies[c].joints.empty()) articulated[*b] = 1;  // something moves on it

  std::vector<ArticulatedJoint>& articulated_joints = impl->articulated;
  articulated_joints.resize(1);
  std::vector<std::pair<int, int>> joint_order;  // (body, place) in the order of velocities
  std::vector<Lump> lumps(1);                    // by frame
  impl->moving_parent.assign(1, 0);
  std::vector<int> free_list;
  const auto is_free = [&](int b) {
    if (bodies[b].joints.size() != 1 || bodies[b].joints[0].type != JointType::Free || articulated[b]) return false;
    // Armature turns no gyroscope and is at the body's origin, so its centre of mass does not move straight.
    return bodies[b].joints[0].armature == 0.0 && bodies[b].joints[0].friction == 0.0;
  };
  for (const int b : order) {
    if (b == 0) continue;
    Body& body = bodies[b];
    const Body& parent = bodies[body.parent];
    if (is_free(b)) {
      free_root[b] = b;
      free_list.push_back(b);
      continue;
    }
    if (body.joints.empty() && free_root[body.parent]) {
      free_root[b] = free_root[body.parent];
      continue;
    }
    Placement offset = parent.in_frame * body.placement;
    int frame = parent.frame;
    for (std::size_t k = 0; k < body.joints.size(); ++k) {
      const Joint& joint = body.joints[k];
      const bool pivots = joint.type == JointType::Revolute || joint.type == JointType::Ball;
      const Vector3 anchor = pivots ? joint.anchor : Vector3::Zero();
      ArticulatedJoint own;
      own.type = joint.type;
      own.parent = frame;
      own.axis = joint.axis.normalized();
      own.q = impl->num_q, own.v = impl->num_v;
      own.armature = joint.armature;
      if (joint.type != JointType::Free) own.placement = offset * Placement{Matrix3::Identity(), anchor};
      if (joint.type == JointType::Revolute)
        own.placement.rotation *= Eigen::AngleAxisd(-joint.reference, own.axis).toRotationMatrix();
      if (joint.type == JointType::Prismatic)
        own.placement.translation -= own.placement.rotation * (joint.reference * own.axis);
      impl->num_q += joint.num_q(), impl->num_v += joint.num_v();
      impl->moving_parent.push_back(frame);
      lumps.emplace_back();
      frame = static_cast<int>(articulated_joints.size());
      articulated_joints.push_back(own);
      offset = {Matrix3::Identity(), -anchor};
      joint_order.emplace_back(b, static_cast<int>(k));
    }
    // Frames between the joints of one body carry nothing: the frame it hangs on is its parent's.
    if (!body.joints.empty()) impl->moving_parent[static_cast<std::size_t>(frame)] = parent.frame;
    body.frame = frame;
    body.in_frame = offset;
    lumps[frame].add(body, body.in_frame);
  }
  const int num_joint_frames = static_cast<int>(articulated_joints.size());
  impl->num_articulated_frames = num_joint_frames;
  impl->nq_articulated = impl->num_q;
  impl->nv_articulated = impl->num_v;
  for (std::size_t f = 1; f < articulated_joints.size(); ++f) {
    ArticulatedJoint& joint = articulated_joints[f];
    joint.mass = lumps[f].mass;
    if (joint.mass > 0.0) joint.center = lumps[f].first / joint.mass;
    const Matrix3 c = skew(joint.center);
    joint.inertia = lumps[f].second + joint.mass * c * c;
  }
  for (const int b : free_list) {
    Body& body = bodies[b];
    body.frame = num_joint_frames + static_cast<int>(impl->free_bodies.size());
    body.in_frame = Placement();
    lumps.emplace_back();
    lumps.back().add(body, body.in_frame);
    impl->moving_parent.push_back(0);
    FreeBody free;
    free.body = b;
    free.q = impl->num_q;
    free.v = impl->num_v;
    impl->num_q += 7;
    impl->num_v += 6;
    joint_order.emplace_back(b, 0);
    impl->free_bodies.push_back(free);
  }
  for (const int b : order) {  // bodies fixed to free bodies
    if (!free_root[b] || free_root[b] == b) continue;
    Body& body = bodies[b];
    body.frame = bodies[body.parent].frame;
    body.in_frame = bodies[body.parent].in_frame * body.placement;
    lumps[body.frame].add(body, body.in_frame);
  }

  // Joints in the order of their velocities; whoever named one by the order of addition follows.
  std::vector<int> place(joints_.size());
  for (std::size_t k = 0; k < joint_order.size(); ++k) {
    const auto [b, at] = joint_order[k];
    Joint joint = bodies[b].joints[at];
    joint.body = b;
    if (k + 1 < articulated_joints.size()) {
      joint.q_index = articulated_joints[k + 1].q;
      joint.v_index = articulated_joints[k + 1].v;
    } else {
      const FreeBody& free = impl->free_bodies[k + 1 - articulated_joints.size()];
      joint.q_index = free.q;
      joint.v_index = free.v;
    }
    bodies[b].joints[at] = joint;
    impl->joints.push_back(joint);
    for (std::size_t j = 0; j < joints_.size(); ++j)
      if (joints_[j] == joint_order[k]) place[j] = static_cast<int>(k);
  }
  for (EqualityConstraint& c : impl->constraints) {
    if (c.joint_a >= 0) c.joint_a = place[c.joint_a];
    if (c.joint_b >= 0) c.joint_b = place[c.joint_b];
  }
  for (Actuator& a : impl->actuators)
    if (a.joint >= 0) a.joint = place[a.joint];
  for (Tendon& t : impl->tendons)
    for (Tendon::Term& term : t.terms) term.joint = place[term.joint];

  // Whatever moves has a mass.
  std::vector<double> outer_mass(lumps.size());
  for (std::size_t f = lumps.size(); f-- > 1;) {
    outer_mass[f] += lumps[f].mass;
    if (f < articulated_joints.size())
      outer_mass[static_cast<std::size_t>(articulated_joints[f].parent)] += outer_mass[f];
  }
  for (std::size_t k = 0; k < impl->joints.size(); ++k) {
    const Joint& joint = impl->joints[k];
    if (!(outer_mass[k + 1] > 0.0) && !(joint.armature > 0.0))
      throw InvalidInput(
          "body '" + bodies[joint.body].name + "'.mass",
          "is 0, and nothing with a mass hangs on it; what moves must have one (joint '" + joint.name + "')");
  }
  for (FreeBody& free : impl->free_bodies) {
    const Lump& lump = lumps[bodies[free.body].frame];
    free.mass = lump.mass;
    free.center = lump.first / lump.mass;
    const Matrix3 c = skew(free.center);
    free.inertia = lump.second + lump.mass * c * c;
    const double smallest = Eigen::SelfAdjointEigenSolver<Matrix3>(free.inertia).eigenvalues()[0];
    require(smallest > 0.0, "body '" + bodies[free.body].name + "'.inertia: smallest principal moment", smallest,
            "> 0 for a free body");
    free.inverse_inertia = free.inertia.inverse();
    free.mass_matrix << lump.mass * Matrix3::Identity(), -lump.mass * c, lump.mass * c, lump.second;
  }

  // Where everything starts.
  impl->initial_q = Vector::Zero(impl->num_q);
  for (const Joint& joint : impl->joints) {
    const Placement& p = bodies[joint.body].placement;
    if (joint.type == JointType::Free) {
      const Body& parent = bodies[bodies[joint.body].parent];
      const Placement in_world = parent.in_frame * p;
      const Eigen::Quaterniond rotation(in_world.rotation);
      impl->initial_q.segment<3>(joint.q_index) = in_world.translation;
      impl->initial_q.segment<4>(joint.q_index + 3) = rotation.coeffs();
    } else if (joint.type == JointType::Ball) {
      impl->initial_q[joint.q_index + 3] = 1.0;
    } else {
      impl->initial_q[joint.q_index] = std::clamp(joint.reference, joint.lower, joint.upper);
    }
  }
  impl->parent_dof.assign(static_cast<std::size_t>(impl->nv_articulated), -1);
  for (std::size_t f = 1; f < articulated_joints.size(); ++f) {
    const ArticulatedJoint& joint = articulated_joints[f];
    const ArticulatedJoint& parent = articulated_joints[static_cast<std::size_t>(joint.parent)];
    int before = joint.parent == 0 ? -1 : static_cast<int>(parent.v + parent.num_v()) - 1;
    for (Index k = joint.v; k < joint.v + joint.num_v(); ++k) {
      impl->parent_dof[static_cast<std::size_t>(k)] = before;
      before = static_cast<int>(k);
    }
  }

  find_tendon_pulls(*impl);
  find_elimination_tree(*impl);

  impl->contact_pairs = contact_pairs_;
  std::stable_sort(impl->contact_pairs.begin(), impl->contact_pairs.end(),
                   [](const ContactPair& a, const ContactPair& b) {
                     return std::make_pair(a.geometry_a, a.geometry_b) < std::make_pair(b.geometry_a, b.geometry_b);
                   });
  impl->excluded = excluded_geometries_;
  std::sort(impl->excluded.begin(), impl->excluded.end());
  for (const auto& [a, b] : excluded_bodies_) impl->excluded_bodies.insert(World::Impl::pair_key(a, b));
  return std::make_shared<const World>(std::move(impl));
}

}  // namespace signorini
