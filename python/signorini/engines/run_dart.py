"""DART: Dantzig's method on friction pyramids, its default, or nonsmooth Gauss-Seidel on exact cones.

Collision is Bullet's: FCL, its default, takes capsules and planes for something else. Hulls are triangle meshes: as a
MultiSphereConvexHullShape they would touch 4 cm before they do.
"""

from __future__ import annotations

import importlib.metadata
import math
from pathlib import Path
from typing import Any

import _worker
import dartpy
import numpy as np

dynamics = dartpy.dynamics
MASSLESS = 1e-6  # kg, kg m^2


def isometry(rotation: Any, position: Any) -> Any:
    out = dartpy.math.Isometry3()
    out.set_rotation(np.array(rotation))
    out.set_translation(np.array(position))
    return out


def mesh(path: Path) -> Any:
    """Only the reader of URDF files makes mesh shapes."""
    geometry = f'<geometry><mesh filename="{path}"/></geometry>'
    robot = f'<robot name="one"><link name="one"><collision>{geometry}</collision></link></robot>'
    skeleton = dartpy.utils.DartLoader().parseSkeletonString(robot, dartpy.common.Uri(), None)
    return skeleton.getBodyNode(0).getShapeNode(0).getShape()


def shape_of(folder: Path, geometry: dict[str, Any]) -> Any:
    x, y, z = geometry["size"]
    match geometry["shape"]:
        case "sphere":
            return dynamics.SphereShape(x)
        case "box":
            return dynamics.BoxShape([2 * x, 2 * y, 2 * z])
        case "capsule":
            return dynamics.CapsuleShape(x, 2 * y)
        case "cylinder":
            return dynamics.CylinderShape(x, 2 * y)
        case "half_space":
            return dynamics.PlaneShape([0.0, 0.0, 1.0], 0.0)
        case "convex":
            return mesh(folder / geometry["mesh"])
    raise ValueError(f"Bullet's collision detector in DART has no {geometry['shape']}")


class Engine:
    """A skeleton for each link that hangs on the world, and one for what is fixed."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        self.links, self.layout = model["links"], _worker.layout(model)
        self.world = dartpy.simulation.World()
        self.world.setGravity(model["gravity"])
        self.world.setTimeStep(time_step)
        self.world.setCollisionDetector(dartpy.collision.BulletCollisionDetector())
        solver = self.world.getConstraintSolver()
        if setting == "exact friction":
            options = dartpy.constraint.NsgsFrictionSolver.Options()
            options.maxSweeps, options.tolerance = 1000, 1e-8
            solver.setBoxedLcpSolver(dartpy.constraint.NsgsFrictionSolver(options))
        self.bodies: list[Any] = []
        self.joints: list[Any] = []
        self.skeletons: list[Any] = []
        of: list[Any] = []
        for k, link in enumerate(self.links):
            if link["parent"] == -1:
                of.append(dynamics.Skeleton(f"tree-{k}"))
                self.skeletons.append(of[-1])
            else:
                of.append(of[link["parent"]])
            self._add(of[-1], link)
        fixed = dynamics.Skeleton("fixed")
        _, self.ground = fixed.createWeldJointAndBodyNodePair(None)
        self.skeletons.append(fixed)
        for geometry in model["geometries"]:
            body = self.bodies[geometry["link"]] if geometry["link"] >= 0 else self.ground
            node = body.createShapeNode(shape_of(folder, geometry))
            node.setRelativeTransform(isometry(geometry["rotation"], geometry["position"]))
            node.createCollisionAspect()
            node.createDynamicsAspect()
            node.getDynamicsAspect().setFrictionCoeff(geometry["friction"])
            node.getDynamicsAspect().setRestitutionCoeff(math.sqrt(model["restitution"]))  # it multiplies
        chosen = solver.getCollisionOption().collisionFilter
        for a, b in model["excluded"]:
            chosen.addBodyNodePairToBlackList(*(self.bodies[k] if k >= 0 else self.ground for k in (a, b)))
        for skeleton in self.skeletons:
            skeleton.setSelfCollisionCheck(skeleton is not fixed)
            skeleton.setAdjacentBodyCheck(True)  # pairs that never touch are listed
            self.world.addSkeleton(skeleton)
        self.loops = model["loops"]
        self.closed: list[Any] = []

    def _add(self, skeleton: Any, link: dict[str, Any]) -> None:
        parent = self.bodies[link["parent"]] if link["parent"] >= 0 else None
        kind = {"revolute": "Revolute", "prismatic": "Prismatic", "free": "Free", "ball": "Ball"}[link["type"]]
        if kind == "Ball":
            raise ValueError("ball joints have other coordinates in DART")
        joint, body = getattr(skeleton, f"create{kind}JointAndBodyNodePair")(parent)
        if kind != "Free":
            joint.setTransformFromParentBodyNode(isometry(link["rotation"], link["position"]))
            joint.setAxis(np.array(link["axis"]))
        mass, inertia = link["mass"], np.array(link["inertia"])
        if mass == 0.0:
            mass, inertia = MASSLESS, MASSLESS * np.eye(3)
        body.setInertia(dynamics.Inertia(mass, link["center"], inertia))
        self.joints.append(joint)
        self.bodies.append(body)

    def set_state(self, q: Any) -> None:
        for k, (first, _, _, _) in enumerate(self.layout):
            joint = self.joints[k]
            if self.links[k]["type"] == "free":
                pose = isometry(_worker.rotation(q[first + 3 : first + 7]), q[first : first + 3])
                joint.setPositions(dynamics.FreeJoint.convertToPositions(pose))
            else:
                joint.setPosition(0, q[first])
            joint.setVelocities(np.zeros(joint.getNumDofs()))
        for loop in self.loops if not self.closed else ():  # closed where they are now
            a, b = (self.bodies[loop[key]] for key in ("link_a", "link_b"))
            at = a.getWorldTransform().multiply(np.array(loop["point_a"]))
            self.closed.append(dartpy.constraint.BallJointConstraint(a, b, at))
            self.world.getConstraintSolver().addConstraint(self.closed[-1])

    def state(self) -> tuple[Any, Any]:
        q, v = np.zeros(sum(x[1] for x in self.layout)), np.zeros(sum(x[3] for x in self.layout))
        for k, (first, _, at, _) in enumerate(self.layout):
            joint, body = self.joints[k], self.bodies[k]
            if self.links[k]["type"] == "free":
                pose = body.getWorldTransform()
                r = np.array(pose.rotation())
                w, x, y, z = np.ravel(pose.quaternion().wxyz())
                q[first : first + 7] = [*np.ravel(pose.translation()), x, y, z, w]
                v[at : at + 3] = r.T @ np.ravel(body.getLinearVelocity())
                v[at + 3 : at + 6] = r.T @ np.ravel(body.getAngularVelocity())
            else:
                q[first], v[at] = joint.getPosition(0), joint.getVelocity(0)
        return q, v

    def step(self, count: int) -> None:
        for _ in range(count):
            self.world.step()

    def mass_matrix(self) -> Any:
        moving = [s for s in self.skeletons if s.getNumDofs()]
        rows = [self.joints[k].getIndexInSkeleton(0) for k in range(len(self.links)) if self.links[k]["type"] != "free"]
        if len(moving) != 1 or not rows:
            return None
        return np.array(moving[0].getMassMatrix())[np.ix_(rows, rows)]

    def total_mass(self) -> float:
        return float(sum(body.getMass() for body in self.bodies))

    def report(self) -> dict[str, Any]:
        links: list[Any] = []
        for link, body in zip(self.links, self.bodies, strict=True):
            inertia = body.getInertia()
            links.append([inertia.getMass(), *_worker.principal(inertia.getMoment())] if link["mass"] > 0.0 else None)
        dofs = [(joint, k) for joint in self.joints for k in range(joint.getNumDofs())]
        return {
            "time_step": self.world.getTimeStep(),
            "gravity": np.ravel(self.world.getGravity()).tolist(),
            "links": links,
            "limits": sum(joint.hasPositionLimit(k) and joint.areLimitsEnforced() for joint, k in dofs),
            "damping": max(
                (float(joint.getDampingCoefficient(k) + joint.getCoulombFriction(k)) for joint, k in dofs), default=0.0
            ),
            "pairs": None,
        }

    def touching(self) -> list[Any]:
        def name(body: Any) -> tuple[str, str]:
            return body.getSkeleton().getName(), body.getName()

        number = {name(body): k for k, body in enumerate(self.bodies)}
        number[name(self.ground)] = -1
        nodes = (
            [name(x.getShapeFrame().asShapeNode().getBodyNodePtr()) for x in (c.collisionObject1, c.collisionObject2)]
            for c in self.world.getLastCollisionResult().getContacts()
        )
        return [[number[a], number[b]] for a, b in nodes]

    def extra(self) -> dict[str, float]:
        return {}


if __name__ == "__main__":
    _worker.main(importlib.metadata.version("dartpy"), Engine)
