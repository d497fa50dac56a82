"""SDF -> bodies, joints, geometries, motors and closed loops. What is read, and the rules: docs/robot_files.md.

Where everything is follows from the poses in the file, which are those at q = 0. The links are then hung on each other
along a tree of joints; a joint that is left over closes a loop.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini._visual import Color
from signorini.load import _inertia, urdf
from signorini.load._files import PathLike
from signorini.load._inertia import Inertia
from signorini.load._options import Added, Options
from signorini.load._placement import Placement, from_quaternion, identity
from signorini.load._sdf_frames import Scope
from signorini.load._sdf_parts import NO_SHAPES, Axis, Link, SdfJoint, collision, hang, leaf, straighten
from signorini.load._sdf_reader import WORLD, Reader
from signorini.load._xml import Element

if TYPE_CHECKING:
    from signorini._world import Joint, Shape, WorldBuilder

Array = npt.NDArray[np.float64]

MAX_COLLIDING = 4000  # links of one model that do not collide with each other
HALF_SPAN = 0.05  # [m] from the frame of a revolute joint that closes a loop to the points of its axis that are held
#: Of what closes loops [N/m, N m/rad]. Rigid, rows that are redundant but for a file's rounding would lock what moves.
LOOP_STIFFNESS = 1e10
_PASSED_OVER = "joints that close loops only hold together; not carried over"


@dataclass
class Robot(urdf.Robot):
    """What is in a file, models of a world included. links: what each hangs on comes before it."""

    sdf_links: list[Link] = field(default_factory=list)
    loops: list[SdfJoint] = field(default_factory=list)
    world_gravity: tuple[float, float, float] | None = None

    @property
    def gravity(self) -> tuple[float, float, float] | None:
        """Of a <world>; a <model> alone says nothing about it."""
        return self.world_gravity

    def collide_as_seen(self) -> None:
        """Takes what links look like for what collides, in place of their own collisions."""
        for link in self.sdf_links:
            link.collisions = [collision(element, link) for element in link.element.all("visual")]

    def add(self, builder: WorldBuilder, options: Options) -> Added:
        return _Adder(builder, self, options).add()


def read(path: Path, package_dirs: Iterable[PathLike] = ()) -> Robot:
    """Reads and checks a file and what it includes, without meshes. Raises InvalidInputError: file, line, element,
    attribute, value."""
    reader = Reader(path, package_dirs)
    reader.read()
    links, loops = hang(reader.links, reader.joints)
    straighten(loops, reader.warnings)
    return Robot(
        reader.name,
        path,
        list[urdf.Link](links),
        reader.warnings,
        sdf_links=links,
        loops=loops,
        world_gravity=reader.gravity,
    )


Values = Mapping[Link, Sequence[Any]]  # of the joints of a link: numbers, and the rotation of a ball joint


class _Adder(urdf.Adder):
    def __init__(self, builder: WorldBuilder, robot: Robot, options: Options) -> None:
        super().__init__(builder, robot, options)
        self._links, self._loops = robot.sdf_links, robot.loops
        hung = [link.hung for link in self._links if link.hung is not None]
        self._axes = dict.fromkeys(axis for joint in hung for axis in joint.axes)
        self._based: set[Scope] = set()  # that have a root joint

    def add(self) -> Added:
        inertias = self._inertias()
        self._add_bodies(self._builder, inertias, self._start(inertias))
        for link in self._links:
            name = self._name(link.name)
            self._added.bodies.append(name)
            self._added.models[name] = self._name(link.scope.top.path)
            for number, shape in enumerate(link.collisions):
                self._add_collision(link, shape, number)
            for element in link.element.all("visual"):
                self._add_visual(link, element)
        self._exclude()
        if self._options.motors:
            self._add_motors()
        self._list()
        self._warnings.tell(self._builder)
        return self._added

    # Bodies and joints

    def _anchored(self, link: Link) -> bool:
        """Whether the world holds a link without a joint to another."""
        if link.hung is not None:
            return link.hung.type == "fixed"
        return link.scope.static or self._options.floating_base is False

    def _inertias(self) -> dict[str, Inertia]:
        parts = []
        for link in self._links:
            fixed_to, place = None, identity()
            if link.up is not None and link.hung is not None and link.hung.type == "fixed":
                fixed_to, place = link.up.name, link.up.place.inverse() @ link.place
            parts.append(_inertia.Part(link.name, link.inertia, link.element, fixed_to, place))
        anchored = {link.name for link in self._links if link.up is None and self._anchored(link)}
        return self._possible(parts, anchored)

    def _add_bodies(self, builder: WorldBuilder, inertias: Mapping[str, Inertia], values: Values) -> None:
        """With joints, couplings and loops. values: of joints at the start; none: 0."""
        self._based.clear()
        for link in self._links:
            parent, above = self._above(link.up)
            joints, moved = self._joints_of(link, values.get(link))
            placement, inertia = above @ link.place @ moved, inertias[link.name]
            add = partial(
                builder.add_body,
                self._name(link.name),
                parent=parent,
                position=placement.position.tolist(),
                orientation=placement.rotation,
                joints=joints,
                mass=inertia.mass,
                center=inertia.center.tolist(),
                inertia=inertia.inertia,
            )
            self._call(link.element if link.hung is None else link.hung.element, add)
        for axis in self._axes:
            if axis.coupling is not None and axis.coupling[0] in self._axes:
                driver, multiplier, offset, reference = axis.coupling
                names, factors = (self._name(axis.name), self._name(driver.name)), (offset, multiplier)
                couple = partial(builder.add_coupling, *names, factors, driver_reference=reference, name=names[0])
                self._call(axis.element, couple)
        for joint in self._loops:
            self._call(joint.element, partial(self._close, builder, joint))

    def _above(self, link: Link | None) -> tuple[str, Placement]:
        """A link, or the world, as a body; and the placement of the file's world in it."""
        if link is None:
            return WORLD, self._options.placement
        return self._name(link.name), link.place.inverse()

    def _joints_of(self, link: Link, values: Sequence[Any] | None) -> tuple[list[Joint], Placement]:
        """Joints of a body from its parent outwards, and how they have moved it when they have these values."""
        from signorini._world import Joint

        joint, inward = link.hung, link.place.inverse()
        if joint is None:
            return ([] if self._anchored(link) else [Joint(self._root_joint(link), "free")]), identity()
        anchor = (inward @ joint.place).position
        if joint.type == "ball":
            turn = np.eye(3) if values is None else values[0]
            ball = Joint(self._name(joint.name), "ball", anchor=anchor.tolist())
            return [ball], Placement(turn, anchor - turn @ anchor)
        joints: list[Joint] = []
        moved = identity()  # by the joints that are farther out
        sign = 1.0 if joint.child is link else -1.0
        outwards = _outwards(link)
        for axis, value in zip(outwards[::-1], values or [0.0] * len(outwards), strict=True):
            direction, back = sign * inward.rotation @ axis.direction, moved.inverse()
            joints.append(
                Joint(
                    self._name(axis.name),
                    "prismatic" if axis.kind == "prismatic" else "revolute",
                    axis=(back.rotation @ direction).tolist(),
                    anchor=(back.rotation @ anchor + back.position).tolist(),
                    reference=value,
                    lower=axis.lower,
                    upper=axis.upper,
                    damping=axis.damping,
                    friction=axis.friction,
                    stiffness=axis.stiffness,
                    spring_reference=axis.spring_reference,
                )
            )
            moved = axis.motion(anchor, direction, value) @ moved
        return joints[::-1], moved

    def _root_joint(self, link: Link) -> str:
        first = link.scope not in self._based
        self._based.add(link.scope)
        return self._name(f"{link.scope.path}root_joint" if first else f"{link.name}_root_joint")

    def _add_motors(self) -> None:
        for axis in self._axes:
            if axis.coupling is None and axis.effort > 0.0:
                name = self._name(axis.name)
                self._builder.add_motor(name, name, force_range=(-axis.effort, axis.effort))

    # Loops

    def _close(self, builder: WorldBuilder, joint: SdfJoint) -> None:
        """Ball: a point is held; revolute: two points of the axis, one in a plane; fixed: the frame. The parent's side
        of a joint is where the file's poses have it."""
        (parent, above), (child, inward) = self._above(joint.parent), self._above(joint.child)
        a, b = above @ joint.place, inward @ joint.place
        name = self._name(joint.name)
        if joint.type == "fixed":
            on_a = {"position_a": a.position.tolist(), "orientation_a": a.rotation}
            on_b = {"position_b": b.position.tolist(), "orientation_b": b.rotation}
            builder.add_weld(parent, child, **on_a, **on_b, name=name, stiffness=LOOP_STIFFNESS)
            return
        points = [np.zeros(3)]
        if joint.type != "ball" and not joint.planar:
            along = HALF_SPAN * joint.place.rotation.T @ joint.axes[0].direction
            points = [along, -along]
        for number, point in enumerate(points, 1):
            on = ((at.rotation @ point + at.position).tolist() for at in (a, b))
            own = name if number == 1 else f"{name}_{number}"
            builder.add_connect(parent, child, *on, name=own, stiffness=LOOP_STIFFNESS)

    def _start(self, inertias: Mapping[str, Inertia]) -> Values:
        """Values of joints next to 0 that are within their limits and with which loops are closed."""
        from signorini._world import WorldBuilder

        if not self._loops and all(axis.coupling is None for axis in self._axes):
            return {}
        trial = WorldBuilder()
        self._add_bodies(trial, inertias, {})
        try:
            world = trial.build()
        except InvalidInputError as error:
            raise InvalidInputError(f"{self._robot.file}: {error}") from None
        try:
            q = world.closed_configuration()
        except InvalidInputError as error:
            self._warnings.add(f"loops are open at the start: {error}")
            return {}
        values: dict[Link, Sequence[Any]] = {}
        for link in self._links:
            if link.hung is not None and link.hung.type == "ball":
                values[link] = [from_quaternion(q[world.q_slice(self._name(link.hung.name))])]
            elif link.hung is not None:
                inwards = _outwards(link)[::-1]
                values[link] = [float(q[world.q_slice(self._name(axis.name))][0]) for axis in inwards]
        return values

    def _list(self) -> None:
        """What joints in loops lose, and frictions that mix otherwise."""
        for joint in self._loops:
            lost = [what for axis in joint.axes for what in axis.does if what != "effort"]
            if lost:
                self._warnings.add(_PASSED_OVER, f"{joint.name} ({', '.join(lost)})")
        for axis in self._axes:
            if axis.coupling is not None and axis.coupling[0] not in self._axes:
                self._warnings.add(_PASSED_OVER, f"{axis.name} (mimic)")
        elements = [element for link in self._links for element in link.element.all("collision")]
        frictions = sorted({float(f"{_friction(element):.6g}") for element in elements})
        if len(frictions) > 1 and self._options.material is None:
            reason = "a contact's friction is sqrt(a b) here, min(a, b) in Gazebo; the collisions have"
            self._warnings.add(reason, *(f"{friction:g}" for friction in frictions))

    # Shapes

    def _surface(self, link: urdf.Link, collision: urdf.Collision) -> dict[str, Any]:
        from signorini._world import Material

        element = _owner(collision)
        result = super()._surface(link, collision)
        if result["material"] is None:
            bounce = leaf(leaf(element, "surface"), "bounce").number("restitution_coefficient", 0.0, 0.0, 1.0)
            result["material"] = Material(friction=_friction(element), restitution=bounce)
        contact = leaf(leaf(element, "surface"), "contact")
        mask = int(contact.number("collide_bitmask", 65535.0, 0.0, 65535.0))
        group = int(contact.number("category_bitmask", float(mask), 0.0, 65535.0))
        return {**result, "group": group, "mask": mask}

    def _shape(self, collision: urdf.Collision) -> Shape:
        from signorini import _world

        element = collision.geometry
        if element.tag == "plane":
            return _world.HalfSpace()
        if element.tag == "ellipsoid":
            radii = element.vector("radii", 3, None, urdf.MAX_POSITION)
            if (radii <= 0.0).any():
                element.fail(f'radii is "{element.string("radii")}", must be positive')
            return _world.Ellipsoid((float(radii[0]), float(radii[1]), float(radii[2])))
        return super()._shape(collision)

    def _add_collision(self, link: urdf.Link, collision: urdf.Collision, number: int) -> None:
        if collision.geometry.tag not in NO_SHAPES:
            super()._add_collision(link, collision, number)
        elif collision.geometry.tag != "empty":
            self._warnings.add(f"collisions with <{collision.geometry.tag}> do not collide", link.name)

    def _add_visual(self, link: urdf.Link, element: Element) -> None:
        assert isinstance(link, Link)
        try:
            visual = collision(element, link)
            if visual.geometry.tag in (*NO_SHAPES, "plane"):
                return
            color, shape = _color(element), self._visual_shape(visual)
        except InvalidInputError as error:
            self._warnings.add("visuals that cannot be drawn", f"{link.name} ({str(error).splitlines()[0]})")
            return
        place = visual.placement
        body = self._name(link.name)
        self._builder.add_visual(body, shape, position=place.position, orientation=place.rotation, color=color)

    def _exclude(self) -> None:
        """Links of one model touch when one of them asks for it; links that a joint connects never do."""
        quiet: dict[Scope, list[Link]] = {}
        for link in self._links:
            if link.collisions and not link.self_collide and not link.scope.static:
                quiet.setdefault(link.scope, []).append(link)
        for scope, links in quiet.items():
            if len(links) > MAX_COLLIDING:
                many = f"has {len(links)} links that collide, at most {MAX_COLLIDING} are read without self_collide"
                scope.element.fail(many)
            for i, link in enumerate(links):
                for other in links[:i]:
                    self._builder.exclude(self._name(other.name), self._name(link.name))
        for joint in self._loops:
            if joint.parent is not None:
                self._builder.exclude(self._name(joint.parent.name), self._name(joint.child.name))


def _outwards(link: Link) -> list[Axis]:
    """The axes that a link turns about, its parent's first: the other way round when it is its joint's parent."""
    if link.hung is None:
        return []
    return link.hung.axes if link.hung.child is link else link.hung.axes[::-1]


def _owner(collision: urdf.Collision) -> Element:
    geometry = collision.geometry.parent
    assert geometry is not None
    assert geometry.parent is not None
    return geometry.parent


def _friction(collision: Element) -> float:
    ode = leaf(leaf(leaf(collision, "surface"), "friction"), "ode")
    return ode.number("mu", 1.0, 0.0, 1e6)


def _color(visual: Element) -> Color | None:
    material = leaf(visual, "material")
    tag = next((tag for tag in ("diffuse", "ambient") if tag in material.attributes), None)
    if tag is None:
        return None
    size = 3 if len(material.string(tag).split()) == 3 else 4
    r, g, b, a = np.clip([*material.vector(tag, size, None, 1e6), 1.0][:4], 0.0, 1.0)
    return float(r), float(g), float(b), float(a) * (1.0 - leaf(visual, "transparency").number("text", 0.0, 0.0, 1.0))
