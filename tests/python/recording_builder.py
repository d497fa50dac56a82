"""A stand-in for WorldBuilder that keeps what it is told, and the Pinocchio model of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini.load._placement import from_quaternion


@dataclass
class Body:
    name: str
    parent: str
    rotation: Any
    position: Any
    joints: list
    mass: float
    center: Any
    inertia: Any


class RecordingBuilder:
    def __init__(self, gravity=(0.0, 0.0, -9.81)):
        self.gravity = gravity
        self.bodies, self.geometries, self.visuals = {}, [], []
        self.calls, self.warnings = [], []

    def add_body(
        self, name, *, parent="world", position=(0, 0, 0), orientation=(0, 0, 0, 1), joints=(), mass=0.0,
        center=(0, 0, 0), inertia=None, gravity_compensation=0.0,
    ):  # fmt: skip
        assert parent == "world" or parent in self.bodies, f"{name}: parents come first"
        assert name not in {"world", *self.bodies}
        inertia = np.zeros((3, 3)) if inertia is None else np.asarray(inertia)
        rotation = _rotation(orientation)
        self.bodies[name] = Body(
            name, parent, rotation, np.array(position), list(joints), mass, np.array(center), inertia
        )
        return name

    def add_visual(self, body, shape, **rest):
        self.visuals.append((body, shape, rest))

    def add_geometry(self, body, shape, **rest):
        assert body == "world" or body in self.bodies
        self.geometries.append((body, shape, rest))
        return len(self.geometries) - 1

    def warn(self, message):
        self.warnings.append(message)

    def __getattr__(self, name):
        if name.startswith("_") or name == "build":
            raise AttributeError(name)
        return lambda *args, **kwargs: self.calls.append((name, args, kwargs))

    @property
    def joints(self):
        return {joint.name: joint for body in self.bodies.values() for joint in body.joints}

    def called(self, name):
        return [(args, kwargs) for called, args, kwargs in self.calls if called == name]

    def pinocchio(self):
        """The pinocchio.Model of the bodies; armature included."""
        import pinocchio as pin

        model = pin.Model()
        model.gravity.linear = np.array(self.gravity)
        place = {"world": (0, pin.SE3.Identity())}
        for body in self.bodies.values():
            joint, offset = place[body.parent]
            placement = offset * pin.SE3(body.rotation, body.position)
            for part in body.joints:
                if part.type == "free":  # q is the pose in the world
                    placement = pin.SE3.Identity()
                anchor = pin.SE3(np.eye(3), np.array(part.anchor, dtype=float))
                joint = model.addJoint(joint, _pinocchio_joint(part), placement * anchor, part.name)
                model.armature[model.idx_vs[joint] :][: model.nvs[joint]] = part.armature
                placement = anchor.inverse()
                if part.reference:  # the body has its placement at q = reference
                    axis = np.array(part.axis, dtype=float) / np.linalg.norm(part.axis)
                    if part.type == "revolute":
                        back = pin.SE3(pin.exp3(-part.reference * axis), np.zeros(3))
                    else:
                        back = pin.SE3(np.eye(3), -part.reference * axis)
                    placement = back * placement
            place[body.name] = joint, placement
            inertia = pin.Inertia(body.mass, body.center, body.inertia)
            model.appendBodyToJoint(joint, inertia, placement)
            model.addFrame(pin.Frame(f"body {body.name}", joint, 0, placement, pin.BODY))
        return model


def _pinocchio_joint(joint):
    import pinocchio as pin

    if joint.type == "free":
        return pin.JointModelFreeFlyer()
    if joint.type == "ball":
        return pin.JointModelSpherical()
    axis = np.array(joint.axis, dtype=float)
    axis /= np.linalg.norm(axis)
    return pin.JointModelRevoluteUnaligned(axis) if joint.type == "revolute" else pin.JointModelPrismaticUnaligned(axis)


def _rotation(orientation):
    orientation = np.asarray(orientation, dtype=float)
    return from_quaternion(orientation) if orientation.shape == (4,) else orientation
