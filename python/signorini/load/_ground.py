"""Where the ground is: below what stands on it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from signorini._world import Material, World, WorldBuilder


NOTHING_TOUCHES = "has nothing that collides, so the ground touches nothing; it is at z = 0"


def add_touching_ground(builder: WorldBuilder, world: World, file: str, material: Material | None = None) -> float:
    """Adds a ground that the lowest point of a world touches, or one at 0, with a warning, where nothing would; returns
    its height [m]."""
    height = lowest_point(world)
    if height is None:
        builder.warn(f"{file}: {NOTHING_TOUCHES}")
        height = 0.0
    builder.add_ground(material, height)
    return height


def lowest_point(world: World, q: npt.ArrayLike | None = None) -> float | None:
    """Height of the lowest point of what collides and can move, or of all when nothing can, at q (nq,) (default:
    initial_q) [m]; None where nothing with an end collides."""
    frames = world._core.frame_placements(world.initial_q if q is None else np.asarray(q, dtype=np.float64))
    still = world.bodies[0].frame
    found: dict[bool, list[float]] = {True: [], False: []}
    for geometry in world.geometries:
        body = world.bodies[geometry.body]
        frame, inner, own = frames[body.frame], body.in_frame, geometry.placement
        position = frame.rotation @ (inner.rotation @ own.translation + inner.translation) + frame.translation
        down = -(frame.rotation @ inner.rotation @ own.rotation)[2]
        reach = _reach(geometry.shape, down)
        if reach is not None:
            found[body.frame != still].append(float(position[2]) - reach)
    return min(found[True] or found[False], default=None)


def _reach(shape: Any, direction: npt.NDArray[np.float64]) -> float | None:
    """How far a shape goes in a direction of its frame (unit); None: without end."""
    kind, size = shape.type.name, np.asarray(shape.size)
    if kind == "sphere":
        return float(size[0])
    if kind == "box":
        return float(np.abs(direction) @ size)
    if kind == "capsule":
        return float(abs(direction[2]) * size[1] + size[0])
    if kind == "cylinder":
        return float(abs(direction[2]) * size[1] + math.hypot(direction[0], direction[1]) * size[0])
    if kind == "ellipsoid":
        return float(np.linalg.norm(direction * size))
    if kind == "convex":
        return float((np.asarray(shape.vertices) @ direction).max())
    return None
