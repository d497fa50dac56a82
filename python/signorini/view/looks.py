"""What a world looks like without the world: each mesh once, where it is used, and the joints that move it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from signorini._world import World
from signorini.view.drawables import Drawable, body_placements, drawables

Array = npt.NDArray[np.float64]
#: Of each array in a file: numpy kinds, and columns (None: it has one dimension).
_SHAPES: dict[str, tuple[str, int | None]] = {
    "vertices": ("iuf", 3), "triangles": ("iuf", 3), "mesh_sizes": ("iu", 2), "body": ("iu", None),
    "mesh": ("iu", None), "center": ("f", 3), "scale": ("f", 3), "color": ("f", 4), "collision": ("iu", None),
    "flat": ("iu", None), "names": ("iu", None),
}  # fmt: skip
_INT16 = 32767.0  # a mesh lies in a cube of half edge 1, in steps of 1/32767: 15 um in 1 m


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices: (n, 3) in [-1, 1]; triangles: (m, 3), winding outwards."""

    vertices: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Looks:
    """Meshes, and the parts made of them. Part i is mesh[i] and moves with body[i]: x_body = center + scale * x_mesh.

    center, scale: (parts, 3) [m]. color: (parts, 4) in [0, 1]. collision: what collides; else what is seen. flat: a
    square that stands for a half space. bodies: name, parent, placement and joints of each, the world first.
    geometries: name and body of each.
    """

    meshes: tuple[Mesh, ...]
    body: npt.NDArray[np.int32]
    mesh: npt.NDArray[np.int32]
    center: Array
    scale: Array
    color: Array
    collision: npt.NDArray[np.bool_]
    flat: npt.NDArray[np.bool_]
    bodies: Sequence[Mapping[str, Any]]
    geometries: Sequence[Mapping[str, Any]]

    @classmethod
    def of(cls, world: World) -> Looks:
        """Of a world. Where trimesh is missing, bodies look as they collide."""
        try:
            parts = drawables(world)
        except ImportError:
            parts = drawables(World(world._core))
        meshes: dict[bytes, tuple[int, Mesh]] = {}
        index = np.zeros(len(parts), dtype=np.int32)
        center, scale = np.zeros((len(parts), 3)), np.ones((len(parts), 3))
        for i, part in enumerate(parts):
            center[i], scale[i], mesh = _normalised(part)
            key = hashlib.blake2b(mesh.vertices.tobytes() + mesh.triangles.tobytes()).digest()
            index[i] = meshes.setdefault(key, (len(meshes), mesh))[0]
        return cls(
            meshes=tuple(mesh for _, mesh in meshes.values()),
            body=np.array([part.body for part in parts], dtype=np.int32),
            mesh=index,
            center=center,
            scale=scale,
            color=np.array([part.color for part in parts], dtype=np.float64).reshape(-1, 4),
            collision=np.array([part.collision for part in parts], dtype=bool),
            flat=np.array([part.flat for part in parts], dtype=bool),
            bodies=[_described(body) for body in world.bodies],
            geometries=[{"name": g.name, "body": int(g.body)} for g in world.geometries],
        )

    def placements(self, q: npt.ArrayLike) -> tuple[Array, Array]:
        """Positions (bodies, 3) [m] and rotations (bodies, 3, 3) of all bodies at a configuration (nq,)."""
        if self._loose is None:
            return body_placements(self._skeleton, q)
        body, start = self._loose
        position, rotation = (fixed.copy() for fixed in self._at_reference)
        pose = np.asarray(q, dtype=np.float64)[start[:, None] + np.arange(7)]
        position[body], rotation[body] = pose[:, :3], _rotations(pose[:, 3:])
        return position, rotation

    @cached_property
    def _loose(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] | None:
        """Bodies and where their poses start in q, if all that moves are bodies without neighbours: thousands of them
        are placed in one go."""
        loose = []
        for i, body in enumerate(self.bodies[1:], 1):
            joints = body["joints"]
            if not joints and body["parent"] == 0:
                continue
            if body["parent"] != 0 or len(joints) != 1 or joints[0]["type"] != "free" or any(joints[0]["anchor"]):
                return None
            loose.append(i)
        first = {joint.name: joint.q_index for joint in self._skeleton.joints}
        starts = [first[self.bodies[i]["joints"][0]["name"]] for i in loose]
        return np.array(loose, dtype=np.int64), np.array(starts, dtype=np.int64)

    @cached_property
    def _at_reference(self) -> tuple[Array, Array]:
        return body_placements(self._skeleton, self._skeleton.initial_q)

    @property
    def num_q(self) -> int:
        """Values of a configuration. Raises what a damaged description of bodies and joints leads to."""
        return int(self._skeleton.num_q)

    @property
    def reference_q(self) -> Array:
        """A configuration; what never moves is at its place in all of them."""
        return self._skeleton.initial_q

    @cached_property
    def _skeleton(self) -> World:
        """The same bodies and joints without geometry and of any mass: kinematics asks no more."""
        from signorini import _simulator

        builder = _simulator.WorldBuilder(np.zeros(3))
        for row in self.bodies[1:]:
            body = _simulator.Body()
            body.name, body.parent = row["name"], row["parent"]
            body.placement = _placement(row)
            body.mass, body.inertia = 1.0, np.eye(3)
            joints = []
            for given in row["joints"]:
                joint = _simulator.Joint()
                joint.name, joint.reference = given["name"], given["reference"]
                joint.type = getattr(_simulator.JointType, given["type"])
                joint.axis, joint.anchor = np.array(given["axis"]), np.array(given["anchor"])
                joint.armature, joint.friction = given.get("armature", 0.0), given.get("friction", 0.0)
                joints.append(joint)
            body.joints = joints
            builder.add_body(body)
        return World(builder.build())

    # Of a recording

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """All of it as arrays of numbers, for a file."""
        names = {"bodies": list(self.bodies), "geometries": list(self.geometries)}
        return {
            "vertices": np.rint(_INT16 * _joined([mesh.vertices for mesh in self.meshes])).astype(np.int16),
            "triangles": _joined([mesh.triangles for mesh in self.meshes]).astype(np.int32),
            "mesh_sizes": np.array(
                [(len(mesh.vertices), len(mesh.triangles)) for mesh in self.meshes], dtype=np.int32
            ).reshape(-1, 2),
            "body": self.body,
            "mesh": self.mesh,
            "center": self.center.astype(np.float32),
            "scale": self.scale.astype(np.float32),
            "color": self.color.astype(np.float32),
            "collision": self.collision.astype(np.uint8),
            "flat": self.flat.astype(np.uint8),
            "names": np.frombuffer(json.dumps(names).encode(), np.uint8),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Looks:
        """The reverse. Raises KeyError, TypeError or ValueError when the arrays do not fit together."""
        given = {name: _fitting(name, arrays[name]) for name in _SHAPES}
        sizes = given["mesh_sizes"].astype(np.int64)
        ends = np.cumsum(sizes, axis=0)
        last = ends[-1] if len(sizes) else (0, 0)
        if (sizes < 0).any() or tuple(last) != (len(given["vertices"]), len(given["triangles"])):
            raise ValueError("mesh_sizes: do not add up to the vertices and triangles that there are")
        meshes = []
        for (num_vertices, num_triangles), (end_v, end_t) in zip(sizes, ends, strict=True):
            vertices = np.asarray(given["vertices"][end_v - num_vertices : end_v], dtype=np.float32)
            triangles = np.asarray(given["triangles"][end_t - num_triangles : end_t], dtype=np.int32)
            if triangles.size and not 0 <= triangles.min() <= triangles.max() < num_vertices:
                raise ValueError("triangles: name vertices that are not there")
            meshes.append(Mesh(vertices / np.float32(_INT16), triangles))
        names = json.loads(given["names"].astype(np.uint8).tobytes())
        body, mesh = (given[key].astype(np.int32) for key in ("body", "mesh"))
        for key, values, count in (
            ("body", body, len(names["bodies"])),
            ("mesh", mesh, len(meshes)),
            ("geometries", np.array([int(g["body"]) for g in names["geometries"]]), len(names["bodies"])),
        ):
            if values.size and not 0 <= values.min() <= values.max() < count:
                raise ValueError(f"{key}: names what is not there")
        if any(len(given[key]) != len(body) for key in ("mesh", "center", "scale", "color", "collision", "flat")):
            raise ValueError("body, mesh, center, scale, color, collision, flat: must have as many rows")
        return cls(
            meshes=tuple(meshes),
            body=body,
            mesh=mesh,
            center=given["center"].astype(np.float64),
            scale=given["scale"].astype(np.float64),
            color=np.clip(given["color"].astype(np.float64), 0.0, 1.0),
            collision=given["collision"].astype(bool),
            flat=given["flat"].astype(bool),
            bodies=names["bodies"],
            geometries=names["geometries"],
        )


def _fitting(name: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    kinds, columns = _SHAPES[name]
    if values.dtype.kind not in kinds or values.shape[1:] != (() if columns is None else (columns,)) or not values.ndim:
        raise ValueError(f"{name}: has shape {values.shape} of type {values.dtype}")
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: must be finite")
    return values


def _normalised(part: Drawable) -> tuple[Array, Array, Mesh]:
    """Centre, half extents, and the mesh in the cube of half edge 1: all boxes are one mesh then, and all spheres."""
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    center, scale = 0.5 * (low + high), 0.5 * (high - low)
    scale[scale <= 1e-6 * scale.max()] = 1.0  # a flat one
    vertices = np.rint(_INT16 * (part.vertices - center) / scale) / _INT16
    return center, scale, Mesh(vertices.astype(np.float32), np.asarray(part.triangles, dtype=np.int32))


def _rotations(quaternion: Array) -> Array:
    """(n, 3, 3) of quaternions (n, 4), w last."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _described(body: Any) -> dict[str, Any]:
    return {
        "name": body.name,
        "parent": int(body.parent),
        "position": body.placement.translation.tolist(),
        "rotation": body.placement.rotation.tolist(),
        "joints": [
            {
                "name": joint.name,
                "type": joint.type.name,
                "axis": joint.axis.tolist(),
                "anchor": joint.anchor.tolist(),
                "reference": float(joint.reference),
                # A free body with one of these has another place in q.
                "armature": float(joint.armature),
                "friction": float(joint.friction),
            }
            for joint in body.joints
        ],
    }


def _placement(row: Mapping[str, Any]) -> Any:
    from signorini import _simulator

    placement = _simulator.Placement()
    placement.translation, placement.rotation = np.array(row["position"]), np.array(row["rotation"])
    return placement


def _joined(pieces: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    return np.concatenate(pieces) if pieces else np.zeros((0, 3))
