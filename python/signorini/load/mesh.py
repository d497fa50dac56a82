"""Mesh files (STL, OBJ, PLY, Collada) -> points and triangles -> a convex hull with few vertices, or several.

Readers are bounded in time and memory by the size of the file.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini.load import _xml
from signorini.load._placement import Placement, identity

if TYPE_CHECKING:
    from signorini._world import Shape

Array = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int32]
Indices = npt.NDArray[np.int64]

MAX_BYTES = 512 * 2**20
MAX_POINTS = 20_000_000
#: A hull with more vertices than this is replaced by one of a subset of them (docs/robot_files.md: what that costs).
HULL_VERTICES = 256
#: A flat mesh gets this thickness [m].
THICKNESS = 1e-3
_FLAT = 1e-6  # of the largest extent
_POINT = 1e-9  # [m]
_CHUNK = 4096  # points at a time, to bound memory
_MANY = 20_000  # candidates for corners, beyond which most are left out
#: A hull is the box that its corners are within this share of their distance from the origin: files have few digits.
BOX = 1e-6
#: Volume that the hull of a mesh adds, as a share: up to here the mesh is convex, from here on it is said.
CONVEX, MUCH = 0.01, 0.2
#: Extents [m] beyond which a mesh is probably not in metres.
LARGE, SMALL = 50.0, 1e-3


@dataclass(frozen=True, eq=False)
class Mesh:
    """points: (n, 3); triangles: (m, 3), indices of points; None: the file has none, or they are of a kind that is not
    read. STL: three points a triangle."""

    points: Array
    triangles: Indices | None = None

    def scaled(self, scale: Array) -> Mesh:
        """scale: (3,); triangles go on winding as they did."""
        triangles = self.triangles
        if triangles is not None and np.prod(scale) < 0.0:
            triangles = triangles[:, ::-1]
        return Mesh(self.points * scale, triangles)


@dataclass(frozen=True, eq=False)
class Hull:
    """vertices: (n, 3) [m]; triangles: (m, 3), winding outwards; volume_share: of the full hull, in (0, 1];
    notes: what was done to it, for a person. volume: what it encloses [m^3]; mesh_volume: what the mesh does, None
    where that is not closed; mesh_points: how many the mesh has."""

    vertices: Array
    triangles: Triangles
    volume_share: float = 1.0
    notes: tuple[str, ...] = ()
    volume: float = 0.0
    mesh_volume: float | None = None
    mesh_points: int = 0

    @property
    def added(self) -> float | None:
        """Volume that the hull adds, as a share of the mesh's; None where the mesh is not closed."""
        return None if self.mesh_volume is None else self.volume / self.mesh_volume - 1.0


def read(path: Path) -> Mesh:
    """A mesh file in its own unit (Collada: in metres).

    Raises InvalidInputError naming the file and what is wrong with it.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        _fail(path, f'has suffix "{path.suffix}"; meshes are read from {", ".join(_READERS)}')
    try:
        if not path.is_file():
            _fail(path, "is no regular file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            _fail(path, f"has {size} bytes, at most {MAX_BYTES} are read")
        mesh = reader(path)
    except OSError as error:
        _fail(path, f"cannot be read: {error.strerror}")
    points = mesh.points
    if not len(points):
        _fail(path, "has no vertices")
    if len(points) > MAX_POINTS:
        _fail(path, f"has {len(points)} vertices, at most {MAX_POINTS} are read")
    if not np.isfinite(points).all():
        _fail(path, "has a vertex that is not finite")
    if np.abs(points).max() > 1e9:
        _fail(path, f"has a vertex at {np.abs(points).max():g}, must be within 1e9 of the origin")
    return mesh


def read_points(path: Path) -> Array:
    """The vertices of a mesh file, (n, 3); see read()."""
    return read(path).points


def volume(mesh: Mesh) -> float | None:
    """What a mesh encloses, by the divergence theorem; None when it is not closed, or winds this way here and the other
    way there."""
    if mesh.triangles is None or not len(mesh.triangles) or not _closed(mesh):
        return None
    points = mesh.points - mesh.points.mean(0)
    total = 0.0
    for begin in range(0, len(mesh.triangles), 64 * _CHUNK):
        a, b, c = (points[mesh.triangles[begin : begin + 64 * _CHUNK, i]] for i in range(3))
        total += float(np.einsum("ij,ij->", a, np.cross(b, c)))
    return abs(total) / 6.0


def _closed(mesh: Mesh) -> bool:
    """Whether every edge is passed as often one way as the other: a hash of edges that changes its sign with their
    direction adds up to 0. No sorting, so quick. Points are the same where their coordinates are."""
    assert mesh.triangles is not None
    bits = np.ascontiguousarray(mesh.points + 0.0).view(np.uint64)  # -0 becomes 0
    code = _mixed(_mixed(_mixed(bits[:, 0]) + bits[:, 1]) + bits[:, 2])
    total = 0
    for begin in range(0, len(mesh.triangles), 64 * _CHUNK):
        corners = code[mesh.triangles[begin : begin + 64 * _CHUNK]]
        for i in range(3):
            a, b = corners[:, i], corners[:, (i + 1) % 3]
            edge = _mixed(_mixed(np.minimum(a, b)) + np.maximum(a, b))
            total += int(edge[a < b].sum()) - int(edge[a > b].sum())
    return total % 2**64 == 0


def _mixed(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Bits well mixed, one to one (the last step of SplitMix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))


def convex_hull(
    points: Array, max_vertices: int | None = HULL_VERTICES, triangles: npt.NDArray[np.integer[Any]] | None = None
) -> Hull:
    """The convex hull of points, (n, 3) [m], with at most max_vertices of them; None: all. triangles: (m, 3) of the
    mesh, for its volume.

    A hull with more vertices shrinks to that of the subset found by adding, again and again, the vertices that are
    farthest outside. Flat points are given a thickness of 1 mm. Raises InvalidInputError for points on a line or fewer
    than three.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = np.asarray(points, dtype=np.float64)
    mesh = Mesh(points, None if triangles is None else triangles.astype(np.int64))
    notes: list[str] = []
    if not np.isfinite(points).all():
        raise InvalidInputError("a vertex is not finite")
    centre = points.mean(0)
    # Extents along the principal axes; of a sample when there are very many points.
    axes = np.linalg.svd(np.cov((points - centre).T), hermitian=True)[2] if len(points) > 1 else np.eye(3)
    extents = np.ptp((points - centre) @ axes.T, axis=0)
    if not extents[0] > _POINT:
        raise InvalidInputError("all vertices are one point; a hull needs four that are in no plane")
    if extents[1] <= _FLAT * extents[0]:
        raise InvalidInputError("all vertices are on one line; a hull needs four that are in no plane")
    if extents[2] <= _FLAT * extents[0]:
        offset = 0.5 * THICKNESS * axes[2]
        points = np.concatenate([points - offset, points + offset])
        notes.append(f"is flat and was given a thickness of {1e3 * THICKNESS:g} mm")
    if extents.max() > LARGE or extents.max() < SMALL:
        notes.append(f"is {extents.max():.3g} m long; is it in metres? (from millimetres: scale 0.001)")
    try:
        candidates = _outer(points)
        if max_vertices is not None and len(candidates) > _MANY:
            candidates = candidates[_farthest((candidates - centre) @ axes.T)]
        full = ConvexHull(candidates)
    except QhullError as error:
        raise InvalidInputError(f"no convex hull: {str(error).splitlines()[0]}") from None
    corners = full.points[full.vertices]
    enclosed = None if notes else volume(mesh)
    if enclosed is not None and not _FLAT * full.volume < enclosed <= full.volume * 1.001:
        enclosed = None  # shells that cancel, or lie within each other
    hull = ConvexHull(corners)
    if max_vertices is not None and len(corners) > max_vertices:
        corners = _reduced(corners, max_vertices)
        hull = ConvexHull(corners)
    share = min(float(hull.volume / full.volume), 1.0)
    return Hull(*_wound(corners, hull), share, tuple(notes), float(hull.volume), enclosed, len(mesh.points))


def hulls(mesh: Mesh, max_vertices: int | None = HULL_VERTICES, split: bool = False) -> list[Hull]:
    """The hull of a mesh [m]; with `split`, and where that adds to the mesh, the hulls of convex pieces of it.

    Raises InvalidInputError as convex_hull() does, ImportError when pieces are asked for and coacd is missing.
    """
    whole = convex_hull(mesh.points, max_vertices, mesh.triangles)
    if not split or (whole.added is not None and whole.added <= CONVEX):
        return [whole]
    if mesh.triangles is None or not len(mesh.triangles):
        return [replace(whole, notes=(*whole.notes, "is not decomposed: there are no triangles to go by"))]
    from signorini.load import _pieces

    if whole.mesh_volume is None and not whole.notes:
        whole = replace(whole, notes=("is not closed: its pieces are those of its skin",))
    found = []
    for points in _pieces.pieces(mesh.points, mesh.triangles):
        with suppress(InvalidInputError):  # slivers
            found.append(replace(convex_hull(points, max_vertices), notes=whole.notes))
    return found or [whole]


def shape(hull: Hull) -> tuple[Shape, Placement]:
    """A hull as what collides, and where that is in its frame: a box where it is one, else the polyhedron."""
    from signorini._world import Box, Convex

    box = _box(hull)
    return (Convex(hull.vertices, hull.triangles), identity()) if box is None else (Box(box[0]), box[1])


def _box(hull: Hull) -> tuple[tuple[float, float, float], Placement] | None:
    """Half extents and placement of the box that a hull is; its axes are called as those that they are next to."""
    a, b, c = (hull.vertices[hull.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1)
    first = normals[np.argmax(areas)] / areas.max()
    beside = np.where(np.abs(normals @ first) < 0.01 * areas, areas, 0.0)
    if not beside.max() > 0.0:
        return None
    second = normals[np.argmax(beside)] / beside.max()
    axes = np.stack([first, second, np.cross(first, second)])
    order = max(itertools.permutations(range(3)), key=lambda p: sum(abs(axes[p[i], i]) for i in range(3)))
    axes = axes[list(order)]
    axes *= np.where(np.diag(axes) < 0.0, -1.0, 1.0)[:, None]  # right-handed: the trace is more than 1
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    corners = hull.vertices[np.argmax(signs @ axes @ hull.vertices.T, axis=1)]
    edges = 0.25 * signs.T @ corners  # means of four
    lengths = np.linalg.norm(edges, axis=1)
    if not lengths.min() > 0.0:
        return None
    u, _, vt = np.linalg.svd((edges / lengths[:, None]).T)
    rotation, center, half = u @ vt, corners.mean(axis=0), 0.5 * lengths
    # A corner that is inside the box puts another one, of which this is the mean, outside.
    outside = (np.abs((hull.vertices - center) @ rotation) - half).max()
    if outside > BOX * float(np.abs(hull.vertices).max()):
        return None
    return (float(half[0]), float(half[1]), float(half[2])), Placement(rotation, center)


def _outer(points: Array) -> Array:
    """Of many points, those that may be corners of the hull: not inside the hull of a few extreme ones."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 2000:
        return points
    try:
        equations = ConvexHull(points[_extreme(points, _sphere(40))]).equations
    except QhullError:
        return points
    outside = np.empty(len(points), dtype=bool)
    for begin in range(0, len(points), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        outside[part] = (_dots(equations[:, :3], points[part]) + equations[:, 3:]).max(axis=0) > -1e-9
    return np.asarray(points[outside])


def _farthest(points: Array) -> Indices:
    """The one point farthest from the middle in each of 24 000 directions: what that costs is less than 1e-4 of the
    size, and Qhull would take a minute for a million points on a sphere."""
    low, high = points.min(axis=0), points.max(axis=0)
    scaled = (points - 0.5 * (low + high)) / (high - low)
    axis = np.abs(scaled).argmax(axis=1)[:, None]
    along = np.take_along_axis(scaled, axis, 1)
    sides = np.take_along_axis(scaled, (axis + [[1, 2]]) % 3, 1) / np.where(along == 0.0, 1.0, np.abs(along))
    cells = np.minimum((32.0 * (sides + 1.0)).astype(np.int64), 63)
    direction = ((2 * axis[:, 0] + (along[:, 0] > 0.0)) * 64 + cells[:, 0]) * 64 + cells[:, 1]
    order = np.lexsort(((scaled**2).sum(axis=1), direction))
    last = np.append(np.diff(direction[order]) > 0, True)
    return np.sort(order[last])


def _reduced(corners: Array, max_vertices: int) -> Array:
    """At most max_vertices of the corners of a hull: extreme ones, then in rounds those farthest outside."""
    from scipy.spatial import ConvexHull

    if len(corners) > 2000:
        corners = corners[_extreme(corners, _sphere(1000))]
    chosen = _extreme(corners, _sphere(min(20, max_vertices)))
    while len(chosen) < max_vertices:
        equations = ConvexHull(corners[chosen]).equations
        outside = _dots(equations[:, :3], corners) + equations[:, 3:]
        farthest = np.argmax(outside, axis=1)
        distance = outside[np.arange(len(outside)), farthest]
        order = np.argsort(-distance)
        candidates = farthest[order][distance[order] > 1e-12]
        new = np.array(list(dict.fromkeys(candidates.tolist())), dtype=np.int64)
        new = new[~np.isin(new, chosen)][: max(1, (max_vertices - len(chosen) + 3) // 4)]
        if not len(new):
            break
        chosen = np.concatenate([chosen, new])
    return np.asarray(corners[np.sort(chosen)])


def _extreme(points: Array, directions: Array) -> npt.NDArray[np.int64]:
    """Indices of the points that are farthest along the directions, each once."""
    best = np.full(len(directions), -math.inf)
    index = np.zeros(len(directions), dtype=np.int64)
    for begin in range(0, len(points), _CHUNK):
        along = _dots(directions, points[begin : begin + _CHUNK])
        first = along.argmax(axis=1)
        value = along[np.arange(len(directions)), first]
        better = value > best
        index[better], best[better] = first[better] + begin, value[better]
    return np.unique(index)


def _dots(rows: Array, points: Array) -> Array:
    """rows points^T, (n, m); without BLAS, whose threads cost more than they bring for three columns."""
    result = rows[:, :1] * points[:, 0]
    result += rows[:, 1:2] * points[:, 1]
    result += rows[:, 2:] * points[:, 2]
    return np.asarray(result)


def _sphere(count: int) -> Array:
    """Directions spread evenly: points of a spiral on the unit sphere."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _wound(points: Array, hull: object) -> tuple[Array, Triangles]:
    """Vertices that are corners, and triangles that wind outwards."""
    vertices, simplices, equations = hull.vertices, hull.simplices, hull.equations  # type: ignore[attr-defined]
    number = np.full(len(points), -1, dtype=np.int32)
    number[vertices] = np.arange(len(vertices), dtype=np.int32)
    a, b, c = (points[simplices[:, i]] for i in range(3))
    outwards = (np.cross(b - a, c - a) * equations[:, :3]).sum(1)
    triangles = number[simplices]
    triangles[outwards < 0.0] = triangles[outwards < 0.0][:, ::-1]
    # Those without area, of points on a line, go by a neighbour: they pass the edge between them the other way.
    unsure = np.abs(outwards) <= 1e-9 * np.abs(outwards).max()
    while unsure.any():
        left = unsure.sum()
        for t in np.flatnonzero(unsure):
            sure = [n for n in hull.neighbors[t] if not unsure[n]]  # type: ignore[attr-defined]
            if sure:
                (p, q, r), edges = triangles[t], triangles[sure[0]][[[0, 1], [1, 2], [2, 0]]].tolist()
                if [p, q] in edges or [q, r] in edges or [r, p] in edges:
                    triangles[t] = r, q, p
                unsure[t] = False
        if unsure.sum() == left:
            break
    return np.ascontiguousarray(points[vertices]), np.ascontiguousarray(triangles)


def _fail(path: Path, reason: str) -> NoReturn:
    raise InvalidInputError(f"{path}: {reason}")


def _numbers(path: Path, words: list[bytes], what: str) -> Array:
    try:
        return np.array([float(word) for word in words])
    except ValueError as error:
        _fail(path, f"has {what} that is no number: {error}")


# STL


def _read_stl(path: Path) -> Mesh:
    points = _stl_corners(path)
    if len(points) % 3:
        _fail(path, f"has {len(points)} vertices, three a triangle are needed")
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _stl_corners(path: Path) -> Array:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        return _binary_stl(data, count)
    if data[:512].lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        found = re.findall(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        if data.count(b"vertex") != len(found):
            _fail(path, "has a vertex without three numbers")
        return _numbers(path, [word for vertex in found for word in vertex], "a vertex").reshape(-1, 3)
    if count > 0 and len(data) > 84 + 50 * count:  # some writers append notes
        return _binary_stl(data, count)
    expected = f"; its header asks for {84 + 50 * count}" if count >= 0 else ""
    _fail(path, f"is neither ascii nor binary STL, or cut off: it has {len(data)} bytes{expected}")


def _binary_stl(data: bytes, count: int) -> Array:
    record = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.frombuffer(data, record, count, 84)
    return np.asarray(triangles["vertices"], dtype=np.float64).reshape(-1, 3)


# OBJ


def _read_obj(path: Path) -> Mesh:
    points: list[bytes] = []
    corners: list[int] = []
    counts: list[int] = []
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            if line.startswith((b"v ", b"v\t")):
                words = line.split()[1:4]
                if len(words) < 3:
                    _fail(path, f"line {number}: a vertex has {len(words)} coordinates, must have 3")
                points += words
            elif line.startswith((b"f ", b"f\t")):
                words = line.split()[1:]
                counts.append(len(words))
                for word in words:
                    try:
                        index = int(word.split(b"/")[0])
                    except ValueError:
                        _fail(path, f"line {number}: a face has the index {word[:40]!r}, must be a whole number")
                    index = index - 1 if index > 0 else len(points) // 3 + index
                    if not 0 <= index < MAX_BYTES:
                        _fail(path, f"line {number}: a face has the index {word[:40]!r}, a vertex that is not there")
                    corners.append(index)
    vertices = _numbers(path, points, "a vertex").reshape(-1, 3)
    if not corners:
        return Mesh(vertices)
    indices = np.array(corners)
    if indices.max() >= len(vertices):
        _fail(path, f"has a face with a vertex that is not there; there are {len(vertices)}")
    used, places = np.unique(indices, return_inverse=True)
    return Mesh(vertices[used], _fans(places.reshape(-1), np.array(counts)))


def _fans(corners: Indices, counts: Indices) -> Indices:
    """Triangles of polygons: their corners, one polygon after the other, and how many each has."""
    begins = np.cumsum(counts) - counts
    found = [np.zeros((0, 3), dtype=np.int64)]
    for count in np.unique(counts[counts > 2]).tolist():
        polygons = corners[begins[counts == count][:, None] + np.arange(count)]
        i = np.arange(1, count - 1)
        found.append(polygons[:, np.stack([0 * i, i, i + 1], axis=1)].reshape(-1, 3))
    return np.concatenate(found)


# PLY

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


def _read_ply(path: Path) -> Mesh:
    data = path.read_bytes()
    header_end = re.search(rb"end_header[ \t]*\r?\n", data[:65536])
    if not data.startswith(b"ply") or header_end is None:
        _fail(path, "is no PLY file: its header is missing or has no end")
    lines = data[: header_end.start()].decode("ascii", "replace").splitlines()
    words = [line.split() for line in lines[1:] if line.split() and line.split()[0] not in ("comment", "obj_info")]
    encoding = next((word[1] for word in words if word[0] == "format" and len(word) > 1), "")
    elements = [i for i, word in enumerate(words) if word[0] == "element"]
    if not elements or words[elements[0]][1:2] != ["vertex"] or not words[elements[0]][-1].isdigit():
        _fail(path, "does not begin with its vertices")
    last = elements[1] if len(elements) > 1 else len(words)
    properties = [word[1:] for word in words[elements[0] + 1 : last] if word[0] == "property"]
    if any(len(p) != 2 or p[0] not in _PLY_TYPES for p in properties):
        _fail(path, "has a vertex property of a type that is not known")
    names = [p[1] for p in properties]
    if len(set(names)) != len(names) or not {"x", "y", "z"} <= set(names):
        _fail(path, "has vertices without x, y and z, or with one twice")
    count, begin = int(words[elements[0]][-1]), header_end.end()
    faces = [words[i:j] for i, j in zip(elements[1:], [*elements[2:], len(words)], strict=False)][:1]
    if encoding == "ascii":
        body = data[begin:].split(maxsplit=count * len(names)) if count < len(data) else []
        if len(body) < count * len(names):
            _fail(path, f"is cut off: {count} vertices are announced")
        rest = body.pop() if len(body) > count * len(names) else b""
        table = _numbers(path, body, "a vertex").reshape(count, len(names))
        points = np.ascontiguousarray(table[:, [names.index(axis) for axis in "xyz"]])
        return Mesh(points, _ply_triangles(path, faces, rest, "", count))
    if encoding not in ("binary_little_endian", "binary_big_endian"):
        _fail(path, f'has format "{encoding}", must be ascii, binary_little_endian or binary_big_endian')
    order = "<" if encoding == "binary_little_endian" else ">"
    record = np.dtype([(p[1], order + _PLY_TYPES[p[0]]) for p in properties])
    if len(data) - begin < count * record.itemsize:
        _fail(path, f"is cut off: {count} vertices are announced")
    records = np.frombuffer(data, record, count, begin)
    points = np.stack([records[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return Mesh(points, _ply_triangles(path, faces, data[begin + count * record.itemsize :], order, count))


def _ply_triangles(path: Path, elements: list[list[list[str]]], data: bytes, order: str, limit: int) -> Indices | None:
    """Of the element after the vertices, when it is the faces and their corners come first; order "": ascii."""
    if not elements or elements[0][0][1:2] != ["face"] or not elements[0][0][-1].isdigit():
        return None
    properties = [word[1:] for word in elements[0][1:]]
    known = bool(properties) and all(p and p[0] in _PLY_TYPES for p in properties[1:])
    if not known or len(properties[0]) != 4 or properties[0][0] != "list" or "vert" not in properties[0][3]:
        return None
    if not {*properties[0][1:3]} <= {name for name, kind in _PLY_TYPES.items() if kind[0] != "f"}:
        return None
    count = int(elements[0][0][-1])
    if count > len(data):
        _fail(path, f"is cut off: {count} faces are announced")
    corners, counts = (_ply_ascii if not order else _ply_binary)(path, properties, data, order, count)
    if len(corners) and (corners.min() < 0 or corners.max() >= limit):
        _fail(path, f"has a face with a vertex that is not there; there are {limit}")
    return _fans(corners, counts)


def _ply_ascii(path: Path, properties: list[list[str]], data: bytes, _: str, count: int) -> tuple[Indices, Indices]:
    words, place, corners, counts = data.split(), 0, list[bytes](), list[int]()
    for _face in range(count):
        size = int(words[place]) if place < len(words) and words[place].isdigit() else -1
        if not 0 <= size < len(words) - place:
            _fail(path, f"is cut off, or has a face without a number of corners: {count} faces are announced")
        counts.append(size)
        corners += words[place + 1 : place + 1 + size]
        place += size + len(properties)
    try:
        return np.array(corners, dtype=np.int64), np.array(counts, dtype=np.int64)
    except (ValueError, OverflowError):
        _fail(path, "has a face with an index that is no whole number")


def _ply_binary(
    path: Path, properties: list[list[str]], data: bytes, order: str, count: int
) -> tuple[Indices, Indices]:
    size_type, index_type = (order + _PLY_TYPES[name] for name in properties[0][1:3])
    more = [(f"more{i}", order + _PLY_TYPES[p[0]]) for i, p in enumerate(properties[1:])]
    skip = np.dtype(more).itemsize
    width, index = np.dtype(size_type).itemsize, np.dtype(index_type)
    if not count or len(data) < width:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    # Nearly always all have the same number of corners.
    size = int(np.frombuffer(data, size_type, 1)[0])
    if 0 <= size * index.itemsize < len(data):
        record = np.dtype([("size", size_type), ("corners", index_type, (size,)), *more])
        if count * record.itemsize <= len(data):
            records = np.frombuffer(data, record, count)
            if (records["size"] == size).all():
                return records["corners"].astype(np.int64).reshape(-1), np.full(count, size)
    reader, place = struct.Struct(order + np.dtype(size_type).char), 0
    found, counts = [], []
    for _face in range(count):
        size = reader.unpack_from(data, place)[0] if place + width <= len(data) else -1
        if size < 0 or place + width + size * index.itemsize + skip > len(data):
            _fail(path, f"is cut off: {count} faces are announced")
        found.append(data[place + width : place + width + size * index.itemsize])
        counts.append(size)
        place += width + size * index.itemsize + skip
    return np.frombuffer(b"".join(found), index_type).astype(np.int64), np.array(counts)


# Collada


def _read_collada(path: Path) -> Mesh:
    """In metres, placed by the scene's nodes; the up axis is left as the file has it, as in ROS."""
    return _Collada(_xml.parse(path)).mesh()


class _Collada:
    def __init__(self, root: _xml.Element) -> None:
        if _tag(root) != "COLLADA":
            root.fail("is no Collada file: its root must be <COLLADA>")
        self._root = root
        self._by_id: dict[str, _xml.Element] = {}
        self._geometries: list[_xml.Element] = []
        self._scenes: list[_xml.Element] = []
        self._meter = 1.0
        self._cache: dict[int, Mesh] = {}
        self._num_points = self._num_triangles = self._num_nodes = 0
        stack = [root]
        while stack:
            element = stack.pop()
            if "id" in element.attributes:
                self._by_id.setdefault(element.attributes["id"], element)
            if _tag(element) == "geometry":
                self._geometries.append(element)
            elif _tag(element) == "visual_scene":
                self._scenes.append(element)
            elif _tag(element) == "asset" and element.parent is root:
                for unit in _all(element, "unit"):
                    self._meter = unit.number("meter", 1.0, 1e-9, 1e9)
            stack.extend(element.children)

    def mesh(self) -> Mesh:
        if self._scenes:
            found = [piece for scene in self._scenes for piece in self._node(scene, np.eye(4), 0)]
        else:
            found = [self._read(geometry) for geometry in self._geometries]
        if not found:
            return Mesh(np.zeros((0, 3)))
        points = self._meter * np.concatenate([piece.points for piece in found])
        first = np.cumsum([0, *(len(piece.points) for piece in found)])
        known = [piece.triangles + n for piece, n in zip(found, first, strict=False) if piece.triangles is not None]
        return Mesh(points, np.concatenate(known) if len(known) == len(found) else None)

    def _node(self, node: _xml.Element, above: Array, depth: int) -> list[Mesh]:
        self._num_nodes += 1
        if depth > _xml.MAX_DEPTH or self._num_nodes > 100_000:
            node.fail("its nodes contain each other, or are too many")
        placement = above
        found: list[Mesh] = []
        for child in node:
            tag = _tag(child)
            if tag in _TRANSFORMS:
                placement = placement @ _TRANSFORMS[tag](child)
            elif tag == "instance_geometry":
                found.append(self._placed(self._target(child, "url", "geometry"), placement))
            elif tag == "instance_controller":
                for skin in _all(self._target(child, "url", "controller"), "skin"):
                    found.append(self._placed(self._target(skin, "source", "geometry"), placement))
        for child in node:
            if _tag(child) == "node":
                found += self._node(child, placement, depth + 1)
            elif _tag(child) == "instance_node":
                found += self._node(self._target(child, "url", "node"), placement, depth + 1)
        return found

    def _placed(self, geometry: _xml.Element, placement: Array) -> Mesh:
        mesh = self._read(geometry)
        self._num_points += len(mesh.points)
        self._num_triangles += 0 if mesh.triangles is None else len(mesh.triangles)
        if max(self._num_points, self._num_triangles // 2) > MAX_POINTS:
            geometry.fail(f"has more than {MAX_POINTS} vertices when all copies are counted")
        triangles = mesh.triangles
        if triangles is not None and np.linalg.det(placement[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]
        return Mesh(mesh.points @ placement[:3, :3].T + placement[:3, 3], triangles)

    def _target(self, element: _xml.Element, attribute: str, tag: str) -> _xml.Element:
        name = element.string(attribute)
        target = self._by_id.get(name.removeprefix("#"))
        if target is None or _tag(target) != tag:
            element.fail(f'{attribute} is "{name}", there is no such {tag}')
        return target

    def _read(self, geometry: _xml.Element) -> Mesh:
        if id(geometry) not in self._cache:
            self._cache[id(geometry)] = self._read_geometry(geometry)
        return self._cache[id(geometry)]

    def _read_geometry(self, geometry: _xml.Element) -> Mesh:
        found, triangles = [], []
        for mesh in _all(geometry, "mesh"):
            for vertices in _all(mesh, "vertices"):
                for entry in _all(vertices, "input"):
                    if entry.attributes.get("semantic") == "POSITION":
                        found.append(self._source(self._target(entry, "source", "source")))
            triangles += [self._triangles(e, len(found[0]) if found else 0) for e in mesh if _tag(e) in _PRIMITIVES]
        points = np.concatenate(found) if found else np.zeros((0, 3))
        known = [t for t in triangles if t is not None]
        if len(found) != 1 or not known or len(known) < len(triangles):
            return Mesh(points)
        return Mesh(points, np.concatenate(known))

    def _triangles(self, element: _xml.Element, limit: int) -> Indices | None:
        tag, inputs = _tag(element), _all(element, "input")
        offsets = [int(entry.number("offset", 0.0, 0, 1000)) for entry in inputs]
        corner = [n for entry, n in zip(inputs, offsets, strict=True) if entry.attributes.get("semantic") == "VERTEX"]
        if tag not in ("triangles", "polylist", "polygons") or len(corner) != 1:
            return None
        stride = 1 + max(offsets)
        parts = [_integers(p) for p in _all(element, "p")]
        if any(len(p) % stride for p in parts):
            element.fail(f"has a <p> whose length is no multiple of {stride}")
        corners = np.concatenate([p[corner[0] :: stride] for p in parts]) if parts else np.zeros(0, dtype=np.int64)
        if tag == "polylist":
            counts = np.concatenate([_integers(v) for v in _all(element, "vcount")] or [np.zeros(0, dtype=np.int64)])
        elif tag == "polygons":
            counts = np.array([len(p) // stride for p in parts], dtype=np.int64)
        else:
            counts = np.full(len(corners) // 3, 3)
        if (counts < 0).any() or (counts > len(corners)).any() or counts.sum() != len(corners):
            element.fail(f"has {len(corners)} corners, which do not fit its polygons")
        if len(corners) and (corners.min() < 0 or corners.max() >= limit):
            element.fail(f"has a corner that is not there; there are {limit} positions")
        return _fans(corners, counts)

    def _source(self, source: _xml.Element) -> Array:
        arrays = _all(source, "float_array")
        if len(arrays) != 1:
            source.fail("must have one <float_array>")
        try:
            values = np.array(arrays[0].text.split(), dtype=np.float64)
        except ValueError:
            arrays[0].fail("holds something that is no number")
        accessors = [a for technique in _all(source, "technique_common") for a in _all(technique, "accessor")]
        stride = int(accessors[0].number("stride", 1.0, 1, 1000)) if accessors else 3
        offset = int(accessors[0].number("offset", 0.0, 0, 1e9)) if accessors else 0
        count = int(accessors[0].number("count", 0.0, 0, 1e9)) if accessors else len(values) // 3
        if stride < 3 or offset + count * stride > len(values) + stride - 3:
            source.fail(f"has {len(values)} numbers, too few for {count} positions {stride} apart")
        rows = offset + stride * np.arange(count)[:, None] + np.arange(3)
        return np.asarray(values[rows])


def _tag(element: _xml.Element) -> str:
    return element.tag.rpartition(":")[2]


def _all(element: _xml.Element, tag: str) -> list[_xml.Element]:
    return [child for child in element if _tag(child) == tag]


def _values(element: _xml.Element, size: int) -> Array:
    try:
        values = np.array(element.text.split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if len(values) != size or not np.isfinite(values).all():
        element.fail(f"must hold {size} finite numbers")
    return values


def _integers(element: _xml.Element) -> Indices:
    try:
        return np.array(element.text.split(), dtype=np.int64)
    except (ValueError, OverflowError):
        element.fail("holds something that is no whole number")


def _translate(element: _xml.Element) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = _values(element, 3)
    return matrix


def _rotate(element: _xml.Element) -> Array:
    x, y, z, degrees = _values(element, 4)
    length = math.sqrt(x * x + y * y + z * z)
    matrix = np.eye(4)
    if length > 0.0:
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / length
        angle = math.radians(degrees)
        matrix[:3, :3] += math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return matrix


def _scale(element: _xml.Element) -> Array:
    return np.diag([*_values(element, 3), 1.0])


def _matrix(element: _xml.Element) -> Array:
    return _values(element, 16).reshape(4, 4)


def _not_read(element: _xml.Element) -> Array:
    element.fail("this transform is not read")


_TRANSFORMS: dict[str, Callable[[_xml.Element], Array]] = {
    "translate": _translate,
    "rotate": _rotate,
    "scale": _scale,
    "matrix": _matrix,
    "lookat": _not_read,
    "skew": _not_read,
}
_PRIMITIVES = {"triangles", "polylist", "polygons", "trifans", "tristrips"}
_READERS: dict[str, Callable[[Path], Mesh]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".dae": _read_collada,
}
