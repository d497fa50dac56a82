#include "signorini/simulation/simulator.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <memory>

#include "signorini/errors.hpp"
#include "signorini/model/world_builder.hpp"
#include "signorini/rollout/rollout.hpp"
#include "signorini/simulation/inverse_dynamics.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using namespace signorini;

using Values = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Triangles = nb::ndarray<const int, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

nb::object view(Vector& x, nb::handle owner) {
  return nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<1>>(x.data(), {static_cast<std::size_t>(x.size())}, owner));
}

/// An array that Python has made for us to fill: cheaper than one of ours for it to own.
template <class T>
using Column = nb::ndarray<T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

template <class T>
nb::object array(const std::vector<T>& x) {
  return nb::cast(nb::ndarray<nb::numpy, const T, nb::ndim<1>>(x.data(), {x.size()}), nb::rv_policy::copy);
}

template <class T, std::size_t Dimensions>
nb::object owned(std::vector<T> x, std::array<std::size_t, Dimensions> shape) {
  auto* kept = new std::vector<T>(std::move(x));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::cast(nb::ndarray<nb::numpy, T>(kept->data(), Dimensions, shape.data(), owner));
}

/// Of n contacts: geometries (n, 2); position, frame by rows, distance, force, moment and velocity (n, 22); mode (n);
/// id (n).
nb::tuple columns(const std::vector<Contact>& contacts) {
  const std::size_t count = contacts.size();
  std::vector<int> geometries;
  std::vector<double> numbers;
  std::vector<std::uint8_t> modes;
  std::vector<std::uint64_t> ids;
  geometries.reserve(2 * count), numbers.reserve(22 * count), modes.reserve(count), ids.reserve(count);
  for (const Contact& contact : contacts) {
    geometries.insert(geometries.end(), {contact.geometry_a, contact.geometry_b});
    const auto add = [&](const Vector3& v) { numbers.insert(numbers.end(), v.data(), v.data() + 3); };
    add(contact.position);
    for (int row = 0; row < 3; ++row) add(contact.frame.row(row));
    numbers.push_back(contact.distance);
    add(contact.force), add(contact.moment), add(contact.velocity);
    modes.push_back(static_cast<std::uint8_t>(contact.mode));
    ids.push_back(contact.id);
  }
  return nb::make_tuple(
      owned<int, 2>(std::move(geometries), {count, 2}), owned<double, 2>(std::move(numbers), {count, 22}),
      owned<std::uint8_t, 1>(std::move(modes), {count}), owned<std::uint64_t, 1>(std::move(ids), {count}));
}

Shape convex(Values vertices, Triangles triangles) {
  ConvexMesh mesh;
  for (std::size_t i = 0; i < vertices.shape(0); ++i)
    mesh.vertices.emplace_back(vertices.data()[3 * i], vertices.data()[3 * i + 1], vertices.data()[3 * i + 2]);
  for (std::size_t i = 0; i < triangles.shape(0); ++i)
    mesh.triangles.push_back({triangles.data()[3 * i], triangles.data()[3 * i + 1], triangles.data()[3 * i + 2]});
  return Shape::convex(std::move(mesh));
}

Shape height_field(nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu> heights, double half_x,
                   double half_y, double base) {
  HeightGrid grid;
  // Of more, the shape says which counts it takes.
  grid.rows = static_cast<int>(std::min<std::size_t>(heights.shape(0), 1 << 20));
  grid.columns = static_cast<int>(std::min<std::size_t>(heights.shape(1), 1 << 20));
  grid.half_x = half_x, grid.half_y = half_y, grid.base = base;
  grid.heights.assign(heights.data(), heights.data() + heights.size());
  return Shape::height_field(std::move(grid));
}

void bind_model(nb::module_& m) {
  nb::enum_<JointType>(m, "JointType")
      .value("free", JointType::Free)
      .value("ball", JointType::Ball)
      .value("revolute", JointType::Revolute)
      .value("prismatic", JointType::Prismatic);
  nb::enum_<ShapeType>(m, "ShapeType")
      .value("sphere", ShapeType::Sphere)
      .value("box", ShapeType::Box)
      .value("capsule", ShapeType::Capsule)
      .value("cylinder", ShapeType::Cylinder)
      .value("ellipsoid", ShapeType::Ellipsoid)
      .value("half_space", ShapeType::HalfSpace)
      .value("convex", ShapeType::Convex)
      .value("height_field", ShapeType::HeightField);
  nb::enum_<ConstraintType>(m, "ConstraintType")
      .value("connect", ConstraintType::Connect)
      .value("weld", ConstraintType::Weld)
      .value("coupling", ConstraintType::Coupling);
  nb::enum_<Activation>(m, "Activation")
      .value("none", Activation::None)
      .value("integrator", Activation::Integrator)
      .value("filter", Activation::Filter);
  nb::enum_<FrictionMix>(m, "FrictionMix")
      .value("geometric", FrictionMix::Geometric)
      .value("maximum", FrictionMix::Maximum);
  nb::class_<Placement>(m, "Placement")
      .def(nb::init<>())
      .def_rw("rotation", &Placement::rotation)
      .def_rw("translation", &Placement::translation);
  nb::class_<Material>(m, "Material")
      .def(nb::init<>())
      .def_rw("friction", &Material::friction)
      .def_rw("restitution", &Material::restitution)
      .def_rw("stiffness", &Material::stiffness)
      .def_rw("damping", &Material::damping)
      .def_rw("friction_mix", &Material::friction_mix)
      .def_rw("torsion", &Material::torsion)
      .def_rw("rolling", &Material::rolling)
      .def_rw("condim", &Material::condim)
      .def_rw("priority", &Material::priority)
      .def("validate", [](const Material& self, const std::string& field) { self.validate(field.c_str()); });
  m.def("mix", &mix);
  nb::class_<Shape>(m, "Shape")
      .def_static("sphere", &Shape::sphere)
      .def_static("box", &Shape::box)
      .def_static("capsule", &Shape::capsule)
      .def_static("cylinder", &Shape::cylinder)
      .def_static("ellipsoid", &Shape::ellipsoid)
      .def_static("half_space", &Shape::half_space)
      .def_static("convex", &convex)
      .def_static("height_field", &height_field)
      .def_ro("type", &Shape::type)
      .def_ro("size", &Shape::size)
      .def_prop_ro("vertices",
                   [](const Shape& self) {
                     Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> out(0, 3);
                     if (self.mesh) {
                       out.resize(static_cast<Index>(self.mesh->vertices.size()), 3);
                       for (Index i = 0; i < out.rows(); ++i)
                         out.row(i) = self.mesh->vertices[static_cast<std::size_t>(i)].transpose();
                     }
                     return out;
                   })
      .def_prop_ro("heights",
                   [](const Shape& self) {
                     Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> out;
                     if (const auto& grid = self.height_grid)
                       out = Eigen::Map<const decltype(out)>(grid->heights.data(), grid->rows, grid->columns);
                     return out;
                   })
      .def_prop_ro("field_size",
                   [](const Shape& self) {
                     const auto& grid = self.height_grid;
                     return grid ? Vector3(grid->half_x, grid->half_y, grid->base) : Vector3(Vector3::Zero());
                   })
      .def_prop_ro("triangles", [](const Shape& self) {
        Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor> out(0, 3);
        if (self.mesh) {
          out.resize(static_cast<Index>(self.mesh->triangles.size()), 3);
          for (Index i = 0; i < out.rows(); ++i)
            for (Index k = 0; k < 3; ++k)
              out(i, k) = self.mesh->triangles[static_cast<std::size_t>(i)][static_cast<std::size_t>(k)];
        }
        return out;
      });
  nb::class_<Joint>(m, "Joint")
      .def(nb::init<>())
      .def_rw("name", &Joint::name)
      .def_rw("type", &Joint::type)
      .def_rw("axis", &Joint::axis)
      .def_rw("anchor", &Joint::anchor)
      .def_rw("reference", &Joint::reference)
      .def_rw("lower", &Joint::lower)
      .def_rw("upper", &Joint::upper)
      .def_rw("limit_stiffness", &Joint::limit_stiffness)
      .def_rw("limit_damping", &Joint::limit_damping)
      .def_rw("armature", &Joint::armature)
      .def_rw("damping", &Joint::damping)
      .def_rw("friction", &Joint::friction)
      .def_rw("stiffness", &Joint::stiffness)
      .def_rw("spring_reference", &Joint::spring_reference)
      .def_ro("body", &Joint::body)
      .def_ro("q_index", &Joint::q_index)
      .def_ro("v_index", &Joint::v_index)
      .def_prop_ro("num_q", &Joint::num_q)
      .def_prop_ro("num_v", &Joint::num_v);
  nb::class_<Body>(m, "Body")
      .def(nb::init<>())
      .def_rw("name", &Body::name)
      .def_rw("parent", &Body::parent)
      .def_rw("placement", &Body::placement)
      .def_rw("mass", &Body::mass)
      .def_rw("center", &Body::center)
      .def_rw("inertia", &Body::inertia)
      .def_rw("gravity_compensation", &Body::gravity_compensation)
      .def_rw("joints", &Body::joints)
      .def_ro("frame", &Body::frame)
      .def_ro("in_frame", &Body::in_frame);
  m.def("inertia_fault", &inertia_fault);
  nb::class_<Geometry>(m, "Geometry")
      .def(nb::init<>())
      .def_rw("name", &Geometry::name)
      .def_rw("body", &Geometry::body)
      .def_rw("shape", &Geometry::shape)
      .def_rw("placement", &Geometry::placement)
      .def_rw("material", &Geometry::material)
      .def_rw("group", &Geometry::group)
      .def_rw("mask", &Geometry::mask);
  nb::class_<EqualityConstraint>(m, "EqualityConstraint")
      .def(nb::init<>())
      .def_rw("name", &EqualityConstraint::name)
      .def_rw("type", &EqualityConstraint::type)
      .def_rw("body_a", &EqualityConstraint::body_a)
      .def_rw("body_b", &EqualityConstraint::body_b)
      .def_rw("placement_a", &EqualityConstraint::placement_a)
      .def_rw("placement_b", &EqualityConstraint::placement_b)
      .def_rw("joint_a", &EqualityConstraint::joint_a)
      .def_rw("joint_b", &EqualityConstraint::joint_b)
      .def_rw("tendon_a", &EqualityConstraint::tendon_a)
      .def_rw("tendon_b", &EqualityConstraint::tendon_b)
      .def_prop_rw(
          "coefficients",
          [](const EqualityConstraint& self) { return std::vector<double>(self.coefficients, self.coefficients + 5); },
          [](EqualityConstraint& self, const std::vector<double>& x) {
            for (std::size_t k = 0; k < 5; ++k) self.coefficients[k] = k < x.size() ? x[k] : 0.0;
          })
      .def_rw("reference_a", &EqualityConstraint::reference_a)
      .def_rw("reference_b", &EqualityConstraint::reference_b)
      .def_rw("stiffness", &EqualityConstraint::stiffness)
      .def_rw("damping", &EqualityConstraint::damping)
      .def_rw("turn_stiffness", &EqualityConstraint::turn_stiffness)
      .def_rw("turn_damping", &EqualityConstraint::turn_damping);
  nb::class_<Tendon>(m, "Tendon")
      .def(nb::init<>())
      .def_rw("name", &Tendon::name)
      .def_prop_rw(
          "terms",
          [](const Tendon& self) {
            std::vector<std::pair<int, double>> terms;
            for (const Tendon::Term& term : self.terms) terms.emplace_back(term.joint, term.coefficient);
            return terms;
          },
          [](Tendon& self, const std::vector<std::pair<int, double>>& terms) {
            self.terms.clear();
            for (const auto& [joint, coefficient] : terms) self.terms.push_back({joint, coefficient});
          })
      .def_rw("lower", &Tendon::lower)
      .def_rw("upper", &Tendon::upper)
      .def_rw("limit_stiffness", &Tendon::limit_stiffness)
      .def_rw("limit_damping", &Tendon::limit_damping)
      .def_rw("stiffness", &Tendon::stiffness)
      .def_rw("spring_lower", &Tendon::spring_lower)
      .def_rw("spring_upper", &Tendon::spring_upper)
      .def_rw("damping", &Tendon::damping)
      .def_rw("friction", &Tendon::friction);
  nb::class_<ContactPair>(m, "ContactPair")
      .def(nb::init<>())
      .def_rw("geometry_a", &ContactPair::geometry_a)
      .def_rw("geometry_b", &ContactPair::geometry_b)
      .def_rw("material", &ContactPair::material);
  nb::class_<Actuator>(m, "Actuator")
      .def(nb::init<>())
      .def_rw("name", &Actuator::name)
      .def_rw("joint", &Actuator::joint)
      .def_rw("component", &Actuator::component)
      .def_rw("tendon", &Actuator::tendon)
      .def_rw("body", &Actuator::body)
      .def_rw("placement", &Actuator::placement)
      .def_prop_rw(
          "wrench", [](const Actuator& self) { return std::vector<double>(self.wrench, self.wrench + 6); },
          [](Actuator& self, const std::vector<double>& x) {
            for (std::size_t k = 0; k < 6; ++k) self.wrench[k] = k < x.size() ? x[k] : 0.0;
          })
      .def_rw("gear", &Actuator::gear)
      .def_rw("gain", &Actuator::gain)
      .def_rw("bias", &Actuator::bias)
      .def_rw("activation", &Actuator::activation)
      .def_rw("time_constant", &Actuator::time_constant)
      .def_rw("activation_lower", &Actuator::activation_lower)
      .def_rw("activation_upper", &Actuator::activation_upper)
      .def_rw("control_lower", &Actuator::control_lower)
      .def_rw("control_upper", &Actuator::control_upper)
      .def_rw("force_lower", &Actuator::force_lower)
      .def_rw("force_upper", &Actuator::force_upper);
  nb::class_<WorldBuilder>(m, "WorldBuilder")
      .def(nb::init<const Vector3&>())
      .def("add_body", &WorldBuilder::add_body)
      .def("add_geometry", &WorldBuilder::add_geometry)
      .def("add_tendon", &WorldBuilder::add_tendon)
      .def("add_contact_pair", &WorldBuilder::add_contact_pair)
      .def("add_constraint", &WorldBuilder::add_constraint)
      .def("add_actuator", &WorldBuilder::add_actuator)
      .def("exclude_bodies", &WorldBuilder::exclude_bodies)
      .def("exclude_geometries", &WorldBuilder::exclude_geometries)
      .def("find_body", &WorldBuilder::find_body)
      .def("find_joint", &WorldBuilder::find_joint)
      .def("build", &WorldBuilder::build, nb::call_guard<nb::gil_scoped_release>());
  nb::class_<World>(m, "World")
      .def_prop_ro("num_q", &World::num_q)
      .def_prop_ro("num_v", &World::num_v)
      .def_prop_ro("num_controls", &World::num_controls)
      .def_prop_ro("num_frames", &World::num_frames)
      .def_prop_ro("bodies", &World::bodies)
      .def_prop_ro("joints", &World::joints)
      .def_prop_ro("geometries", &World::geometries)
      .def_prop_ro("constraints", &World::constraints)
      .def_prop_ro("tendons", &World::tendons)
      .def_prop_ro("actuators", &World::actuators)
      .def_prop_ro("contact_pairs", &World::contact_pairs)
      .def("tendon_lengths",
           [](const World& self, const Vector& q) {
             Vector lengths(static_cast<Index>(self.tendons().size()));
             for (std::size_t t = 0; t < self.tendons().size(); ++t)
               lengths[static_cast<Index>(t)] = tendon_length(self, self.tendons()[t], q);
             return lengths;
           })
      .def_prop_ro("excluded_pairs", &World::excluded_pairs)
      .def_prop_ro("gravity", &World::gravity)
      .def_prop_ro("initial_q", [](const World& self) { return Vector(self.initial_q()); })
      .def("may_touch", &World::may_touch)
      .def("material", &World::material)
      .def("frame_placements",
           [](const std::shared_ptr<const World>& self, const Vector& q) {
             if (q.size() != self->num_q())
               throw InvalidInput(
                   "q", "has " + std::to_string(q.size()) + " values, must have " + std::to_string(self->num_q()));
             Dynamics dynamics(self);
             dynamics.update_placements(q);
             return dynamics.frames();
           })
      .def("jacobian",
           [](const std::shared_ptr<const World>& self, const Vector& q, int body, const Vector3& point) {
             Dynamics dynamics(self);
             return dynamics.jacobian(q, body, point);
           })
      .def("integrate",
           [](const World& self, const Vector& q, const Vector& v, double time_step) {
             if (q.size() != self.num_q() || v.size() != self.num_v())
               throw InvalidInput("q, v", "must have " + std::to_string(self.num_q()) + " and " +
                                              std::to_string(self.num_v()) + " values");
             Vector next(q.size());
             self.integrate(q, v, time_step, next);
             return next;
           })
      .def("touching_pairs", [](const std::shared_ptr<const World>& self, const Vector& q, double margin) {
        nb::list out;
        for (const TouchingPair& pair : touching_pairs(self, q, margin))
          out.append(nb::make_tuple(pair.geometry_a, pair.geometry_b, pair.distance));
        return out;
      });
}

void bind_simulation(nb::module_& m) {
  nb::class_<SimulatorSettings>(m, "SimulatorSettings")
      .def(nb::init<>())
      .def_rw("time_step", &SimulatorSettings::time_step)
      .def_rw("baumgarte", &SimulatorSettings::baumgarte)
      .def_rw("max_correction_speed", &SimulatorSettings::max_correction_speed)
      .def_rw("restitution_threshold", &SimulatorSettings::restitution_threshold)
      .def_rw("contact_margin", &SimulatorSettings::contact_margin)
      .def_prop_rw(
          "law", [](const SimulatorSettings& self) { return self.solver.law; },
          [](SimulatorSettings& self, Law law) { self.solver.law = law; })
      .def_prop_rw(
          "solver", [](const SimulatorSettings& self) { return self.solver.solver; },
          [](SimulatorSettings& self, SolverType solver) { self.solver.solver = solver; })
      .def_prop_rw(
          "tolerance", [](const SimulatorSettings& self) { return self.solver.tolerance; },
          [](SimulatorSettings& self, double tolerance) { self.solver.tolerance = tolerance; })
      .def_prop_rw(
          "max_iterations", [](const SimulatorSettings& self) { return self.solver.max_iterations; },
          [](SimulatorSettings& self, int max_iterations) { self.solver.max_iterations = max_iterations; })
      .def_prop_rw(
          "facets", [](const SimulatorSettings& self) { return self.solver.pyramid.facets; },
          [](SimulatorSettings& self, int facets) { self.solver.pyramid.facets = facets; })
      .def_prop_rw(
          "impedance", [](const SimulatorSettings& self) { return self.solver.convex.impedance; },
          [](SimulatorSettings& self, double impedance) { self.solver.convex.impedance = impedance; })
      .def("validate", &SimulatorSettings::validate);
  nb::class_<StepReport>(m, "StepReport")
      .def_ro("status", &StepReport::status)
      .def_ro("solver", &StepReport::solver)
      .def_ro("residual", &StepReport::residual)
      .def_ro("iterations", &StepReport::iterations)
      .def_ro("factorizations", &StepReport::factorizations)
      .def_ro("num_contacts", &StepReport::num_contacts)
      .def_ro("num_constraints", &StepReport::num_constraints)
      .def_ro("deepest_overlap", &StepReport::deepest_overlap)
      .def_ro("steps", &StepReport::steps)
      .def_ro("unsolved", &StepReport::unsolved);
  nb::class_<Simulator>(m, "Simulator")
      .def("__init__", [](Simulator* self, const std::shared_ptr<const World>& world,
                          const SimulatorSettings& settings) { new (self) Simulator(world, settings); })
      .def_prop_ro("q", [](nb::handle self) { return view(nb::cast<Simulator&>(self).q(), self); })
      .def_prop_ro("v", [](nb::handle self) { return view(nb::cast<Simulator&>(self).v(), self); })
      .def_prop_rw(
          "time", [](Simulator& self) { return self.time(); }, [](Simulator& self, double time) { self.time() = time; })
      .def_prop_ro("control", [](nb::handle self) { return view(nb::cast<Simulator&>(self).control(), self); })
      .def_prop_ro("activation", [](nb::handle self) { return view(nb::cast<Simulator&>(self).activation(), self); })
      .def_prop_ro("applied_force",
                   [](nb::handle self) { return view(nb::cast<Simulator&>(self).applied_force(), self); })
      .def_prop_ro("external_wrench",
                   [](nb::handle self) {
                     Matrix& w = nb::cast<Simulator&>(self).external_wrench();
                     return nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<2>>(
                         w.data(), {static_cast<std::size_t>(w.cols()), std::size_t{6}}, self));
                   })
      .def(
          "step",
          [](Simulator& self, Index num_steps) {
            for (Index k = 0; k < num_steps; ++k) self.step();
          },
          "num_steps"_a, nb::call_guard<nb::gil_scoped_release>())
      .def(
          "run",
          [](Simulator& self, Index num_steps, const Matrix& controls, bool keep_states, Column<double> seconds,
             Column<double> relative, Column<double> penetration, Column<int> iterations, Column<int> factorizations,
             Column<int> num_contacts, Column<bool> solved) -> nb::object {
            Trace trace;
            Matrix states;
            {
              const nb::gil_scoped_release release;
              run(self, num_steps, controls, trace, keep_states ? &states : nullptr);
            }
            const auto fill = [](const auto& from, const auto& to) {
              if (to.shape(0) != from.size()) throw InvalidInput("num_steps", "is not the length of the arrays");
              std::copy(from.begin(), from.end(), to.data());
            };
            fill(trace.seconds, seconds), fill(trace.relative, relative), fill(trace.penetration, penetration);
            fill(trace.iterations, iterations), fill(trace.factorizations, factorizations);
            fill(trace.num_contacts, num_contacts), fill(trace.solved, solved);
            return keep_states ? nb::cast(states) : nb::none();
          },
          "num_steps"_a, "controls"_a, "keep_states"_a, "seconds"_a, "relative"_a, "penetration"_a, "iterations"_a,
          "factorizations"_a, "num_contacts"_a, "solved"_a)
      .def_prop_ro("report", &Simulator::report)
      .def("contacts", [](const Simulator& self) { return columns(self.contacts()); })
      .def("contact_force", &Simulator::contact_force)
      .def("kinetic_energy", &Simulator::kinetic_energy)
      .def("potential_energy", &Simulator::potential_energy)
      .def("momentum", [](Simulator& self) { return Vector(self.momentum()); })
      .def("mass_matrix", &Simulator::mass_matrix)
      .def("frames", [](Simulator& self) { return self.frames(); })
      .def("reset", &Simulator::reset)
      .def("save",
           [](const Simulator& self) {
             const std::string bytes = self.save();
             return nb::bytes(bytes.data(), bytes.size());
           })
      .def("restore", [](Simulator& self, nb::bytes bytes) { self.restore(std::string(bytes.c_str(), bytes.size())); })
      .def_prop_ro("state_hash", &Simulator::state_hash)
      .def("problem_arrays", [](Simulator& self) {  // of the last step
        const ContactProblem p = self.contact_problem();
        nb::dict out;
        std::vector<int> types;
        std::vector<double> first, second;
        for (const ConstraintSet& set : p.sets()) {
          types.push_back(static_cast<int>(set.type));
          first.push_back(set.type == SetType::FrictionCone ? set.friction : set.lower);
          second.push_back(set.upper);
        }
        out["delassus"] = nb::cast(Matrix(p.delassus().matrix()));
        out["free_velocity"] = nb::cast(Vector(p.free_velocity()));
        out["compliance"] = nb::cast(Vector(p.compliance()));
        out["types"] = nb::cast(types);
        out["first"] = nb::cast(first);
        out["second"] = nb::cast(second);
        return out;
      });
  m.def(
      "rollout",
      [](const std::shared_ptr<const World>& world, const SimulatorSettings& settings, Values initial, Values controls,
         Index num_steps, int num_threads) {
        const auto num = static_cast<Index>(initial.shape(0));
        const Index width = world->num_q() + world->num_v();
        auto* states = new std::vector<double>(static_cast<std::size_t>(num * num_steps * width));
        const nb::capsule owner(states, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
        std::vector<std::int64_t> unsolved(static_cast<std::size_t>(num));
        const double* given = controls.size() > 0 ? controls.data() : nullptr;
        {
          const nb::gil_scoped_release release;
          rollout(world, settings, initial.data(), given, num, {num_steps, num_threads}, states->data(),
                  unsolved.data());
        }
        return std::make_pair(
            nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<3>>(
                states->data(),
                {static_cast<std::size_t>(num), static_cast<std::size_t>(num_steps), static_cast<std::size_t>(width)},
                owner)),
            array(unsolved));
      },
      "world"_a, "settings"_a, "initial"_a, "controls"_a, "num_steps"_a, "num_threads"_a);
}

void bind_inverse_dynamics(nb::module_& m) {
  using Input = InverseDynamics::Input;
  nb::class_<Input>(m, "InverseInput")
      .def(nb::init<>())
      .def_rw("v", &Input::v)
      .def_rw("v_next", &Input::v_next)
      .def_rw("control", &Input::control)
      .def_rw("external_wrench", &Input::external_wrench)
      .def_rw("impulse_guess", &Input::impulse_guess)
      .def_rw("moment_guess", &Input::moment_guess)
      .def_rw("closest", &Input::closest)
      .def_rw("actuated", &Input::actuated);
  nb::class_<InverseDynamicsResult>(m, "InverseDynamicsResult")
      .def_ro("status", &InverseDynamicsResult::status)
      .def_ro("residual", &InverseDynamicsResult::residual)
      .def_ro("relative", &InverseDynamicsResult::relative)
      .def_ro("iterations", &InverseDynamicsResult::iterations)
      .def_ro("force", &InverseDynamicsResult::force)
      .def_ro("v_next", &InverseDynamicsResult::v_next)
      .def_ro("contact_impulse", &InverseDynamicsResult::contact_impulse);
  nb::class_<InverseDynamics>(m, "InverseDynamics")
      .def("__init__",
           [](InverseDynamics* self, const std::shared_ptr<const World>& world, const SimulatorSettings& settings,
              Law law, double proximal_weight, double tolerance, int max_iterations) {
             InverseSettings inverse;
             inverse.law = law;
             inverse.proximal_weight = proximal_weight;
             inverse.tolerance = tolerance;
             inverse.max_iterations = max_iterations;
             new (self) InverseDynamics(world, settings, inverse);
           })
      .def_static("actuated", &InverseDynamics::actuated)
      .def("set_configuration", [](InverseDynamics& self, const Vector& q) { self.set_configuration(q); })
      .def(
          "solve",
          [](InverseDynamics& self, Input& input, const Simulator* simulator) {
            input.simulator = simulator;
            return self.solve(input);
          },
          "input"_a, "simulator"_a.none(), nb::call_guard<nb::gil_scoped_release>())
      .def(
          "seconds",  // a call, contact points given, for those who compare; set_configuration() comes before
          [](InverseDynamics& self, const Vector& q, Input& input, int repetitions) {
            const std::vector<ContactPoint> points = self.points();
            const auto start = std::chrono::steady_clock::now();
            for (int k = 0; k < repetitions; ++k) {
              self.set_configuration(q, points);
              self.solve(input);
            }
            return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() / repetitions;
          },
          nb::call_guard<nb::gil_scoped_release>())
      .def("contacts", [](const InverseDynamics& self) { return columns(self.contacts()); })
      .def("points",  // as contacts without force or velocity
           [](const InverseDynamics& self) {
             std::vector<Contact> list;
             for (const ContactPoint& point : self.points()) {
               Contact contact;
               contact.geometry_a = point.geometry_a;
               contact.geometry_b = point.geometry_b;
               contact.position = point.position;
               contact.frame = contact_frame(point.normal);
               contact.distance = point.distance;
               contact.id = point.id;
               list.push_back(contact);
             }
             return columns(list);
           })
      .def("impulse", [](const InverseDynamics& self) { return Vector(self.impulse()); })
      .def("warm_start", [](const InverseDynamics& self,
                            Simulator& simulator) { simulator.warm_start(self.assembler().sets(), self.impulse()); })
      .def("worst", &InverseDynamics::worst);
}

}  // namespace

NB_MODULE(_simulator, m) {
  m.doc() = "The simulator's C++ core. Private: use the package signorini.";
  // Law, SolverType, Status and Residual are bound there, once for both.
  const nb::object error = nb::module_::import_("signorini._core").attr("InvalidInputError");
  nb::register_exception_translator(
      [](const std::exception_ptr& p, void* type) {
        try {
          std::rethrow_exception(p);
        } catch (const InvalidInput& e) {
          PyErr_SetString(static_cast<PyObject*>(type), e.what());
        }
      },
      nb::object(error).release().ptr());
  bind_model(m);
  bind_simulation(m);
  bind_inverse_dynamics(m);
}
