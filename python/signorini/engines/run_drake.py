"""Drake: MultibodyPlant in discrete time: default; SAP with point contacts near rigid; hydroelastic patches.

Without hydroelastic properties, as by default, two bodies touch in one point, the deepest: a box on the ground rocks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import _worker
import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
)
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, RotationalInertia, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

MODULUS = 1e8  # [Pa], of hydroelastic bodies; the ground is rigid
RESOLUTION = 0.05  # [m], of their meshes
STICTION = 1e-6  # [m/s]: TAMSI lets what sticks creep at about that


def transform(pose: dict[str, Any]) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(np.array(pose["rotation"])), pose["position"])


def shape_of(geometry: dict[str, Any]) -> Any:
    x, y, z = geometry["size"]
    match geometry["shape"]:
        case "sphere":
            return Sphere(x)
        case "box":
            return Box(2 * x, 2 * y, 2 * z)
        case "capsule":
            return Capsule(x, 2 * y)
        case "cylinder":
            return Cylinder(x, 2 * y)
        case "ellipsoid":
            return Ellipsoid(x, y, z)
        case "half_space":
            return HalfSpace()
    return Convex(np.array(geometry["vertices"]).T, geometry["mesh"])


class Engine:
    """Bodies, joints and shapes by the plant's own calls."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        if model["restitution"] > 0.0:
            raise ValueError(_worker.NO_RESTITUTION)
        self.links, self.layout, self.model = model["links"], _worker.layout(model), model
        builder = DiagramBuilder()
        plant, scene = AddMultibodyPlantSceneGraph(builder, time_step)
        self.plant, self.time_step, self.time = plant, time_step, 0.0
        plant.mutable_gravity_field().set_gravity_vector(model["gravity"])
        plant.set_adjacent_bodies_collision_filters(False)  # all pairs that never touch are listed
        if setting == "near rigid":
            plant.set_contact_model(ContactModel.kPoint)
            plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        elif setting == "hydroelastic":
            tamsi = not model["loops"]  # it has no constraints
            approximation = DiscreteContactApproximation.kTamsi if tamsi else DiscreteContactApproximation.kSap
            plant.set_discrete_contact_approximation(approximation)
            plant.set_stiction_tolerance(STICTION)
        bodies = [self._body(link) for link in self.links] + [plant.world_body()]  # -1 is the world
        self.bodies, self.joints = bodies, [self._joint(k, bodies) for k in range(len(self.links))]
        for k, geometry in enumerate(model["geometries"]):
            properties = self._properties(geometry, setting)
            body = bodies[geometry["link"]]
            plant.RegisterCollisionGeometry(body, transform(geometry), shape_of(geometry), f"g{k}", properties)
        for loop in model["loops"]:
            ends = bodies[loop["link_a"]], loop["point_a"], bodies[loop["link_b"]], loop["point_b"]
            plant.AddBallConstraint(*ends)
        plant.Finalize()
        self.inspector = scene.model_inspector()
        filters = scene.collision_filter_manager()
        for a, b in model["excluded"]:
            sets = [GeometrySet(plant.GetCollisionGeometriesForBody(bodies[k])) for k in (a, b)]
            filters.Apply(CollisionFilterDeclaration().ExcludeBetween(*sets))
        diagram = builder.Build()
        self.simulator = Simulator(diagram)
        self.context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def _properties(self, geometry: dict[str, Any], setting: str) -> Any:
        properties = ProximityProperties()
        mu = CoulombFriction(geometry["friction"], geometry["friction"])
        if setting == "near rigid":
            AddContactMaterial(dissipation=0.0, point_stiffness=1e12, friction=mu, properties=properties)
            properties.AddProperty("material", "relaxation_time", self.time_step)
        elif setting == "hydroelastic":
            AddContactMaterial(dissipation=1.0, friction=mu, properties=properties)
            if geometry["shape"] == "half_space":
                AddRigidHydroelasticProperties(properties)
            else:
                AddCompliantHydroelasticProperties(RESOLUTION, MODULUS, properties)
        else:
            AddContactMaterial(friction=mu, properties=properties)
        return properties

    def _body(self, link: dict[str, Any]) -> Any:
        mass = link["mass"]
        if mass == 0.0:
            return self.plant.AddRigidBody(link["name"], SpatialInertia.Zero())
        i = np.array(link["inertia"])
        about = RotationalInertia(i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return self.plant.AddRigidBody(
            link["name"], SpatialInertia.MakeFromCentralInertia(mass, np.array(link["center"]), about)
        )

    def _joint(self, k: int, bodies: list[Any]) -> Any:
        link = self.links[k]
        if link["type"] == "free":
            return None
        if link["type"] == "ball":
            raise ValueError("ball joints have other coordinates in Drake")
        parent = bodies[link["parent"]]
        frame = self.plant.AddFrame(FixedOffsetFrame(f"{link['name']} at", parent.body_frame(), transform(link)))
        kind = RevoluteJoint if link["type"] == "revolute" else PrismaticJoint
        return self.plant.AddJoint(kind(link["name"], frame, bodies[k].body_frame(), link["axis"]))

    def set_state(self, q: Any) -> None:
        for k, (first, _, _, _) in enumerate(self.layout):
            if self.joints[k] is None:
                pose = RigidTransform(RotationMatrix(_worker.rotation(q[first + 3 : first + 7])), q[first : first + 3])
                self.plant.SetFreeBodyPose(self.context, self.bodies[k], pose)
            elif self.links[k]["type"] == "revolute":
                self.joints[k].set_angle(self.context, q[first])
            else:
                self.joints[k].set_translation(self.context, q[first])
        self.simulator.Initialize()

    def state(self) -> tuple[Any, Any]:
        q, v = np.zeros(sum(x[1] for x in self.layout)), np.zeros(sum(x[3] for x in self.layout))
        for k, (first, _, at, _) in enumerate(self.layout):
            joint, body = self.joints[k], self.bodies[k]
            if joint is None:
                pose = self.plant.GetFreeBodyPose(self.context, body)
                velocity = body.EvalSpatialVelocityInWorld(self.context)
                turn = pose.rotation().matrix()
                w, x, y, z = pose.rotation().ToQuaternion().wxyz()
                q[first : first + 7] = [*pose.translation(), x, y, z, w]
                v[at : at + 6] = [*(turn.T @ velocity.translational()), *(turn.T @ velocity.rotational())]
            elif self.links[k]["type"] == "revolute":
                q[first], v[at] = joint.get_angle(self.context), joint.get_angular_rate(self.context)
            else:
                q[first], v[at] = joint.get_translation(self.context), joint.get_translation_rate(self.context)
        return q, v

    def step(self, count: int) -> None:
        self.time += count * self.time_step
        self.simulator.AdvanceTo(self.time)

    def mass_matrix(self) -> Any:
        if all(joint is None for joint in self.joints):
            return None
        full = self.plant.CalcMassMatrix(self.context)
        order = [joint.velocity_start() for joint in self.joints if joint is not None]
        return full[np.ix_(order, order)]

    def total_mass(self) -> float:
        return float(self.plant.CalcTotalMass(self.context))

    def report(self) -> dict[str, Any]:
        links: list[Any] = []
        for body in self.bodies[:-1]:
            mass, c = body.default_mass(), body.default_com()
            about = body.default_rotational_inertia().CopyToFullMatrix3()  # the body's origin
            central = about - mass * (c @ c * np.eye(3) - np.outer(c, c))
            links.append([mass, *_worker.principal(central)] if mass > 0.0 else None)
        joints = [joint for joint in self.joints if joint is not None]
        return {
            "time_step": self.plant.time_step(),
            "gravity": self.plant.gravity_field().gravity_vector().tolist(),
            "links": links,
            "limits": sum(bool(np.isfinite(joint.position_lower_limits()).any()) for joint in joints),
            "damping": max((joint.default_damping() for joint in joints), default=0.0),
            "pairs": self._pairs(),
        }

    def _pairs(self) -> list[list[int]]:
        of = [(k, self.plant.GetCollisionGeometriesForBody(self.bodies[k])) for k in range(-1, len(self.links))]
        found = [
            [a, b]
            for n, (a, first) in enumerate(of)
            for b, second in of[n + 1 :]
            if any(not self.inspector.CollisionFiltered(x, y) for x in first for y in second)
        ]
        return sorted(found)

    def touching(self) -> list[Any]:
        results = self.plant.get_contact_results_output_port().Eval(self.context)
        number = {body.index(): k for k, body in enumerate(self.bodies[:-1])}
        points = (results.point_pair_contact_info(k) for k in range(results.num_point_pair_contacts()))
        out = [[number.get(c.bodyA_index(), -1), number.get(c.bodyB_index(), -1)] for c in points]
        frames = {}
        for body in self.bodies:
            for geometry in self.plant.GetCollisionGeometriesForBody(body):
                frames[geometry] = number.get(body.index(), -1)
        surfaces = (results.hydroelastic_contact_info(k) for k in range(results.num_hydroelastic_contacts()))
        ends = ((s.contact_surface().id_M(), s.contact_surface().id_N()) for s in surfaces)
        return out + [[frames[a], frames[b]] for a, b in ends]

    def extra(self) -> dict[str, float]:
        return {}


if __name__ == "__main__":
    import importlib.metadata

    _worker.main(importlib.metadata.version("drake"), Engine)
