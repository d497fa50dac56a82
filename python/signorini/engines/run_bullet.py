"""Bullet (PyBullet): URDF files, one for each link that hangs on the world, with 50 or 1000 iterations."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import _worker
import numpy as np
import pybullet

MASSLESS = 1e-6  # kg, kg m^2: without mass a link is fixed
FASTEST = 1e6  # m/s, rad/s; its default of 100 cuts


def numbers(values: Any) -> str:
    return " ".join(f"{float(x):.17g}" for x in values)


def origin(pose: dict[str, Any]) -> str:
    r = np.array(pose["rotation"])
    pitch = math.asin(max(-1.0, min(1.0, -r[2, 0])))
    if abs(r[2, 0]) < 1.0 - 1e-12:
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    else:
        roll, yaw = 0.0, math.atan2(-r[0, 1], r[1, 1])
    return f'<origin xyz="{numbers(pose["position"])}" rpy="{numbers((roll, pitch, yaw))}"/>'


def shape_of(geometry: dict[str, Any]) -> str:
    x, y, z = geometry["size"]
    match geometry["shape"]:
        case "sphere":
            return f'<sphere radius="{x:.17g}"/>'
        case "box":
            return f'<box size="{numbers((2 * x, 2 * y, 2 * z))}"/>'
        case "capsule" | "cylinder" as kind:
            return f'<{kind} radius="{x:.17g}" length="{2 * y:.17g}"/>'
        case "convex":
            return f'<mesh filename="{geometry["mesh"]}"/>'
    raise ValueError(f"URDF has no {geometry['shape']}")


def link_text(name: str, link: dict[str, Any] | None, geometries: list[dict[str, Any]]) -> str:
    inertial = ""
    if link is not None:
        mass, i = link["mass"], np.array(link["inertia"])
        if mass == 0.0:
            mass, i = MASSLESS, MASSLESS * np.eye(3)
        six = {"ixx": i[0, 0], "iyy": i[1, 1], "izz": i[2, 2], "ixy": i[0, 1], "ixz": i[0, 2], "iyz": i[1, 2]}
        text = " ".join(f'{key}="{value:.17g}"' for key, value in six.items())
        place = f'<origin xyz="{numbers(link["center"])}"/>'
        inertial = f'<inertial>{place}<mass value="{mass:.17g}"/><inertia {text}/></inertial>'
    hits = "".join(f"<collision>{origin(g)}<geometry>{shape_of(g)}</geometry></collision>" for g in geometries)
    return f'<link name="{name}">{inertial}{hits}</link>'


class Engine:
    """where: link -> (body, index of the link in it); a free link is the base of its body."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        self.links, self.layout = model["links"], _worker.layout(model)
        if pybullet.isConnected():  # with the world of the run before
            pybullet.disconnect()
        pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(*model["gravity"])
        pybullet.setTimeStep(time_step)
        if setting == "1000 iterations":
            pybullet.setPhysicsEngineParameter(numSolverIterations=1000, solverResidualThreshold=0.0)
        self.where: dict[int, tuple[int, int]] = {}
        fixed = [g for g in model["geometries"] if g["link"] == -1 and g["shape"] != "half_space"]
        grounds = [self._ground(g) for g in model["geometries"] if g["shape"] == "half_space"]
        self.of_world: list[tuple[int, int]] = [(body, -1) for body in grounds]
        for k, link in enumerate(self.links):
            if link["parent"] == -1:
                self._load(k, folder, model, fixed)
                fixed = []
        for k in range(len(self.links)):
            if k not in self.where:
                raise ValueError(f"link {self.links[k]['name']!r} is not in what was loaded")
        self._smooth(model)
        for a, b in model["excluded"]:
            for one in self._bodies(a):
                for other in self._bodies(b):
                    pybullet.setCollisionFilterPair(one[0], other[0], one[1], other[1], 0)
        for loop in model["loops"]:
            self._close(loop)

    def _ground(self, geometry: dict[str, Any]) -> int:
        normal = np.array(geometry["rotation"])[:, 2]
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal.tolist())
        return int(pybullet.createMultiBody(0.0, shape, basePosition=geometry["position"]))

    def _bodies(self, link: int) -> list[tuple[int, int]]:
        return self.of_world if link == -1 else [self.where[link]]

    def _load(self, root: int, folder: Path, model: dict[str, Any], fixed: list[dict[str, Any]]) -> None:
        """The links that hang on one that hangs on the world, and that one; fixed: what is part of the world there."""
        members = [root]
        for k, link in enumerate(self.links):
            if link["parent"] in members and k not in members:
                members.append(k)
        free = self.links[root]["type"] == "free"
        parts = [] if free else [link_text("base", None, fixed)]
        for k in members:
            link = self.links[k]
            parts.append(link_text(f"link-{k}", link, [g for g in model["geometries"] if g["link"] == k]))
            if k == root and free:
                continue
            if link["type"] not in ("revolute", "prismatic"):
                raise ValueError(f"URDF has no {link['type']} joint here")
            kind = "continuous" if link["type"] == "revolute" else "prismatic"
            limit = '<limit lower="1" upper="-1" effort="1e9" velocity="1e9"/>'  # lower above upper: none
            parent = "base" if link["parent"] == -1 else f"link-{link['parent']}"
            parts.append(
                f'<joint name="joint-{k}" type="{kind}">{origin(link)}<parent link="{parent}"/>'
                f'<child link="link-{k}"/><axis xyz="{numbers(link["axis"])}"/>{limit}</joint>'
            )
        path = folder / f"bullet-{root}.urdf"
        text = "".join(parts).replace("><", ">\n<")  # it reads files by the line, and not the long ones
        path.write_text(f'<robot name="tree-{root}">\n{text}\n</robot>\n')
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_SELF_COLLISION
        flags |= pybullet.URDF_USE_SELF_COLLISION_INCLUDE_PARENT  # pairs that never touch are taken out one by one
        body = pybullet.loadURDF(str(path), useFixedBase=not free, flags=flags)
        if free:
            self.where[root] = body, -1
        elif fixed:
            self.of_world.append((body, -1))
        for joint in range(pybullet.getNumJoints(body)):
            name = pybullet.getJointInfo(body, joint)[1].decode()
            self.where[int(name.removeprefix("joint-"))] = body, joint

    def _smooth(self, model: dict[str, Any]) -> None:
        """No damping, no motors, friction and restitution that multiply to the model's."""
        mu, bounce = math.sqrt(model["friction"]), math.sqrt(model["restitution"])
        for body in range(pybullet.getNumBodies()):
            for link in range(-1, pybullet.getNumJoints(body)):
                pybullet.changeDynamics(
                    body, link, lateralFriction=mu, linearDamping=0.0, angularDamping=0.0, restitution=bounce
                )
                pybullet.changeDynamics(body, link, jointDamping=0.0, maxJointVelocity=FASTEST)
                pybullet.changeDynamics(body, link, rollingFriction=0.0, spinningFriction=0.0)
                if link >= 0:
                    pybullet.setJointMotorControl2(body, link, pybullet.VELOCITY_CONTROL, force=0.0)

    def _close(self, loop: dict[str, Any]) -> None:
        ends = []
        for side in ("a", "b"):
            (body, link), *_ = self._bodies(loop[f"link_{side}"])
            info = pybullet.getDynamicsInfo(body, link)
            pivot = _worker.rotation(info[4]).T @ (np.array(loop[f"point_{side}"]) - info[3])  # axes of the inertia
            ends.append((body, link, pivot.tolist()))
        (a, link_a, point_a), (b, link_b, point_b) = ends
        kind = pybullet.JOINT_POINT2POINT
        constraint = pybullet.createConstraint(a, link_a, b, link_b, kind, [0, 0, 0], point_a, point_b)
        pybullet.changeConstraint(constraint, maxForce=1e9)

    def set_state(self, q: Any) -> None:
        for k, (first, _, _, _) in enumerate(self.layout):
            body, joint = self.where[k]
            if joint >= 0:
                pybullet.resetJointState(body, joint, q[first], 0.0)
                continue
            info = pybullet.getDynamicsInfo(body, -1)
            turn = q[first + 3 : first + 7]
            pose = pybullet.multiplyTransforms(q[first : first + 3].tolist(), turn.tolist(), info[3], info[4])
            pybullet.resetBasePositionAndOrientation(body, *pose)
            pybullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0])

    def state(self) -> tuple[Any, Any]:
        q, v = np.zeros(sum(x[1] for x in self.layout)), np.zeros(sum(x[3] for x in self.layout))
        for k, (first, _, at, _) in enumerate(self.layout):
            body, joint = self.where[k]
            if joint >= 0:
                q[first], v[at] = pybullet.getJointState(body, joint)[:2]
                continue
            info = pybullet.getDynamicsInfo(body, -1)
            place, turn = pybullet.getBasePositionAndOrientation(body)
            linear, angular = (np.array(x) for x in pybullet.getBaseVelocity(body))
            position, quaternion = pybullet.multiplyTransforms(place, turn, *pybullet.invertTransform(info[3], info[4]))
            r = _worker.rotation(quaternion)
            linear = linear + np.cross(angular, np.array(position) - place)
            q[first : first + 7] = [*position, *quaternion]
            v[at : at + 6] = [*(r.T @ linear), *(r.T @ angular)]
        return q, v

    def step(self, count: int) -> None:
        for _ in range(count):
            pybullet.stepSimulation()

    def mass_matrix(self) -> Any:
        bodies = {body for body, _ in self.where.values()}
        if len(bodies) != 1 or all(joint < 0 for _, joint in self.where.values()):
            return None
        (body,) = bodies
        order = sorted(joint for _, joint in self.where.values() if joint >= 0)
        angles = [pybullet.getJointState(body, joint)[0] for joint in order]
        full = np.array(pybullet.calculateMassMatrix(body, angles))
        full = full[-len(order) :, -len(order) :]
        place = {joint: n for n, joint in enumerate(order)}
        wanted = [place[self.where[k][1]] for k in range(len(self.links)) if self.where[k][1] >= 0]
        return full[np.ix_(wanted, wanted)]

    def total_mass(self) -> float:
        return float(sum(pybullet.getDynamicsInfo(*self.where[k])[0] for k in self.where))

    def report(self) -> dict[str, Any]:
        links: list[Any] = []
        joints = []
        for k, link in enumerate(self.links):
            body, joint = self.where[k]
            info = pybullet.getDynamicsInfo(body, joint)
            links.append([info[0], *sorted(info[2])] if link["mass"] > 0.0 else None)
            if joint >= 0:
                joints.append(pybullet.getJointInfo(body, joint))
        parameters = pybullet.getPhysicsEngineParameters()
        return {
            "time_step": parameters["fixedTimeStep"],
            "gravity": [parameters[f"gravityAcceleration{axis}"] for axis in "XYZ"],
            "links": links,
            "limits": sum(joint[8] <= joint[9] for joint in joints),
            "damping": max((joint[6] + joint[7] for joint in joints), default=0.0),
            "pairs": None,
        }

    def touching(self) -> list[Any]:
        number = {place: k for k, place in self.where.items()}
        return [
            [number.get((c[1], c[3]), -1), number.get((c[2], c[4]), -1)]
            for c in pybullet.getContactPoints()
            if c[8] <= 0.0  # nearer than its margin, and not apart
        ]

    def extra(self) -> dict[str, float]:
        return {}


if __name__ == "__main__":
    import importlib.metadata

    _worker.main(importlib.metadata.version("pybullet"), Engine)
