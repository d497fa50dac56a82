"""Pictures without a screen or a graphics card: worlds as triangles, seen by casting rays with Embree.

What is drawn depends on the arguments alone: the same call gives the same picture.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini import _files
from signorini._core import InvalidInputError
from signorini.view.drawables import Drawable, body_placements, drawables

if TYPE_CHECKING:
    from signorini._simulation import Contact
    from signorini._world import World

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int32]
Bools = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
#: Positions (bodies, 3) and rotations (bodies, 3, 3) at a configuration.
Placements = Callable[[npt.ArrayLike], tuple[Array, Array]]

SIZE = (1280, 720)
SMALLEST, LARGEST = 16, 4096  # width or height [pixels]
#: Seen from here, unless told: from the front, a little from the right and from above, for things that look along x.
DIRECTION = (1.0, -0.85, 0.52)
MARGIN = 0.1  # share of the picture that is left free on each side
ARROW_COLOR = (0.90, 0.03, 0.42)

_SKY = ((0.70, 0.78, 0.88), (0.93, 0.95, 0.97))  # sRGB, at the top and at the horizon
_FLOOR = ((0.845, 0.86, 0.88), (0.775, 0.795, 0.82))  # sRGB, the two colours of the chequers
_WALL = ((0.80, 0.84, 0.90), (0.75, 0.80, 0.87))
_SUN = np.float32(0.88)  # strength; colours are linear from here on
_SKY_LIGHT = np.array([0.50, 0.55, 0.62], dtype=np.float32)
_GROUND_LIGHT = np.array([0.30, 0.29, 0.28], dtype=np.float32)
_FILL = np.float32(0.10)  # from the right
_GLOSS = np.float32(0.22)
_SHEEN = np.float32(0.12)  # where surfaces are seen at a grazing angle
_CREASE = math.cos(math.radians(35.0))  # flatter edges are drawn round
_CONTRAST = 10  # of 255, that makes a pixel one at an edge
#: Where in such a pixel it is looked at again.
_OFFSETS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]], dtype=np.float32)


def _spiral(count: int) -> Array:
    """Points (count, 2) spread over the unit disc."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * math.pi * (3.0 - math.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _hemispheres(count: int, patterns: int) -> Floats:
    """Directions (count, patterns, 3) about z, as many as their cosine with it is large."""
    disc = _spiral(patterns * count).reshape(count, patterns, 2)
    up = np.sqrt(1.0 - (disc**2).sum(axis=2))
    return np.concatenate([disc, up[..., None]], axis=2).astype(np.float32)


_SUN_RADIUS = 0.035  # half the angle it fills [rad]
#: Points on it, in rad; the first four are far out, so that where they agree the others do.
_SUN_DISC = (_SUN_RADIUS * _spiral(16)[[12, 14, 13, 15, *range(12)]]).astype(np.float32)
_SKY_SAMPLES = _hemispheres(6, 16)


@dataclass(frozen=True, eq=False)
class Forces:
    """Arrows. position: (n, 3), where they start [m]; force: (n, 3) [N]; both in the world."""

    position: Array
    force: Array

    @classmethod
    def of(cls, contacts: Iterable[Contact]) -> Forces:
        """What contacts do to bodies: to the second one, or to the first where the second is the world."""
        listed = [c for c in contacts if np.isfinite(c.force).all()]
        sign = np.array([-1.0 if c.body_b == "world" else 1.0 for c in listed]).reshape(-1, 1)
        return cls(
            np.array([c.position for c in listed]).reshape(-1, 3),
            sign * np.array([c.force for c in listed]).reshape(-1, 3),
        )

    @property
    def size(self) -> Array:
        """(n) [N]"""
        return np.asarray(np.linalg.norm(self.force, axis=1))


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, upright. eye, target: (x, y, z) [m]; angle: vertical field of view [rad], in (0, pi)."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    angle: float = math.radians(32.0)

    def __post_init__(self) -> None:
        if not 0.0 < self.angle < math.pi:
            raise InvalidInputError(f"angle: is {self.angle}, must be in (0, pi) rad")
        for name, point in (("eye", self.eye), ("target", self.target)):
            if len(point) != 3 or not np.isfinite(point).all():
                raise InvalidInputError(f"{name}: is {point}, must be three finite numbers")
        if not math.dist(self.eye, self.target) > 0.0:
            raise InvalidInputError(f"target: is {self.target}, must not be the eye")

    @property
    def axes(self) -> Array:
        """3 x 3, rows: to the right, up, forwards."""
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        if np.linalg.norm(right) < 1e-9:  # it looks along the vertical
            right = np.array([1.0, 0.0, 0.0])
        right = right / np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    def project(self, points: npt.ArrayLike, size: tuple[int, int]) -> Array:
        """Where points (n, 3) are in a picture of size (width, height): (n, 2) [pixels], from the left and the top."""
        local = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes.T
        scale = 0.5 * size[1] / math.tan(0.5 * self.angle)
        return np.stack(
            [
                0.5 * size[0] + scale * local[..., 0] / local[..., 2],
                0.5 * size[1] - scale * local[..., 1] / local[..., 2],
            ],
            axis=-1,
        )

    def directions(self, pixels: npt.ArrayLike, size: tuple[int, int]) -> Floats:
        """The reverse: unit vectors (n, 3) from the eye through pixels (n, 2)."""
        at = np.asarray(pixels, dtype=np.float32)
        scale = np.float32(2.0 * math.tan(0.5 * self.angle) / size[1])
        axes = self.axes.astype(np.float32)
        x, y = (at[:, 0] - 0.5 * size[0]) * scale, (0.5 * size[1] - at[:, 1]) * scale
        result = x[:, None] * axes[0] + y[:, None] * axes[1] + axes[2]
        return _unit(result)

    @classmethod
    def framing(
        cls,
        points: npt.ArrayLike,
        size: tuple[int, int] = SIZE,
        direction: Sequence[float] = DIRECTION,
        angle: float = math.radians(32.0),
        margin: float = MARGIN,
    ) -> Camera:
        """The nearest camera in this direction that sees all points (n, 3), with a margin [share of the picture]."""
        if not (np.isfinite(direction).all() and np.any(direction)):
            raise InvalidInputError(f"direction: is {tuple(direction)}, must be finite and not zero")
        if not 0.0 <= margin < 0.5:
            raise InvalidInputError(f"margin: is {margin}, must be in [0, 0.5)")
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if not len(points):
            points = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
        target = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = max(1e-3, float(np.linalg.norm(points - target, axis=1).max()))
        back = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
        tangent = np.array([size[0] / size[1], 1.0]) * math.tan(0.5 * angle) * (1.0 - 2.0 * margin)
        for _ in range(4):  # the middle of what is seen moves with the distance
            axes = cls(_point(back), (0.0, 0.0, 0.0), angle).axes
            local = (points - target) @ axes.T
            distance = max(float((np.abs(local[:, :2]) / tangent - local[:, 2:]).max()), 0.1 * radius)
            seen = local[:, :2] / (local[:, 2:] + distance)
            target = target + distance * 0.5 * (seen.min(axis=0) + seen.max(axis=0)) @ axes[:2]
        return cls(_point(target + max(distance, 1.2 * radius) * back), _point(target), angle)


def _point(values: npt.ArrayLike) -> tuple[float, float, float]:
    x, y, z = np.asarray(values, dtype=np.float64)
    return float(x), float(y), float(z)


def checked_size(size: tuple[int, int], even: bool = False) -> tuple[int, int]:
    """(width, height), or InvalidInputError. even: both must be."""
    for name, value in zip(("width", "height"), size, strict=True):
        if not SMALLEST <= value <= LARGEST or value != int(value) or (even and value % 2):
            kind = "an even number" if even else "a whole number"
            raise InvalidInputError(f"size: {name} is {value}, must be {kind} in [{SMALLEST}, {LARGEST}]")
    return size


def checked_suffix(path: str | PathLike[str], suffix: str) -> Path:
    """The path, or InvalidInputError where it does not end so or its folder does not exist."""
    path = Path(path)
    if path.suffix.lower() != suffix:
        raise InvalidInputError(f"{path}: must end in {suffix}")
    if not path.parent.is_dir():
        raise InvalidInputError(f"{path}: there is no such folder")
    return path


def write_png(path: str | PathLike[str], image: Image) -> None:
    """Writes (height, width, 3) values."""
    path = checked_suffix(path, ".png")
    try:
        import PIL.Image
    except ImportError as error:
        raise ImportError(f"{path}: pillow writes it: pip install 'signorini[view]' ({error})") from None
    with _files.replacing(path) as target:
        PIL.Image.fromarray(image).save(target, "PNG", optimize=True)


def picture(
    world: World,
    q: npt.ArrayLike,
    contacts: Iterable[Contact] = (),
    *,
    size: tuple[int, int] = SIZE,
    camera: Camera | None = None,
    collision: bool = False,
) -> Image:
    """A world at a configuration, (height, width, 3) in sRGB, with an arrow for each contact that carries force.

    camera: None: one that sees all bodies. collision: draw what collides in place of what is seen.
    Raises ImportError where Embree's wheel is missing.
    """
    stage = Stage.of_world(world, collision=collision, size=size)
    return stage.draw(q, Forces.of(contacts), camera=camera or stage.camera([q]))


class Stage:
    """Draws the same bodies again and again."""

    def __init__(
        self,
        parts: Sequence[Drawable],
        placements: Placements,
        *,
        collision: bool = False,
        size: tuple[int, int] = SIZE,
    ) -> None:
        """parts: all that there is, of which collision chooses. size: (width, height) [pixels]."""
        try:
            import embreex.mesh_construction
            import embreex.rtcore_scene  # noqa: F401
        except ImportError as error:
            raise ImportError(f"pictures: embreex draws them: pip install 'signorini[view]' ({error})") from None
        self.size = checked_size(size)
        chosen = [part for part in parts if part.collision == collision]
        self._planes = [part for part in chosen if part.flat]
        self._solids = sorted((part for part in chosen if not part.flat and len(part.triangles)), key=_body)
        self._placements = placements
        self._mesh = _Mesh(self._solids)
        self._last: tuple[Any, _View] | None = None
        self._lock = threading.Lock()
        self._boxes = np.array([_corners(part.vertices) for part in self._solids]).reshape(-1, 8, 3)

    @classmethod
    def of_world(cls, world: World, *, collision: bool = False, size: tuple[int, int] = SIZE) -> Stage:
        return cls(drawables(world), lambda q: body_placements(world, q), collision=collision, size=size)

    def camera(
        self, states: Iterable[npt.ArrayLike], direction: Sequence[float] = DIRECTION, margin: float = MARGIN
    ) -> Camera:
        """One camera that sees all that moves, in all these configurations, from this direction (towards the eye).

        margin: share of the picture that is left free on each side, in [0, 0.5).
        """
        moving = np.array([part.body != 0 for part in self._solids], dtype=bool)
        body = np.array([part.body for part in self._solids], dtype=int)
        points = []
        for q in states:
            position, rotation = self._placed(q)
            points.append(np.einsum("pij,pcj->pci", rotation[body], self._boxes) + position[body][:, None])
        all_points = np.array(points).reshape(len(points), len(body), 8, 3)
        seen = all_points[:, moving].reshape(-1, 3)
        if len(seen) and len(all_points):  # and what stands beside it
            low, high = seen.min(axis=0), seen.max(axis=0)
            near = [
                box.reshape(-1, 3)
                for box in all_points[0, ~moving]
                if (box > low - 0.5 * (high - low)).all() and (box < high + 0.5 * (high - low)).all()
            ]
            seen = np.concatenate([seen, *near])
        return Camera.framing(seen if len(seen) else all_points.reshape(-1, 3), self.size, direction, margin=margin)

    def radius(self, camera: Camera) -> float:
        """Half the height of the picture at the target [m]."""
        return math.dist(camera.target, camera.eye) * math.tan(0.5 * camera.angle)

    def _placed(self, q: npt.ArrayLike) -> tuple[Array, Array]:
        if not np.isfinite(np.asarray(q, dtype=np.float64)).all():
            raise InvalidInputError("q: is not finite, and cannot be drawn")
        return self._placements(q)

    def draw(
        self, q: npt.ArrayLike, forces: Forces | None = None, *, camera: Camera, force_scale: float | None = None
    ) -> Image:
        """(height, width, 3). force_scale: length of an arrow over its force [m/N]; None: by the largest force."""
        position, rotation = self._placed(q)
        # From here on the target is the origin: single precision is enough wherever in the world it is.
        position = position - camera.target
        centered = Camera(_point(np.subtract(camera.eye, camera.target)), (0.0, 0.0, 0.0), camera.angle)
        vertices = self._mesh.placed(position, rotation)
        planes = [_Plane.of(part, position[part.body], rotation[part.body]) for part in self._planes]
        view = self._view(centered, planes)
        shot = _Shot(view, self._mesh, vertices, rotation.astype(np.float32))
        image = shot.image()
        if forces is None:
            return image
        arrows = _arrows(Forces(forces.position - camera.target, forces.force), view.radius, force_scale)
        if arrows is not None:
            shot.draw_arrows(image, *arrows)
        return image

    def _view(self, camera: Camera, planes: list[_Plane]) -> _View:
        """The last one, where nothing of it has changed: films are quicker that way."""
        key = (camera, [(tuple(plane.origin), tuple(plane.normal)) for plane in planes])
        with self._lock:
            if self._last is None or self._last[0] != key:
                self._last = (key, _View(camera, self.size, planes))
            return self._last[1]


# Geometry


def _body(part: Drawable) -> int:
    return part.body


def _corners(points: Array) -> Array:
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def _unit(vectors: Floats) -> Floats:
    length = np.sqrt(np.einsum("...i,...i", vectors, vectors))
    result: Floats = vectors / np.maximum(length, np.float32(1e-30))[..., None]
    return result


class _Mesh:
    """All solids in one list of triangles. Triangle i belongs to part[i]; its normals are in the body frame."""

    def __init__(self, solids: Sequence[Drawable]) -> None:
        self._vertices: list[tuple[int, Floats]] = []  # body, vertices in its frame
        triangles, normals, parts = [], [], []
        known: dict[bytes, Floats] = {}
        first = 0
        for i, part in enumerate(solids):
            key = part.vertices.tobytes() + part.triangles.tobytes()
            if key not in known:
                known[key] = _corner_normals(part.vertices, part.triangles)
            normals.append(known[key])
            self._vertices.append((part.body, part.vertices.astype(np.float32)))
            triangles.append(part.triangles + first)
            parts.append(np.full(len(part.triangles), i, dtype=np.int32))
            first += len(part.vertices)
        self.triangles = np.concatenate(triangles).astype(np.int32) if triangles else np.zeros((0, 3), dtype=np.int32)
        self.local = np.concatenate([v for _, v in self._vertices] or [np.zeros((0, 3), dtype=np.float32)])
        self.normals = np.concatenate(normals or [np.zeros((0, 3, 3), dtype=np.float32)])
        self.part = np.concatenate(parts or [np.zeros(0, dtype=np.int32)])
        self.body = np.array([part.body for part in solids], dtype=np.int32)
        color = np.array([part.color for part in solids], dtype=np.float32).reshape(-1, 4)
        self.color = np.maximum(_linear(color[:, :3]), np.float32(0.012))  # nothing is quite black
        self.alpha = color[:, 3].copy()

    def placed(self, position: Array, rotation: Array) -> Floats:
        pieces = [v @ rotation[b].T.astype(np.float32) + position[b].astype(np.float32) for b, v in self._vertices]
        return np.concatenate(pieces) if pieces else np.zeros((0, 3), dtype=np.float32)


def _corner_normals(vertices: Array, triangles: Integers) -> Floats:
    """Normals (m, 3, 3) of all corners: the mean over those triangles at the same point whose edge is not a crease."""
    import scipy.sparse

    corners = vertices[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face, axis=1)
    unit = face / np.maximum(area, 1e-300)[:, None]
    grid = 1e-6 * max(1e-12, float(np.ptp(vertices, axis=0).max()))
    _, point = np.unique(np.rint(vertices / grid).astype(np.int64), axis=0, return_inverse=True)
    count = len(triangles)
    owner = np.repeat(np.arange(count), 3)
    at = scipy.sparse.csr_matrix(
        (np.ones(3 * count), (np.arange(3 * count), point.reshape(-1)[triangles.reshape(-1)])),
        shape=(3 * count, int(point.max(initial=0)) + 1),
    )
    of_face = scipy.sparse.csr_matrix((np.ones(3 * count), (owner, np.arange(3 * count))), shape=(count, 3 * count))
    pairs = (at @ (of_face @ at).T.tocsr()).tocoo()  # corner, triangle at the same point
    smooth = np.einsum("ij,ij->i", unit[owner[pairs.row]], unit[pairs.col]) > _CREASE
    smooth |= owner[pairs.row] == pairs.col
    row, column = pairs.row[smooth], pairs.col[smooth]
    weight = scipy.sparse.csr_matrix((area[column], (row, column)), shape=(3 * count, count))
    return _unit((weight @ unit).astype(np.float32)).reshape(count, 3, 3)


@dataclass(frozen=True)
class _Plane:
    """A half space. origin, normal, and two axes in it; floor: it faces upwards."""

    origin: Floats
    normal: Floats
    axes: Floats
    floor: bool

    @classmethod
    def of(cls, part: Drawable, position: Array, rotation: Array) -> _Plane:
        corners = part.vertices[part.triangles[0]] @ rotation.T + position
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        origin = part.vertices.mean(axis=0) @ rotation.T + position
        first = np.cross((0.0, 1.0, 0.0) if abs(normal[1]) < 0.9 else (1.0, 0.0, 0.0), normal)
        first /= np.linalg.norm(first)
        axes = np.array([first, np.cross(normal, first)])
        return cls(
            origin.astype(np.float32), normal.astype(np.float32), axes.astype(np.float32), floor=bool(normal[2] > 0.8)
        )


class _Rays:
    """An Embree scene."""

    def __init__(self, vertices: Floats, triangles: Integers) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene() if len(triangles) else None
        if self._scene is not None:
            TriangleMesh(self._scene, vertices, triangles)

    def first(self, origins: Floats, directions: Floats) -> tuple[Integers, Floats, Floats]:
        """Triangle (-1: none), distance (inf: none) and barycentric coordinates (n, 2) of what each ray meets first."""
        count = len(directions)
        if self._scene is None or not count:
            none = np.full(count, np.inf, dtype=np.float32)
            return np.full(count, -1, dtype=np.int32), none, np.zeros((count, 2), dtype=np.float32)
        hit = self._scene.run(origins, directions, query="INTERSECT", output=True)
        triangle = hit["primID"].astype(np.int32)
        distance = np.where(triangle < 0, np.float32(np.inf), hit["tfar"])
        return triangle, distance, np.stack([hit["u"], hit["v"]], axis=1)

    def blocked(self, origins: Floats, directions: Floats, reach: float = math.inf) -> Bools:
        """Whether each ray meets anything nearer than reach."""
        if self._scene is None or not len(directions):
            return np.zeros(len(directions), dtype=bool)
        reaches = np.full(len(directions), min(reach, 1e30), dtype=np.float32)
        found = self._scene.run(origins, directions, reaches, query="OCCLUDED")
        return np.asarray(found) >= 0


# Light


def _linear(color: npt.ArrayLike) -> Floats:
    """sRGB to linear."""
    c = np.asarray(color, dtype=np.float64)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _encode_table() -> Image:
    x = np.linspace(0.0, 1.0, 4096)
    return np.rint(255.0 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)).astype(np.uint8)


_ENCODED = _encode_table()


def _encoded(linear: Floats) -> Image:
    """Linear to sRGB, bright light compressed."""
    shoulder = np.float32(0.75)
    over = np.maximum(linear - shoulder, 0.0)
    compressed = np.minimum(linear, shoulder) + over / (1.0 + over / (1.0 - shoulder))
    result: Image = _ENCODED[(np.clip(compressed, 0.0, 1.0) * 4095.0 + 0.5).astype(np.int32)]
    return result


def _frame(direction: Array) -> Array:
    """3 x 3, rows: two unit vectors normal to a unit vector, and itself."""
    first = np.cross(direction, (0.0, 0.0, 1.0) if abs(direction[2]) < 0.9 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first), direction])


@dataclass(frozen=True, eq=False)
class _Layer:
    """What is seen of a half space.

    at: the rays (n) that meet it; t: how far away [m]; place: (n, 3); seen: (n), 0 where it has faded away; base: its
    colour (n, 3).
    """

    plane: _Plane
    at: npt.NDArray[np.int64]
    t: Floats
    place: Floats
    seen: Floats
    base: Floats


@dataclass(frozen=True, eq=False)
class _Grid:
    """Rays through pixels and what they see of sky and half spaces, without light; depth: (n), of the latter."""

    pixels: Floats
    directions: Floats
    sky: Floats
    layers: list[_Layer]
    depth: Floats


class _View:
    """What pictures by one camera have in common, as long as no half space moves: rays, sky, half spaces, the sun.

    camera: its target is the origin.
    """

    def __init__(self, camera: Camera, size: tuple[int, int], planes: Sequence[_Plane]) -> None:
        self.camera, self.size = camera, size
        self.eye = np.array(camera.eye, dtype=np.float32)
        facing = [plane for plane in planes if float(plane.normal @ (self.eye - plane.origin)) > 0.0]
        self.planes = sorted(facing, key=lambda plane: not plane.floor)  # walls are drawn over the floor
        half = math.tan(0.5 * camera.angle)
        self.radius = float(np.linalg.norm(self.eye)) * half  # half the height of the picture there
        self.pixel = 2.0 * half / size[1]  # [rad]
        right, _, forward = camera.axes
        level = np.array([forward[0], forward[1], 0.0])
        level /= max(1e-9, float(np.linalg.norm(level)))
        sun = -0.62 * right - 0.42 * level + np.array([0.0, 0.0, 1.15])
        self.sun = _frame(sun / np.linalg.norm(sun)).astype(np.float32)  # rows: across, across, towards it
        self.fill = _unit((0.8 * right - 0.6 * level + np.array([0.0, 0.0, 0.25])).astype(np.float32))
        width, height = size
        self.full = self.grid(_pixels(width, height) + np.float32(0.5))
        self.coarse = self.grid(2.0 * _pixels(width // 2 + 1, height // 2 + 1))

    def grid(self, pixels: Floats) -> _Grid:
        directions = self.camera.directions(pixels, self.size)
        top, horizon = _linear(_SKY[0]), _linear(_SKY[1])
        height = np.clip(np.abs(directions[:, 2:]) * np.float32(1.6), 0.0, 1.0)
        sky = horizon + (top - horizon) * np.where(directions[:, 2:] > 0.0, height, np.float32(0.6) * height)
        depth = np.full(len(directions), np.inf, dtype=np.float32)
        layers = []
        for plane in self.planes:
            t = self.meet(plane, self.eye, directions)
            met = np.flatnonzero(t < depth)
            place = self.eye + directions[met] * t[met, None]
            seen = self._fading(plane, place)
            kept = seen > 0.01
            met, place, seen = met[kept], place[kept], seen[kept]
            base = self._chequers(plane, place, directions[met], t[met])
            layers.append(_Layer(plane, met, t[met], place, seen, base))
            depth[met] = t[met]
        return _Grid(pixels, directions, sky, layers, depth)

    @staticmethod
    def meet(plane: _Plane, origins: Floats, directions: Floats) -> Floats:
        """Distances (n) to a half space from its free side; inf: never."""
        fall = directions @ plane.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((plane.origin - origins) @ plane.normal / fall).astype(np.float32)
        return np.where((fall < -1e-4) & (t > 0.0), t, np.float32(np.inf))

    def _fading(self, plane: _Plane, place: Floats) -> Floats:
        away = place - (place @ plane.normal)[:, None] * plane.normal
        reach = np.sqrt(np.einsum("ni,ni->n", away, away)) / np.float32(self.radius)
        if plane.floor:
            return np.asarray(np.exp(-((reach / np.float32(7.0)) ** 2)))
        return np.asarray(np.float32(0.9) * np.clip((np.float32(1.5) - reach) / np.float32(0.7), 0.0, 1.0))

    def _chequers(self, plane: _Plane, place: Floats, directions: Floats, depth: Floats) -> Floats:
        """Of a round size, averaged over each pixel."""
        size = _round_size(0.55 * self.radius)
        at = (place - plane.origin) @ plane.axes.T / np.float32(size)
        slope = np.maximum(-directions @ plane.normal, np.float32(1e-3))
        along = np.abs(directions @ plane.axes.T) / slope[:, None]
        width = (depth * np.float32(self.pixel / size))[:, None] * (1.0 + along)
        after, before = (np.abs((at + s * width) * np.float32(0.5) % 1.0 - np.float32(0.5)) for s in (0.5, -0.5))
        mean = np.clip(2.0 * (before - after) / np.maximum(width, np.float32(1e-6)), -1.0, 1.0)
        mixed = (0.5 - 0.5 * mean[:, :1] * mean[:, 1:]).astype(np.float32)
        first, second = (_linear(color) for color in (_FLOOR if plane.floor else _WALL))
        result: Floats = first + (second - first) * mixed
        return result


def _pixels(width: int, height: int) -> Floats:
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return np.stack([x.ravel(), y.ravel()], axis=1)


class _Shot:
    """One picture: bodies at their places in a view."""

    def __init__(self, view: _View, mesh: _Mesh, vertices: Floats, rotation: Floats) -> None:
        self._view, self._mesh, self._vertices, self._rotation = view, mesh, vertices, rotation
        self._seen = _Rays(vertices, mesh.triangles)
        opaque = mesh.alpha[mesh.part] > 0.99
        self._transparent = not opaque.all()
        self._casting = _Rays(vertices, mesh.triangles[opaque]) if self._transparent else self._seen
        self._low, self._high = np.zeros(3, dtype=np.float32), np.zeros(3, dtype=np.float32)
        if len(vertices):
            self._low, self._high = vertices.min(axis=0), vertices.max(axis=0)
        self._within = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])  # the rectangle with all solids [pixels]
        if len(vertices) and ((vertices - view.eye) @ view.camera.axes[2] > 1e-3 * view.radius).all():
            corners = view.camera.project(vertices, view.size)
            self._within = np.array([corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0])
        self._hidden_reach = np.float32(0.45 * view.radius)  # bodies farther away do not hide the sky
        self._open = self._open_shares()

    def image(self) -> Image:
        """(height, width, 3), without arrows."""
        width, height = self._view.size
        linear, self.depth = self._colors(self._view.full, 16)
        image = _encoded(linear).reshape(height, width, 3)
        edge = np.flatnonzero(_edges(image))
        if edge.size:
            total = _clamped(linear[edge])
            for k, offset in enumerate(_OFFSETS):
                grid = self._view.grid(self._view.full.pixels[edge] + offset)
                total += _clamped(self._colors(grid, 1, k)[0])
            image.reshape(-1, 3)[edge] = _encoded(total / np.float32(len(_OFFSETS) + 1))
        return image

    # What a ray sees

    def _colors(self, grid: _Grid, sun_rays: int, first_sun_ray: int = 0) -> tuple[Floats, Floats]:
        """Linear colour (n, 3), and distance (n) of what is seen."""
        triangle, depth, uv = self._first(grid)
        solid = depth < grid.depth
        covered = solid.copy()
        if self._transparent:
            hit = np.flatnonzero(solid)
            covered[hit] = self._mesh.alpha[self._mesh.part[triangle[hit]]] > 0.99
        color = grid.sky.copy()
        for layer in grid.layers:
            bare = np.flatnonzero(~covered[layer.at])
            at, seen = layer.at[bare], layer.seen[bare, None]
            own = self._floor_colors(layer, bare, grid.pixels[at], sun_rays, first_sun_ray)
            color[at] += seen * (own - color[at])
        self._blend_solids(color, grid, np.flatnonzero(solid), (triangle, depth, uv), sun_rays, first_sun_ray)
        return color, np.minimum(depth, grid.depth)

    def _first(self, grid: _Grid) -> tuple[Integers, Floats, Floats]:
        """_Rays.first for the eye; no rays are cast where no solid is."""
        (left, top), (right, bottom) = self._within
        x, y = grid.pixels[:, 0], grid.pixels[:, 1]
        at = np.flatnonzero((x > left) & (x < right) & (y > top) & (y < bottom))
        directions = grid.directions[at]
        triangle = np.full(len(x), -1, dtype=np.int32)
        depth, uv = np.full(len(x), np.inf, dtype=np.float32), np.zeros((len(x), 2), dtype=np.float32)
        origins = np.broadcast_to(self._view.eye, directions.shape).copy()
        triangle[at], depth[at], uv[at] = self._seen.first(origins, directions)
        return triangle, depth, uv

    def _blend_solids(
        self, color: Floats, grid: _Grid, hit: npt.NDArray[np.int64],
        found: tuple[Integers, Floats, Floats], sun_rays: int, first_sun_ray: int, level: int = 0
    ) -> None:  # fmt: skip
        """Puts the colour of the triangles that were met over that of what is behind."""
        if not hit.size:
            return
        triangle, depth, uv = found
        alpha = self._mesh.alpha[self._mesh.part[triangle[hit]]]
        through = hit[alpha < 0.99]
        if through.size:  # of what is transparent, the front faces alone are seen
            a, b, c = (self._vertices[self._mesh.triangles[triangle[through], k]] for k in range(3))
            back = np.einsum("ni,ni->n", np.cross(b - a, c - a), grid.directions[through]) > 0.0
            alpha[np.flatnonzero(alpha < 0.99)[back]] = 0.0
        if through.size and level < 8:
            step = np.float32(2e-4 * self._view.radius)
            start = self._view.eye + grid.directions[through] * (depth[through] + step)[:, None]
            next_triangle, beyond, next_uv = self._seen.first(start, grid.directions[through])
            behind = (triangle.copy(), np.full_like(depth, np.inf), uv.copy())
            behind[0][through], behind[1][through] = next_triangle, depth[through] + step + beyond
            behind[2][through] = next_uv
            farther = through[behind[1][through] < grid.depth[through]]
            self._blend_solids(color, grid, farther, behind, sun_rays, first_sun_ray, level + 1)
        directions = grid.directions[hit]
        place, start, normal = self._surface(directions, triangle[hit], depth[hit], uv[hit])
        base = self._mesh.color[self._mesh.part[triangle[hit]]]
        own = self._lit(base, directions, start, normal, self._sky_at(grid.pixels[hit], place), sun_rays, first_sun_ray)
        color[hit] += alpha[:, None] * (own - color[hit])

    def _surface(
        self, directions: Floats, triangle: Integers, depth: Floats, uv: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Points, the same on the rounded surface, and its normals, towards the eye."""
        mesh = self._mesh
        weights = np.stack([1.0 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1)
        local, normals = mesh.local[mesh.triangles[triangle]], mesh.normals[triangle]
        point, normal = (np.einsum("nk,nki->ni", weights, a) for a in (local, normals))
        # Facets would show in their own shadow: it starts where the normals say the surface is (Hanika 2021).
        outside = np.minimum(np.einsum("nki,nki->nk", point[:, None] - local, normals), 0.0)
        lift = -np.einsum("nk,nki->ni", weights * outside, normals)
        rotation = self._rotation[mesh.body[mesh.part[triangle]]]
        normal = _unit(np.einsum("nij,nj->ni", rotation, normal))
        lift = np.einsum("nij,nj->ni", rotation, lift)
        inside = np.einsum("ni,ni->n", normal, directions) > 0.35  # winding the wrong way, or an open mesh
        normal[inside] *= -1.0
        lift[inside] = 0.0
        place = self._view.eye + directions * depth[:, None]
        return place, place + lift, normal

    # Light

    def _lit(
        self, base: Floats, directions: Floats, start: Floats, normal: Floats, sky: Floats, sun_rays: int, first: int
    ) -> Floats:
        """Colour of solids. start: where their shadow rays start. sky: share of it that is seen."""
        sun = self._view.sun[2]
        facing = normal @ sun
        light = np.zeros(len(base), dtype=np.float32)
        lit = np.flatnonzero(facing > 0.0)
        offset = np.float32(6e-4 * self._view.radius)
        light[lit] = self._sunlight(start[lit] + normal[lit] * offset, sun_rays, first)
        up = np.float32(0.5) + np.float32(0.5) * normal[:, 2:]
        ambient = _GROUND_LIGHT + up * (_SKY_LIGHT - _GROUND_LIGHT)
        ambient += _FILL * np.maximum(normal @ self._view.fill, 0.0)[:, None]
        color = base * (ambient * sky[:, None] + (_SUN * np.maximum(facing, 0.0) * light)[:, None])
        shine = np.clip(np.einsum("ni,ni->n", normal, _unit(sun - directions)), 0.0, 1.0) ** 48
        grazing = (1.0 - np.maximum(-np.einsum("ni,ni->n", normal, directions), 0.0)) ** 4
        result: Floats = color + _GLOSS * (shine * light)[:, None] + (_SHEEN * grazing * sky)[:, None] * _SKY_LIGHT
        return result

    def _floor_colors(
        self, layer: _Layer, which: npt.NDArray[np.int64], pixels: Floats, sun_rays: int, first: int
    ) -> Floats:
        """Colour of a half space, without gloss; far from all bodies nothing is asked of any ray."""
        normal, place = layer.plane.normal, layer.place[which]
        facing = max(float(normal @ self._view.sun[2]), 0.0)
        up = np.float32(0.5 + 0.5 * normal[2])
        ambient = _GROUND_LIGHT + up * (_SKY_LIGHT - _GROUND_LIGHT)
        ambient = ambient + _FILL * max(float(normal @ self._view.fill), 0.0)
        light = self._sunlight(place, sun_rays, first) * np.float32(_SUN * facing)
        sky = self._sky_at(pixels, place)
        result: Floats = layer.base[which] * (sky[:, None] * ambient + light[:, None])
        return result

    def _sunlight(self, start: Floats, count: int, first: int) -> Floats:
        """Share of the sun that is seen from points. Where few rays agree, no more are cast."""
        share = np.ones(len(start), dtype=np.float32)
        near = np.flatnonzero(self._may_meet(start, self._view.sun[2]))
        if not near.size:
            return share
        start = start[near]

        def blocked(points: Floats, rays: Iterable[int]) -> Floats:
            total = np.zeros(len(points), dtype=np.float32)
            for ray in rays:
                x, y = _SUN_DISC[ray % len(_SUN_DISC)]
                direction = self._view.sun[2] + x * self._view.sun[0] + y * self._view.sun[1]
                total += self._casting.blocked(points, np.broadcast_to(direction, points.shape).copy())
            return total

        if count <= 4:
            share[near] -= blocked(start, range(first, first + count)) / np.float32(count)
            return share
        shadow = blocked(start, range(4))
        unsure = np.flatnonzero((shadow > 0.0) & (shadow < 4.0))
        shadow *= np.float32(0.25)
        if unsure.size:
            shadow[unsure] = (4.0 * shadow[unsure] + blocked(start[unsure], range(4, count))) / np.float32(count)
        share[near] -= shadow
        return share

    def _may_meet(self, start: Floats, direction: Floats) -> Bools:
        """Whether a ray meets the box around all solids, with a margin for the width of the sun."""
        margin = np.float32(2.0 * _SUN_RADIUS * np.linalg.norm(self._high - self._low))
        near, far = np.zeros(len(start), dtype=np.float32), np.full(len(start), np.inf, dtype=np.float32)
        for i in range(3):
            if abs(direction[i]) < 1e-6:
                continue
            a, b = ((bound - start[:, i]) / direction[i] for bound in (self._low[i] - margin, self._high[i] + margin))
            np.maximum(near, np.minimum(a, b), out=near)
            np.minimum(far, np.maximum(a, b), out=far)
        return far > near

    def _open_shares(self) -> tuple[Floats, Floats] | None:
        """The share of the sky that bodies do not hide, at what is seen through each second pixel; and these points."""
        if not len(self._vertices):
            return None
        grid = self._view.coarse
        triangle, depth, uv = self._first(grid)
        normal, place = np.zeros_like(grid.directions), np.full_like(grid.directions, 1e9)
        for layer in grid.layers:
            normal[layer.at], place[layer.at] = layer.plane.normal, layer.place
        hit = np.flatnonzero(depth < grid.depth)
        place[hit], _, normal[hit] = self._surface(grid.directions[hit], triangle[hit], depth[hit], uv[hit])
        depth = np.minimum(depth, grid.depth)
        width, height = (n // 2 + 1 for n in self._view.size)
        share = np.ones(len(depth), dtype=np.float32)
        at = np.flatnonzero(self._near(place) & np.isfinite(depth))
        if at.size:
            share[at] = self._sky_share(place[at], normal[at], at // width % 4 * 4 + at % width % 4)
            share = _smoothed(share, place, normal, depth, (height, width))
        return share, place

    def _near(self, place: Floats) -> Bools:
        """Whether bodies may hide the sky there."""
        result = np.ones(len(place), dtype=bool)
        for i in range(3):
            result &= place[:, i] > self._low[i] - self._hidden_reach
            result &= place[:, i] < self._high[i] + self._hidden_reach
        return result

    def _sky_share(self, place: Floats, normal: Floats, pattern: npt.NDArray[np.int64]) -> Floats:
        """By few rays a point; the points of a 4 x 4 block cast theirs into different directions (pattern)."""
        sign = np.where(normal[:, 2] >= 0.0, np.float32(1.0), np.float32(-1.0))  # a basis, after Duff et al. 2017
        a = -1.0 / (sign + normal[:, 2])
        b = normal[:, 0] * normal[:, 1] * a
        first = np.stack([1.0 + sign * normal[:, 0] ** 2 * a, sign * b, -sign * normal[:, 0]], axis=1)
        second = np.stack([b, sign + normal[:, 1] ** 2 * a, -normal[:, 1]], axis=1)
        start = place + normal * np.float32(1.5e-3 * self._view.radius)
        reach = self._hidden_reach
        open_share = np.zeros(len(place), dtype=np.float32)
        for samples in _SKY_SAMPLES:
            s = samples[pattern]
            direction = s[:, :1] * first + s[:, 1:2] * second + s[:, 2:] * normal
            free = 1.0 - self._casting.blocked(start, direction, float(reach)).astype(np.float32)
            for plane in self._view.planes:  # they hide what is close; their own light counts as sky
                free *= np.sqrt(np.minimum(self._view.meet(plane, start, direction) / reach, 1.0))
            open_share += free
        result: Floats = open_share / np.float32(len(_SKY_SAMPLES))
        return result

    def _sky_at(self, pixels: Floats, place: Floats) -> Floats:
        """Share of the sky at points that are seen through pixels: of those around them on the same surface."""
        result = np.ones(len(pixels), dtype=np.float32)
        if self._open is None:
            return result
        near = np.flatnonzero(self._near(place))
        share, grid_place = self._open
        width, height = (n // 2 + 1 for n in self._view.size)
        place = place[near]
        x, y = pixels[near, 0] * np.float32(0.5), pixels[near, 1] * np.float32(0.5)
        x0, y0 = np.clip(x.astype(np.int32), 0, width - 2), np.clip(y.astype(np.int32), 0, height - 2)
        x, y = x - x0, y - y0
        away = place - self._view.eye
        scale = np.einsum("ni,ni->n", away, away) * np.float32((3.0 * self._view.pixel) ** 2)
        total, weights = np.zeros_like(x), np.zeros_like(x)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            i = (y0 + dy) * width + x0 + dx
            away = grid_place[i] - place
            far = np.minimum(np.einsum("ni,ni->n", away, away) / scale, np.float32(1e6))
            beside = np.maximum((x if dx else 1.0 - x) * (y if dy else 1.0 - y), 0.0) + np.float32(1e-3)
            weight = beside / (1.0 + far * far)
            total += weight * share[i]
            weights += weight
        result[near] = total / weights
        return result

    # Arrows

    def draw_arrows(self, image: Image, vertices: Floats, triangles: Integers, normals: Floats) -> None:
        """Over the picture; where a body hides an arrow, it shines through."""
        width, height = self._view.size
        rays = _Rays(vertices, triangles)
        in_front = (vertices - self._view.eye) @ self._view.camera.axes[2] > 1e-3 * self._view.radius
        mask = np.zeros((height, width), dtype=bool)
        corners = self._view.camera.project(vertices, self._view.size)[triangles]
        seen = in_front[triangles].all(axis=1)
        low = np.floor(corners.min(axis=1) - 1).astype(int)
        high = np.ceil(corners.max(axis=1) + 1).astype(int)
        for (x0, y0), (x1, y1) in zip(low[seen], high[seen], strict=True):
            mask[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)] = True
        at = np.flatnonzero(mask)
        if not at.size:
            return
        centers = np.stack([at % width + 0.5, at // width + 0.5], axis=1).astype(np.float32)
        total = np.zeros((len(at), 3), dtype=np.float32)
        cover = np.zeros(len(at), dtype=np.float32)
        base = _linear(ARROW_COLOR)
        for dx, dy in ((-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375)):
            directions = self._view.camera.directions(centers + np.array([dx, dy], dtype=np.float32), self._view.size)
            triangle, depth, _ = rays.first(np.broadcast_to(self._view.eye, directions.shape).copy(), directions)
            hit = np.flatnonzero(triangle >= 0)
            facing = np.abs(np.einsum("ni,ni->n", normals[triangle[hit]], directions[hit]))
            light = (0.45 + 0.75 * facing)[:, None]
            alpha = np.where(depth[hit] < self.depth[at[hit]] + 2e-3 * self._view.radius, 1.0, 0.5)
            total[hit] += alpha[:, None] * light * base
            cover[hit] += alpha
        met = cover > 0.0
        at, share = at[met], 0.25 * cover[met, None]
        flat = image.reshape(-1, 3)
        mixed = 0.25 * total[met] + (1.0 - share) * _linear(flat[at] / 255.0)
        flat[at] = _ENCODED[(np.clip(mixed, 0.0, 1.0) * 4095.0 + 0.5).astype(np.int32)]


def _clamped(linear: Floats) -> Floats:
    result: Floats = np.minimum(linear, np.float32(1.5))  # so that one bright sample does not outshine its pixel
    return result


def _edges(image: Image) -> Bools:
    """Pixels that differ from a neighbour."""
    wide = image.astype(np.int16)
    mask = np.zeros(image.shape[:2], dtype=bool)
    across = (np.abs(wide[:, 1:] - wide[:, :-1]) > _CONTRAST).any(axis=2)
    down = (np.abs(wide[1:] - wide[:-1]) > _CONTRAST).any(axis=2)
    mask[:, 1:] |= across
    mask[:, :-1] |= across
    mask[1:] |= down
    mask[:-1] |= down
    return mask


def _smoothed(share: Floats, place: Floats, normal: Floats, depth: Floats, shape: tuple[int, int]) -> Floats:
    """The mean over 4 x 4 blocks around each point, as far as they lie on the same surface."""
    height, width = shape
    grid = [a.reshape(height, width, -1) for a in (share[:, None], place, normal)]
    padded = [np.pad(a, ((2, 2), (2, 2), (0, 0)), mode="edge") for a in grid]
    scale = (depth.reshape(height, width) * np.float32(0.004)) + np.float32(1e-6)
    total = np.zeros(shape, dtype=np.float32)
    weights = np.zeros(shape, dtype=np.float32)
    for dy in range(4):
        for dx in range(4):
            part = [a[dy : dy + height, dx : dx + width] for a in padded]
            off = np.abs(np.einsum("yxi,yxi->yx", part[1] - grid[1], grid[2]))
            same = np.einsum("yxi,yxi->yx", part[2], grid[2]) > 0.8
            weight = np.where(same & (off < scale), np.float32(1.0), np.float32(0.0))
            total += weight * part[0][..., 0]
            weights += weight
    center = grid[0][..., 0]
    return np.where(weights > 0.0, total / np.maximum(weights, 1.0), center).ravel()


def _round_size(about: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(max(about, 1e-9)))
    return power * max(m for m in (1.0, 2.0, 5.0) if m * power <= about * 1.0000001)


# Forces


def force_scale(largest: Sequence[float], radius: float) -> float:
    """Length of arrows over force [m/N]: the median of each state's largest force is 0.3 of a radius long."""
    present = sorted(force for force in largest if force > 0.0)
    return 0.3 * radius / present[len(present) // 2] if present else 0.0


def _arrows(forces: Forces, radius: float, scale: float | None) -> tuple[Floats, Integers, Floats] | None:
    """Vertices, triangles, normal of each triangle; an arrow per force."""
    sizes = forces.size
    if scale is None:
        scale = force_scale([float(sizes.max(initial=0.0))], radius)
    shape, triangles = _arrow_shape()
    vertices: list[Array] = []
    all_triangles: list[Integers] = []
    for position, force, size in zip(forces.position, forces.force, sizes, strict=True):
        length = min(size * scale, 1.2 * radius)
        thickness = min(1.0, length / (0.1 * radius)) * 0.009 * radius
        if length < 0.01 * radius:
            continue
        axes = _frame(force / size)
        head = min(6.0 * thickness, 0.5 * length)
        placed = shape[:, :2] @ axes[:2] * thickness + np.outer(
            np.where(shape[:, 2] == 2.0, length, np.where(shape[:, 2] == 1.0, length - head, 0.0)), axes[2]
        )
        all_triangles.append(triangles + len(shape) * len(vertices))
        vertices.append(placed + position)
    if not vertices:
        return None
    points, index = np.concatenate(vertices), np.concatenate(all_triangles).astype(np.int32)
    corners = points[index]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return points.astype(np.float32), index, _unit(normals.astype(np.float32))


def _arrow_shape(count: int = 12) -> tuple[Array, Integers]:
    """Shaft of radius 1, head of radius 2.4; z is 0 at the start, 1 where the head begins, 2 at its tip."""
    angle = np.arange(count) * (2.0 * math.pi / count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [np.column_stack([r * circle, np.full(count, z)]) for r, z in ((1, 0.0), (1, 1.0), (2.4, 1.0), (0.01, 2.0))]
    i = np.arange(count)
    j = (i + 1) % count
    triangles = [np.column_stack([np.zeros(count - 2, dtype=int), i[2:], i[1:-1]])]
    for ring in range(3):
        a, b = ring * count, (ring + 1) * count
        triangles += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    return np.concatenate(rings), np.concatenate(triangles).astype(np.int32)
