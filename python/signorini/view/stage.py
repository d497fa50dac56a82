"""A world in the three-dimensional scene of a viser server: bodies, ground, contact points, forces, friction cones."""

from __future__ import annotations

import contextlib
import io
import itertools
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini.view.looks import Looks, Mesh

if TYPE_CHECKING:
    from signorini.recording import Contacts

Array = npt.NDArray[np.float64]

_MANY_TRIANGLES = 1_000_000  # of one mesh in all its places; a page thins them out
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)
_CREASE = np.cos(np.radians(35.0))  # edges sharper than this are seen as edges
_STICK, _SLIDE, _OPEN = (41, 98, 176), (232, 119, 34), (150, 150, 150)
_FORCE, _CONE, _HULL = (200, 30, 45), (240, 190, 40), (190, 60, 190)
_GRID, _WALL = (176, 182, 190), (150, 160, 172)


def new_server(host: str, port: int) -> Any:
    """A viser server without its greeting. Raises ImportError where viser is missing, OSError where the port is taken
    or the host is no address of this machine.

    port: 0 takes a free one.
    """
    try:
        import viser
    except ImportError as error:
        raise ImportError(f"the page needs viser: pip install 'signorini[view]' ({error})") from None
    try:  # viser takes the next port where this one is taken, and waits for ever where the address is none of ours
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        raise OSError(f"port {port} of {host}: cannot listen there ({error.strerror or error})") from None
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    server.scene.world_axes.visible = False
    return server


def stop_server(server: Any) -> None:
    with contextlib.redirect_stdout(io.StringIO()):  # no farewell either
        server.stop()


@dataclass(frozen=True)
class Extent:
    """Where the action is. center [m]; size: largest extent, or three quarters of the diagonal [m]."""

    center: Array
    size: float

    @classmethod
    def of(cls, looks: Looks, configurations: Iterable[npt.ArrayLike]) -> Extent:
        """Of what moves over some configurations, and of what stands by and is no larger than that."""
        moves = moving_bodies(looks)
        parts = ~looks.collision & ~looks.flat
        body, radius = looks.body[parts], np.linalg.norm(looks.scale[parts], axis=1)
        center = looks.center[parts]
        boxes, fixed = [], []
        for q in configurations:
            position, rotation = looks.placements(q)
            place = position[body] + np.einsum("nij,nj->ni", rotation[body], center)
            moved = moves[body]
            boxes.append(np.concatenate([place[moved] - radius[moved, None], place[moved] + radius[moved, None]]))
            fixed = [(p, r) for p, r in zip(place[~moved], radius[~moved], strict=True)]
        points = np.concatenate(boxes) if boxes else np.zeros((0, 3))
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) == 0:
            points = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
        low, high = np.percentile(points, [1.0, 99.0], axis=0)  # a ball that rolls far away is left out
        size = float((high - low).max())
        for place_of, radius_of in fixed:
            if radius_of < size and (np.abs(place_of - 0.5 * (low + high)) < 1.5 * size).all():
                low, high = np.minimum(low, place_of - radius_of), np.maximum(high, place_of + radius_of)
        size = max(float((high - low).max()), 0.75 * float(np.linalg.norm(high - low)))
        return cls(0.5 * (low + high), max(1e-3, size))


def moving_bodies(looks: Looks) -> npt.NDArray[np.bool_]:
    moves = np.zeros(len(looks.bodies), dtype=bool)
    for i, body in enumerate(looks.bodies):
        moves[i] = i > 0 and (bool(body["joints"]) or moves[body["parent"]])
    return moves


class _Group:
    """All parts of one mesh, drawn in one go."""

    def __init__(self, server: Any, name: str, looks: Looks, parts: npt.NDArray[np.intp], hull: bool) -> None:
        self.body = looks.body[parts]
        self.center = looks.center[parts]
        self.moves = bool(moving_bodies(looks)[self.body].any())
        scale = looks.scale[parts]
        self.one_size = bool(np.ptp(scale, axis=0).max() <= 1e-6 * scale.max())
        mesh = looks.meshes[looks.mesh[parts[0]]]
        vertices, triangles = creased(mesh, scale[0])
        color = np.rint(255.0 * looks.color[parts, :3]).astype(np.uint8)
        opacity = looks.color[parts, 3].astype(np.float32)
        self.handle = server.scene.add_batched_meshes_simple(
            name,
            vertices=vertices * scale[0] * (1.002 if hull else 1.0) if self.one_size else vertices,
            faces=triangles,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(parts), 1)),
            batched_positions=self.center,
            batched_scales=None if self.one_size else scale.astype(np.float32) * np.float32(1.002 if hull else 1.0),
            batched_colors=_HULL if hull else color,
            batched_opacities=None if hull or (opacity >= 1.0).all() else opacity,
            opacity=0.35 if hull else None,
            lod=((1e-3, 0.2),) if len(parts) * len(triangles) > _MANY_TRIANGLES else "off",
            side="double" if not hull and not _closed(mesh) else "front",
            cast_shadow=not hull,
            receive_shadow=not hull,
            visible=not hull,
        )

    def place(self, position: Array, rotation: Array, wxyz: Array) -> None:
        turned = np.einsum("nij,nj->ni", rotation[self.body], self.center)
        self.handle.batched_positions = (position[self.body] + turned).astype(np.float32)
        self.handle.batched_wxyzs = wxyz[self.body].astype(np.float32)


class Stage:
    """Puts states on a page. What is shown: contacts, forces, cones, hulls (what collides), force_scale (a factor)."""

    def __init__(
        self, server: Any, looks: Looks, extent: Extent, typical_force: float, *, shadows: bool = True
    ) -> None:
        """typical_force: drawn as long as a fifth of the extent [N]. shadows: slow without a graphics card."""
        self.looks, self.extent = looks, extent
        self.contacts = self.forces = True
        self.cones = self.hulls = False
        self.force_scale = 1.0
        self.shadows = shadows
        self._server = server
        self._length = 0.2 * extent.size / typical_force if typical_force > 0.0 else 0.0
        self._body_of_geometry = np.array([g["body"] for g in looks.geometries], dtype=np.int64)
        self._light_and_ground()
        self._bodies = self._groups(hull=False)
        self._hulls: list[_Group] = []  # made when somebody asks
        self._contact_layers()

    def _light_and_ground(self) -> None:
        scene, size = self._server.scene, self.extent.size
        scene.set_up_direction("+z")
        scene.configure_environment_map(None)  # it takes long without a graphics card
        scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(150, 150, 155), intensity=2.2)
        self.set_shadows(self.shadows)
        self.aim()
        cell = 10.0 ** np.floor(np.log10(0.5 * size))
        position, rotation = self.looks.placements(self.looks.reference_q)
        for number in np.flatnonzero(self.looks.flat & ~self.looks.collision):
            body = self.looks.body[number]
            mesh = self.looks.meshes[self.looks.mesh[number]]
            corners = mesh.vertices * self.looks.scale[number] + self.looks.center[number]
            corners = corners @ rotation[body].T + position[body]
            a, b, c = corners[mesh.triangles[0]]
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            if normal[2] > 0.999:
                scene.add_grid(
                    f"/ground/{number}",
                    position=(*np.round(self.extent.center[:2] / (10.0 * cell)) * 10.0 * cell, float(a[2])),
                    infinite_grid=True, cell_size=cell, section_size=10.0 * cell, fade_distance=15.0 * size,
                    fade_strength=1.5, cell_color=_GRID, section_color=_GRID, cell_thickness=0.7,
                    section_thickness=1.2, plane_color=(236, 239, 243), plane_opacity=1.0, shadow_opacity=0.35,
                )  # fmt: skip
            else:
                self._wall(f"/ground/{number}", a, normal)

    def aim(self, aside: float = 0.0) -> None:
        """Where a page looks from at first; aside: how far the middle of things is left of the page's, in extents."""
        center, size, camera = self.extent.center, self.extent.size, self._server.initial_camera
        back = np.array([1.25, -1.5, 0.7])
        right = np.array([-back[1], back[0], 0.0]) / np.hypot(back[0], back[1])
        camera.look_at = tuple(center + aside * size * right)
        camera.position = tuple(center + aside * size * right + size * back)
        camera.fov = np.radians(40.0)
        camera.near, camera.far = max(1e-3, 0.01 * size), 200.0 * size

    def set_shadows(self, shadows: bool) -> None:
        self.shadows = shadows
        self._server.scene.configure_default_lights(True, cast_shadow=shadows)

    def _wall(self, name: str, point: Array, normal: Array) -> None:
        """A piece of a half space that is no floor, beside what moves; seen from its free side only."""
        middle = self.extent.center - normal * float((self.extent.center - point) @ normal)
        first = np.cross(normal, [0.0, 0.0, 1.0])
        first = first / np.linalg.norm(first) if np.linalg.norm(first) > 1e-3 else np.array([1.0, 0.0, 0.0])
        second = np.cross(normal, first)
        half = 0.6 * self.extent.size
        corners = [middle + half * (x * first + y * second) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        self._server.scene.add_mesh_simple(
            name, np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]), color=_WALL, opacity=0.35, cast_shadow=False,
        )  # fmt: skip

    def _groups(self, *, hull: bool) -> list[_Group]:
        looks = self.looks
        wanted = np.flatnonzero((looks.collision == hull) & ~looks.flat)
        order = wanted[np.argsort(looks.mesh[wanted], kind="stable")]
        folder = "/collision" if hull else "/bodies"
        groups = [
            _Group(self._server, f"{folder}/{mesh}", looks, np.array(list(parts)), hull)
            for mesh, parts in itertools.groupby(order, key=lambda part: int(looks.mesh[part]))
        ]
        placed = self._placed(looks.reference_q)
        for group in groups:  # those that never move stay where they are put now
            group.place(*placed)
        return groups

    def _contact_layers(self) -> None:
        scene, size = self._server.scene, self.extent.size
        vertices, triangles = _ball()
        one = {"batched_wxyzs": np.array([[1.0, 0, 0, 0]]), "batched_positions": np.zeros((1, 3))}
        self._points = scene.add_batched_meshes_simple(
            "/contacts/points", vertices * 0.008 * size, triangles, **one, batched_colors=np.array([_STICK]),
            lod="off", cast_shadow=False, receive_shadow=False, visible=False,
        )  # fmt: skip
        vertices, triangles = _open_cone()
        self._cones = scene.add_batched_meshes_simple(
            "/contacts/cones", vertices * 0.1 * size, triangles, **one, batched_scales=np.ones((1, 3), np.float32),
            batched_colors=_CONE, opacity=0.35, side="double", lod="off", cast_shadow=False, receive_shadow=False,
            visible=False,
        )  # fmt: skip
        self._arrows = scene.add_arrows(
            "/contacts/forces", np.zeros((1, 2, 3)), _FORCE, shaft_radius=0.004 * size, head_radius=0.01 * size,
            head_length=0.025 * size, visible=False,
        )  # fmt: skip

    def show(self, q: npt.ArrayLike, contacts: Contacts) -> None:
        """Draws a configuration and its contact points."""
        placed = self._placed(q)
        if self.hulls and not self._hulls:
            self._hulls = self._groups(hull=True)
        with self._server.atomic():
            for group in self._bodies + (self._hulls if self.hulls else []):
                if group.moves:
                    group.place(*placed)
            for group in self._hulls:
                _set(group.handle, "visible", self.hulls)
            self._show_contacts(contacts)

    def _placed(self, q: npt.ArrayLike) -> tuple[Array, Array, Array]:
        from scipy.spatial.transform import Rotation

        position, rotation = self.looks.placements(q)
        return position, rotation, np.roll(Rotation.from_matrix(rotation).as_quat(), 1, axis=1)

    def _show_contacts(self, contacts: Contacts) -> None:
        # Drawn as what the world does to the body; between two bodies, as what a does to b.
        turned = self._body_of_geometry[contacts.geometries[:, 1]] == 0
        sign = np.where(turned, -1.0, 1.0)[:, None]
        force, normal = sign * contacts.force, sign * contacts.normal
        along = np.einsum("ni,ni->n", force, normal)
        across = np.linalg.norm(force - along[:, None] * normal, axis=1)
        presses = along > 1e-9 * max(1e-30, float(np.abs(along).max(initial=0.0)))
        slides = presses & (across >= (1.0 - 1e-3) * contacts.friction * along)

        _set(self._points, "visible", self.contacts and len(contacts) > 0)
        if self._points.visible:
            color = np.full((len(contacts), 3), _OPEN, dtype=np.uint8)
            color[presses], color[slides] = _STICK, _SLIDE
            self._points.batched_positions = contacts.position
            self._points.batched_wxyzs = np.tile(_UPRIGHT, (len(contacts), 1))
            self._points.batched_colors = color
        _set(self._arrows, "visible", self.forces and bool(presses.any()))
        if self._arrows.visible:
            start = contacts.position[presses]
            end = start + self._length * self.force_scale * force[presses]
            self._arrows.points = np.stack([start, end], axis=1).astype(np.float32)
        _set(self._cones, "visible", self.cones and bool(presses.any()))
        if self._cones.visible:
            mu = contacts.friction[presses]
            self._cones.batched_positions = contacts.position[presses]
            self._cones.batched_wxyzs = _from_z(normal[presses])
            self._cones.batched_scales = np.stack([mu, mu, np.ones_like(mu)], axis=1).astype(np.float32)


def _set(handle: Any, field: str, value: Any) -> None:
    if getattr(handle, field) != value:
        setattr(handle, field, value)


def _from_z(axis: Array) -> npt.NDArray[np.float32]:
    """Quaternions (n, 4), w first, that turn z to unit vectors (n, 3)."""
    w = 1.0 + axis[:, 2]
    result = np.stack([w, -axis[:, 1], axis[:, 0], np.zeros_like(w)], axis=1)
    result[w < 1e-6] = [0.0, 1.0, 0.0, 0.0]
    quaternion: npt.NDArray[np.float32] = (result / np.linalg.norm(result, axis=1, keepdims=True)).astype(np.float32)
    return quaternion


# Meshes


def creased(mesh: Mesh, scale: Array) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """The mesh with its vertices doubled along sharp edges: a page interpolates normals between triangles that share a
    vertex, which makes balls round, and boxes too."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = (mesh.vertices * scale)[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    count = len(mesh.triangles)
    # Each half edge (triangle, k) runs from corner k to corner k + 1; its ends in order of vertices.
    start, end = mesh.triangles, np.roll(mesh.triangles, -1, axis=1)
    number = np.arange(3 * count).reshape(count, 3)
    after = np.roll(number, -1, axis=1)
    swap = start > end
    key = np.where(swap, end, start).astype(np.int64) * len(mesh.vertices) + np.where(swap, start, end)
    low, high = np.where(swap, after, number).ravel(), np.where(swap, number, after).ravel()
    order = np.argsort(key.ravel(), kind="stable")
    here, there = order[:-1], order[1:]
    shared = key.ravel()[here] == key.ravel()[there]
    here, there = here[shared], there[shared]
    flat = np.einsum("ni,ni->n", normal[here // 3], normal[there // 3]) > _CREASE
    here, there = here[flat], there[flat]
    rows, columns = np.concatenate([low[here], high[here]]), np.concatenate([low[there], high[there]])
    links = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(3 * count, 3 * count))
    number_of, label = connected_components(links, directed=False)
    vertices = np.zeros((number_of, 3), dtype=np.float32)
    vertices[label] = mesh.vertices[mesh.triangles.ravel()]
    return vertices, label.reshape(count, 3).astype(np.int32)


def _closed(mesh: Mesh) -> bool:
    """Whether every edge has two triangles; of others, the back is seen too."""
    edges = np.sort(np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]))
    _, times = np.unique(edges, axis=0, return_counts=True)
    return bool((times == 2).all())


def _ball() -> tuple[Array, npt.NDArray[np.int32]]:
    from signorini.view.drawables import _half_circle, _turned

    return _turned(_half_circle(1.0, 0.0, count=5), count=12)


def _open_cone(count: int = 32) -> tuple[Array, npt.NDArray[np.int32]]:
    """Tip at the origin, opening along z to radius 1 at z = 1."""
    angles = np.arange(count) * (2.0 * np.pi / count)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(count)])
    i = np.arange(count)
    return np.concatenate([[[0.0, 0.0, 0.0]], rim]), np.column_stack([np.zeros(count), 1 + i, 1 + (i + 1) % count])
