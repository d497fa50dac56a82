"""What an SDF file consists of: links, joints and their axes; and the tree that links hang in."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from signorini.load import _sdf_frames, urdf
from signorini.load._options import Warnings
from signorini.load._placement import Placement, about, basis, identity
from signorini.load._sdf_frames import Scope
from signorini.load._xml import Element

Array = npt.NDArray[np.float64]

#: By type of joint, which elements say what its axes are.
AXES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("revolute", "continuous", "prismatic", "screw"), ("axis",)),
    **dict.fromkeys(("universal", "revolute2"), ("axis", "axis2")),
    **dict.fromkeys(("fixed", "ball"), ()),
}
PARALLEL = 1e-3  # [rad] by which axes of a loop in a plane may differ
CLOSING = ("revolute", "continuous", "ball", "fixed")
SHAPES = ("box", "sphere", "cylinder", "capsule", "ellipsoid", "plane", "mesh")
NO_SHAPES = ("empty", "heightmap", "polyline", "image", "cone")


@dataclass(eq=False)
class Axis:
    """One value of a joint; direction: in the world of the file at q = 0, unit. Units as urdf.UrdfJoint; effort
    infinite: no limit. coupling: driver, multiplier, offset, reference of the driver."""

    name: str
    kind: str  # revolute, prismatic
    direction: Array
    element: Element
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    spring_reference: float = 0.0
    coupling: tuple[Axis, float, float, float] | None = None

    def motion(self, anchor: Array, direction: Array, value: float) -> Placement:
        """Of a link, its own frame; anchor and direction in it."""
        if self.kind == "prismatic":
            return Placement(np.eye(3), value * direction)
        return about(anchor, direction, value)

    @property
    def does(self) -> list[str]:
        """What it does beside letting links move."""
        found = [key for key in ("damping", "friction", "stiffness") if getattr(self, key)]
        found += ["limits"] if self.lower > -math.inf or self.upper < math.inf else []
        found += ["effort"] if 0.0 < self.effort < math.inf else []
        return found + (["mimic"] if self.coupling is not None else [])


@dataclass(eq=False)
class Link(urdf.Link):
    """place: in the world of the file. hung: the joint that carries it in the tree, on `up` (None: the world).
    depth: how many joints carry it."""

    scope: Scope = field(kw_only=True)
    self_collide: bool = False
    place: Placement = field(default_factory=identity)
    hung: SdfJoint | None = None
    up: Link | None = None
    depth: int = 0


@dataclass(eq=False)
class SdfJoint:
    """place: of the joint's frame in the world of the file. parent None: the world. cut: the file wants a loop cut."""

    name: str
    type: str
    parent: Link | None
    child: Link
    place: Placement
    element: Element
    axes: list[Axis] = field(default_factory=list)
    cut: bool = False
    planar: bool = False  # it closes a loop in a plane

    @property
    def rank(self) -> int:
        """Joints of low rank make the tree, those of high rank close loops: what a constraint cannot do comes first."""
        if self.type not in CLOSING or self.type == "fixed":
            return 0
        if self.cut:
            return 4
        if self.type == "ball":
            return 3
        return 1 if self.axes[0].does else 2


def hang(links: Sequence[Link], joints: Sequence[SdfJoint]) -> tuple[list[Link], list[SdfJoint]]:
    """Hangs links on each other. Returns them with what each hangs on before it, and the joints that close loops.

    The tree grows from what is fixed to the world, then from links that are nobody's child, then from what is left, in
    the file's order. The next joint in it is that of lowest rank, then the one nearest to where the tree began.
    """
    at: dict[Link | None, list[tuple[int, SdfJoint]]] = {None: [], **{link: [] for link in links}}
    for number, joint in enumerate(joints):
        at[joint.parent].append((number, joint))
        at[joint.child].append((number, joint))
    below: dict[Link, list[tuple[int, Link]]] = {link: [] for link in links}
    number_of = {link: number for number, link in enumerate(links)}
    roots: list[tuple[int, Link]] = []
    reached: set[Link | None] = set()
    used: set[SdfJoint] = set()
    heap: list[tuple[int, int, int, SdfJoint, Link | None, Link]] = []

    def reach(link: Link | None, depth: int) -> None:
        reached.add(link)
        for number, joint in at[link]:
            other = joint.child if joint.parent is link else joint.parent
            if other is not None and other not in reached:
                heapq.heappush(heap, (joint.rank, depth + 1, number, joint, link, other))

    def grow() -> None:
        while heap:
            _, depth, number, joint, up, link = heapq.heappop(heap)
            if link not in reached:
                used.add(joint)
                link.hung, link.up, link.depth = joint, up, depth
                if up is None:
                    roots.append((number_of[link], link))
                else:
                    below[up].append((number, link))
                reach(link, depth)

    fixed = [link for link in links if link.scope.static]
    roots += [(number_of[link], link) for link in fixed]
    for link in (None, *fixed):
        reach(link, 0)
    grow()
    children = {joint.child for joint in joints}
    for link in (*(link for link in links if link not in children), *links):
        if link not in reached:
            roots.append((number_of[link], link))
            reach(link, 0)
            grow()
    ordered: list[Link] = []
    stack = sorted(roots, key=lambda entry: -entry[0])
    while stack:
        link = stack.pop()[1]
        ordered.append(link)
        stack.extend(sorted(below[link], key=lambda entry: -entry[0]))
    head: dict[Link | None, Link | None] = {None: None}  # what a link is fixed to, the last of them
    for link in ordered:
        at_rest = link.scope.static or (link.hung is not None and link.hung.type == "fixed")
        head[link] = head[link.up] if at_rest else link
    # What joins links that cannot move against each other holds anyway: all joints do at q = 0.
    loops = [joint for joint in joints if joint not in used and head[joint.parent] is not head[joint.child]]
    for joint in loops:
        if joint.type not in CLOSING:
            joint.element.fail(f"a {joint.type} joint cannot close a loop; {', '.join(CLOSING)} can")
    return ordered, loops


def straighten(loops: Sequence[SdfJoint], warnings: Warnings) -> None:
    """Makes the axes of loops in a plane parallel. In files they are so to a few digits, and without it they could not
    move: a loop needs seven freedoms, or axes that are parallel (or meet in one point)."""
    groups: list[list[Axis]] = []
    for joint in loops:
        axes = _in_plane(_cycle(joint))
        if axes:
            joint.planar = True
            own = set(axes)
            shared = [group for group in groups if own.intersection(group)]
            groups = [group for group in groups if group not in shared]
            groups.append(list(dict.fromkeys(axis for group in [*shared, axes] for axis in group)))
    for group in groups:
        turning = [axis.direction for axis in group if axis.kind == "revolute"]
        normal = np.sum([direction * np.sign(direction @ turning[0]) for direction in turning], axis=0)
        normal /= np.linalg.norm(normal)
        for axis in group:
            along = normal * (normal @ axis.direction)
            straight = along if axis.kind == "revolute" else axis.direction - along
            straight = straight / np.linalg.norm(straight)
            if np.linalg.norm(axis.direction - straight) > 1e-9:
                warnings.add(f"axes of loops in a plane are made parallel (within {PARALLEL:g} rad)", axis.name)
            axis.direction = straight


def _cycle(joint: SdfJoint) -> list[SdfJoint]:
    """The joints of a loop; none when it has seven freedoms."""
    found = [joint]
    a, b = (None if end is None or end.scope.static else end for end in (joint.parent, joint.child))
    while a is not b and sum(_freedoms(joint) for joint in found) < 7 and len(found) < 1000:
        if b is None or (a is not None and a.depth >= b.depth):
            a, b = b, a
        assert b is not None  # the deeper one
        assert b.hung is not None
        found.append(b.hung)
        b = None if b.up is None or b.up.scope.static else b.up
    return found if a is b and sum(_freedoms(joint) for joint in found) < 7 else []


def _freedoms(joint: SdfJoint) -> int:
    return {"ball": 3, "screw": 1}.get(joint.type, len(joint.axes))


def _in_plane(cycle: Sequence[SdfJoint]) -> list[Axis]:
    """The axes of a loop when those that links turn about are as good as parallel, and slides are across; else none."""
    axes = [axis for joint in cycle for axis in joint.axes]
    turning = [axis.direction for axis in axes if axis.kind == "revolute"]
    if len(axes) < 3 or not turning:
        return []
    off = [
        np.linalg.norm(np.cross(axis.direction, turning[0])) if axis.kind == "revolute" else axis.direction @ turning[0]
        for axis in axes
    ]
    return axes if np.abs(off).max() < PARALLEL else []


def collision(element: Element, link: Link) -> urdf.Collision:
    """Of a <collision> or <visual>: its shape as URDF writes it, and where it is in its link."""
    geometry = element.need("geometry")
    shapes = [child for child in geometry if not child.tag.startswith("experimental:")]
    if len(shapes) != 1:
        geometry.fail(f"has {len(shapes)} shapes, must have one")
    shape = shapes[0].flattened()
    if shape.tag not in (*SHAPES, *NO_SHAPES):
        shape.fail(f"is no shape; there are {', '.join(SHAPES)}")
    if shape.tag == "mesh":
        shape.attributes["filename"] = shape.string("uri")
    placement, relative_to = _sdf_frames.pose(element, "")
    if relative_to:
        frame = link.scope.find(relative_to, element.need("pose"), "relative_to")
        placement = link.place.inverse() @ _sdf_frames.place(frame) @ placement
    if shape.tag == "plane":
        normal = shape.vector("normal", 3, (0.0, 0.0, 1.0), 1e6)
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            shape.fail(f'normal is "{shape.string("normal")}", must not be 0')
        placement = placement @ Placement(np.stack([*basis(normal), normal / length], axis=1), np.zeros(3))
    return urdf.Collision(element.attributes.get("name", ""), placement, shape)


def leaf(element: Element, tag: str) -> Element:
    """A child, flattened; without one an element with nothing in it."""
    child = element.find(tag)
    return Element(tag, {}, element.line, element.file, element) if child is None else child.flattened()


def text(element: Element, tag: str) -> str:
    return element.need(tag).flattened().string("text").strip()


def flag(element: Element, tag: str, default: bool = False) -> bool:
    return leaf(element, tag).flag("text", default)


def leaves(element: Element | None) -> Iterator[str]:
    """All elements without children in an element, by their path."""
    for child in () if element is None else element:
        if child.children:
            yield from (f"{child.tag}/{inner}" for inner in leaves(child))
        else:
            yield child.tag
