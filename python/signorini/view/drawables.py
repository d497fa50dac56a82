"""Worlds as triangles: what every way of drawing starts from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini._visual import Color, MeshFile, TriangleMesh

if TYPE_CHECKING:
    from signorini._world import World

Array = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int32]

#: Half the edge of the square that stands for a half space [m].
HALF_SPACE = 20.0
_GROUND: Color = (0.80, 0.82, 0.84, 1.0)
#: Of bodies without a colour, by number.
_PALETTE: tuple[Color, ...] = (
    (0.29, 0.47, 0.66, 1.0),
    (0.95, 0.56, 0.17, 1.0),
    (0.35, 0.63, 0.31, 1.0),
    (0.88, 0.34, 0.35, 1.0),
    (0.46, 0.72, 0.70, 1.0),
    (0.93, 0.79, 0.29, 1.0),
    (0.69, 0.48, 0.63, 1.0),
    (0.61, 0.46, 0.37, 1.0),
)


@dataclass(frozen=True, eq=False)
class Drawable:
    """Triangles that move with a body.

    vertices: (n, 3) in the frame of the body [m]; triangles: (m, 3), winding outwards. body: its index. collision: what
    collides; else what is seen. flat: the square that stands for a half space. smooth: normals are to be interpolated.
    """

    name: str
    body: int
    vertices: Array
    triangles: Triangles
    color: Color
    collision: bool
    flat: bool = False
    smooth: bool = False


def drawables(world: World) -> list[Drawable]:
    """What is seen of a world (its visuals, and the geometries of bodies without any), then all that collides.

    Raises ImportError when there are mesh files and trimesh is missing. Where a mesh file cannot be read, the
    geometries of its body are drawn instead.
    """
    seen: list[Drawable] = []
    dressed: set[int] = set()
    for number, visual in enumerate(world.visuals):
        body = world.body_index(visual.body)
        try:
            parts = _triangles(visual.shape)
        except InvalidInputError:
            continue
        dressed.add(body)
        for vertices, triangles, own_color, smooth in parts:
            placed = vertices @ visual.rotation.T + visual.position
            color = visual.color or own_color or _color(body)
            flat = type(visual.shape).__name__ == "HalfSpace"
            name = f"{visual.body} {number}"
            seen.append(Drawable(name, body, placed, triangles, color, False, flat, smooth))
    colliding: list[Drawable] = []
    for geometry in world.geometries:
        vertices, triangles, smooth = _of_core_shape(geometry.shape)
        placed = vertices @ geometry.placement.rotation.T + geometry.placement.translation
        flat = geometry.shape.type.name == "half_space"
        color = _GROUND if geometry.body == 0 else _color(geometry.body)
        if geometry.body not in dressed:
            seen.append(Drawable(geometry.name, geometry.body, placed, triangles, color, False, flat, smooth))
        colliding.append(Drawable(geometry.name, geometry.body, placed, triangles, color, True, flat, smooth))
    return seen + colliding


def body_placements(world: World, q: npt.ArrayLike) -> tuple[Array, Array]:
    """Positions (bodies, 3) [m] and rotations (bodies, 3, 3) of all bodies at a configuration (nq,)."""
    frames = world._core.frame_placements(np.asarray(q, dtype=np.float64))
    position = np.array([frame.translation for frame in frames])
    rotation = np.array([frame.rotation for frame in frames])
    of, inner_position, inner_rotation = _in_frames(world)
    return (
        np.einsum("bij,bj->bi", rotation[of], inner_position) + position[of],
        rotation[of] @ inner_rotation,
    )


def _in_frames(world: World) -> tuple[npt.NDArray[np.int64], Array, Array]:
    bodies = world.bodies
    return (
        np.array([body.frame for body in bodies]),
        np.array([body.in_frame.translation for body in bodies]),
        np.array([body.in_frame.rotation for body in bodies]),
    )


def _color(body: int) -> Color:
    return _PALETTE[body % len(_PALETTE)]


def _triangles(shape: Any) -> list[tuple[Array, Triangles, Color | None, bool]]:
    if isinstance(shape, TriangleMesh):
        return [(shape.vertices, shape.triangles, None, False)]
    if isinstance(shape, MeshFile):
        return _of_file(shape)
    from signorini._world import _core_shape

    return [(*_of_core_shape(_core_shape(shape))[:2], None, _of_core_shape(_core_shape(shape))[2])]


def _of_file(file: MeshFile) -> list[tuple[Array, Triangles, Color | None, bool]]:
    """Each piece of a file that has a colour of its own."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(f"{file.path}: trimesh draws it: pip install 'signorini[view]' ({error})") from None
    try:
        scene = trimesh.load_scene(file.path)
        meshes = scene.dump()
    except Exception as error:  # whatever a reader of a stranger's file raises
        raise InvalidInputError(f"{file.path}: cannot be drawn ({error})") from None
    result: list[tuple[Array, Triangles, Color | None, bool]] = []
    for piece in meshes:
        if file.part and piece.metadata.get("name") != file.part:
            continue
        if not isinstance(piece, trimesh.Trimesh) or not len(piece.faces):
            continue
        vertices = np.asarray(piece.vertices, dtype=np.float64) * file.scale
        triangles = np.asarray(piece.faces, dtype=np.int32)
        if np.prod(file.scale) < 0.0:
            triangles = triangles[:, ::-1].copy()
        result.append((vertices, triangles, _mesh_color(piece), False))
    if not result:
        raise InvalidInputError(f"{file.path}: has no triangles")
    return result


def _mesh_color(piece: Any) -> Color | None:
    if not piece.visual.defined:
        return None
    color = np.asarray(getattr(piece.visual, "main_color", None), dtype=object)
    material = getattr(piece.visual, "material", None)
    if material is not None and getattr(material, "main_color", None) is not None:
        color = np.asarray(material.main_color)
    if color.shape != (4,):
        return None
    r, g, b, a = (float(x) / 255.0 for x in color)
    return r, g, b, a


# Shapes


def _of_core_shape(shape: Any) -> tuple[Array, Triangles, bool]:
    """Vertices, triangles, whether it is round."""
    kind, size = shape.type.name, np.asarray(shape.size)
    if kind == "box":
        return (*_box(size), False)
    if kind == "half_space":
        half = HALF_SPACE
        corners = [[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]]
        return np.array(corners), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), False
    if kind in ("sphere", "ellipsoid"):
        vertices, triangles = _unit_ball()
        return vertices * (size[0] if kind == "sphere" else size), triangles, True
    if kind == "capsule":
        return (*_turned(_half_circle(size[0], size[1])), True)
    if kind == "cylinder":
        r, h = size[0], size[1]
        return (*_turned(np.array([[0.0, -h], [r, -h], [r, h], [0.0, h]])), False)
    if kind == "height_field":
        return (*_height_field(np.asarray(shape.heights), *shape.field_size), False)
    return np.asarray(shape.vertices, dtype=np.float64), np.asarray(shape.triangles, dtype=np.int32), False


def _box(half: Array) -> tuple[Array, Triangles]:
    signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return signs * half, np.array(triangles, dtype=np.int32)


@lru_cache(maxsize=1)
def _unit_ball() -> tuple[Array, Triangles]:
    return _turned(_half_circle(1.0, 0.0))


def _height_field(heights: Array, half_x: float, half_y: float, base: float) -> tuple[Array, Triangles]:
    """The surface, walls and a bottom of two triangles."""
    rows, columns = heights.shape
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    number = np.arange(heights.size).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    surface = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    # Once around, counter-clockwise seen from above, and the same below.
    border = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    low = heights.size + np.arange(len(border))
    after, low_after = np.roll(border, -1), np.roll(low, -1)
    walls = [np.stack([border, low, low_after], axis=1), np.stack([border, low_after, after], axis=1)]
    p, q, r = low[0], low[columns - 1], low[columns + rows - 2]
    bottom = [np.array([[p, r, q], [p, low[2 * columns + rows - 3], r]])]
    top = np.column_stack([x.ravel(), y.ravel(), heights.ravel()])
    below = np.column_stack([top[border, :2], np.full(len(border), -base)])
    return np.concatenate([top, below]), np.concatenate(surface + walls + bottom).astype(np.int32)


def _half_circle(radius: float, half_length: float, count: int = 12) -> Array:
    """(r, z) from the lower pole to the upper one, the middle drawn apart."""
    angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 2 * count + 1)
    r, z = radius * np.cos(angles), radius * np.sin(angles)
    r[[0, -1]] = 0.0
    if half_length == 0.0:
        return np.stack([r, z], axis=1)
    low, high = np.stack([r, z - half_length], axis=1), np.stack([r, z + half_length], axis=1)
    return np.concatenate([low[: count + 1], high[count:]])


def _turned(profile: Array, count: int = 24) -> tuple[Array, Triangles]:
    """The surface of a profile (r, z), from z below to above, turned about z; it starts and ends on the axis."""
    angles = np.arange(count) * (2.0 * math.pi / count)
    rings = profile[1:-1]
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    body = np.concatenate([np.column_stack([r * circle, np.full(count, z)]) for r, z in rings])
    vertices = np.concatenate([[[0.0, 0.0, profile[0, 1]]], body, [[0.0, 0.0, profile[-1, 1]]]])
    i = np.arange(count)
    j = (i + 1) % count
    triangles = [np.column_stack([np.zeros(count, int), 1 + j, 1 + i])]
    for ring in range(len(rings) - 1):
        a, b = 1 + ring * count, 1 + (ring + 1) * count
        triangles += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    top, last = len(vertices) - 1, 1 + (len(rings) - 1) * count
    triangles.append(np.column_stack([np.full(count, top), last + i, last + j]))
    return vertices, np.concatenate(triangles).astype(np.int32)
