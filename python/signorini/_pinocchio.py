"""Worlds to and from the models of Pinocchio's Python package (`pin`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from signorini._core import InvalidInputError

if TYPE_CHECKING:
    from signorini._world import JointType, World, WorldBuilder


def _pinocchio() -> Any:
    try:
        import pinocchio
    except ImportError:
        raise ImportError("Pinocchio models need its Python package: pip install 'signorini[peers]'") from None
    return pinocchio


def to_pinocchio(world: World) -> Any:
    """The world as a pin.Model: joints in the world's order, so that q and v are the same."""
    pin = _pinocchio()

    def se3(placement: Any) -> Any:
        return pin.SE3(np.array(placement.rotation), np.array(placement.translation))

    model = pin.Model()
    model.gravity.linear = world.gravity
    reached: dict[int, tuple[int, Any]] = {}  # body -> (joint so far, where its frame is in there)
    for joint in world.joints:
        body = world.bodies[joint.body]
        parent = world.bodies[body.parent]
        at, offset = reached.get(joint.body, (parent.frame, se3(parent.in_frame) * se3(body.placement)))
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        kind = joint.type.name
        anchor = np.array(joint.anchor) if kind in ("revolute", "ball") else np.zeros(3)
        placement = offset * pin.SE3(np.eye(3), anchor)
        if kind == "free":
            part, placement = pin.JointModelFreeFlyer(), pin.SE3.Identity()  # q is the pose in the world
        elif kind == "ball":
            part = pin.JointModelSpherical()
        elif kind == "revolute":
            part = pin.JointModelRevoluteUnaligned(axis)
            placement = placement * pin.SE3(pin.exp3(-joint.reference * axis), np.zeros(3))
        else:
            part = pin.JointModelPrismaticUnaligned(axis)
            placement = placement * pin.SE3(np.eye(3), -joint.reference * axis)
        at = model.addJoint(at, part, placement, joint.name)
        reached[joint.body] = at, pin.SE3(np.eye(3), -anchor)
        model.addJointFrame(at)
        v = slice(model.idx_vs[at], model.idx_vs[at] + model.nvs[at])
        model.armature[v] = joint.armature
        if joint.num_q == 1:
            model.lowerPositionLimit[model.idx_qs[at]] = joint.lower
            model.upperPositionLimit[model.idx_qs[at]] = joint.upper
    for body in world.bodies[1:]:
        if body.mass > 0.0:
            inertia = pin.Inertia(body.mass, np.array(body.center), np.array(body.inertia))
            model.appendBodyToJoint(body.frame, inertia, se3(body.in_frame))
        model.addFrame(pin.Frame(body.name, body.frame, 0, se3(body.in_frame), pin.BODY))
    return model


def add_pinocchio(builder: WorldBuilder, model: Any, prefix: str) -> None:
    """See WorldBuilder.add_pinocchio."""
    from signorini._world import WORLD, Joint

    pin = _pinocchio()
    if isinstance(model, str):
        text, model = model, pin.Model()
        try:
            model.loadFromString(text)
        except Exception as error:
            raise InvalidInputError(f"model: is not a text archive of a Pinocchio model ({error})") from None
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    bodies = [WORLD]
    for i in range(1, model.njoints):
        name, joint = model.names[i], model.joints[i]
        kind = joint.shortname()
        motion = pin.getJointJacobian(model, data, i, pin.LOCAL)[:, joint.idx_v]  # its axis, whatever its class
        limits: dict[str, Any] = {}
        part: JointType
        if kind.startswith("JointModelFreeFlyer"):
            part = "free"
        elif kind.startswith("JointModelSpherical") and joint.nq == 4:
            part = "ball"
        elif kind.startswith(("JointModelR", "JointModelP")) and (joint.nq, joint.nv) == (1, 1):
            part = "revolute" if kind.startswith("JointModelR") else "prismatic"
            limits = {
                "axis": tuple(motion[3:] if part == "revolute" else motion[:3]),
                "lower": float(model.lowerPositionLimit[joint.idx_q]),
                "upper": float(model.upperPositionLimit[joint.idx_q]),
            }
        else:
            raise InvalidInputError(
                f"joint {name!r}: is a {kind}, must be free-flyer, spherical, revolute (bounded) or prismatic"
            )
        place, inertia = model.jointPlacements[i], model.inertias[i]
        bodies.append(
            builder.add_body(
                f"{prefix}{name} body",
                parent=bodies[model.parents[i]],
                position=place.translation,
                orientation=place.rotation,
                joints=[Joint(prefix + name, part, armature=float(model.armature[joint.idx_v]), **limits)],
                mass=inertia.mass,
                center=inertia.lever,
                inertia=inertia.inertia,
            )
        )
