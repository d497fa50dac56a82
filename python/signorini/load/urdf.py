"""URDF -> bodies, joints, geometries and motors. What is read, and the rules: docs/robot_files.md."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini._visual import Color, MeshFile
from signorini.load import _inertia, _xml, mesh
from signorini.load._files import FileFinder
from signorini.load._inertia import Inertia
from signorini.load._options import Added, Options, Warnings
from signorini.load._placement import Placement, basis, from_roll_pitch_yaw, identity
from signorini.load._xml import Element

if TYPE_CHECKING:
    from signorini._world import Joint, Shape, WorldBuilder

Array = npt.NDArray[np.float64]
Result = TypeVar("Result")

WORLD = "world"
MAX_POSITION = 1e6  # [m]
MAX_MASS = 1e12  # [kg]
MAX_INERTIA = 1e18  # [kg m^2]
ONE_VALUE = ("revolute", "continuous", "prismatic")
JOINT_TYPES = (*ONE_VALUE, "fixed", "floating", "planar")
_LINK_CHILDREN = {"inertial", "collision", "visual"}
_JOINT_CHILDREN = {"origin", "parent", "child", "axis", "limit", "dynamics", "mimic"}
_NO_PHYSICS = {"material", "verbose", "safety_controller", "calibration", "sensor", "group", "joint_properties"}
_MISPLACED = {
    *("link", "joint", "inertial", "mass", "inertia", "collision", "geometry", "parent", "child", "axis", "limit"),
}
_GAZEBO_PHYSICS = {
    *("mu", "mu1", "mu2", "kp", "kd", "maxVel", "minDepth", "selfCollide", "gravity", "turnGravityOff"),
    *("implicitSpringDamper", "springStiffness", "springReference", "stopKp", "stopKd", "stopCfm", "stopErp"),
    *("fudgeFactor", "cfmDamping", "dampingFactor"),
}


@dataclass
class Collision:
    """A shape in a link: geometry is its <box>, <sphere>, <cylinder>, <capsule> or <mesh>."""

    name: str
    placement: Placement
    geometry: Element


@dataclass(eq=False)
class Link:
    name: str
    element: Element
    inertia: Inertia
    collisions: list[Collision]
    joint: UrdfJoint | None = None  # to the parent; None: the root
    children: list[UrdfJoint] = field(default_factory=list)


@dataclass
class UrdfJoint:
    """Limits, effort and dynamics in rad, m, N m, N; effort 0: none given."""

    name: str
    type: str
    parent: str
    child: str
    origin: Placement
    axis: Array
    element: Element
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    mimic: tuple[str, float, float] | None = None  # driver, multiplier, offset


@dataclass
class Robot:
    """links: depth first from the root, the joints of one link by name, as Pinocchio orders them."""

    name: str
    file: Path
    links: list[Link]
    warnings: Warnings
    materials: list[Element] = field(default_factory=list)

    @property
    def gravity(self) -> tuple[float, float, float] | None:
        """URDF says nothing about it."""
        return None

    def add(self, builder: WorldBuilder, options: Options) -> Added:
        """Adds the robot to a builder. Raises InvalidInputError as read() does, also for meshes."""
        return Adder(builder, self, options).add()

    def link(self, name: str) -> Link:
        return next(link for link in self.links if link.name == name)

    @property
    def root(self) -> Link:
        return self.links[0]

    @property
    def joints(self) -> list[UrdfJoint]:
        return [link.joint for link in self.links if link.joint is not None]


def read(path: Path) -> Robot:
    """Reads and checks a robot, without its meshes. Raises InvalidInputError: file, line, element, attribute, value."""
    root = _xml.parse(path)
    if root.tag != "robot":
        root.fail("is no URDF: its root must be <robot>")
    warnings = Warnings(path)
    links: dict[str, Link] = {}
    joints: dict[str, UrdfJoint] = {}
    for element in root:
        if element.tag.startswith("xacro:"):
            element.fail("is xacro, not URDF; expand it first: xacro FILE.xacro > FILE.urdf")
        elif element.tag == "link":
            link = _link(element, warnings)
            if link.name in links:
                element.fail(f"there is a link of this name already, in line {links[link.name].element.line}")
            links[link.name] = link
        elif element.tag == "joint":
            joint = _joint(element, warnings)
            if joint.name in joints:
                element.fail(f"there is a joint of this name already, in line {joints[joint.name].element.line}")
            joints[joint.name] = joint
        elif element.tag == "gazebo":
            found = sorted(_GAZEBO_PHYSICS & {child.tag for child in element})
            if found:
                reference = element.attributes.get("reference", root.attributes.get("name", "robot"))
                warnings.add("<gazebo> settings are not read", f"{reference} ({' '.join(found)})")
        elif element.tag == "transmission":
            warnings.add("<transmission> is not read; motors act on the joints", element.attributes.get("name", "?"))
        elif element.tag in _MISPLACED:
            element.fail("does not belong in <robot>")
        elif element.tag not in _NO_PHYSICS:
            warnings.add("elements that are not read", f"<{element.tag}>")
    if not links:
        root.fail("has no <link>")
    ordered = _tree(root, links, joints)
    _check_mimics(joints)
    return Robot(root.attributes.get("name", path.stem), path, ordered, warnings, root.all("material"))


# Reading


def _link(element: Element, warnings: Warnings) -> Link:
    name = element.string("name")
    for child in element:
        if child.tag in _MISPLACED and child.tag not in _LINK_CHILDREN:
            child.fail("does not belong in <link>")
        if child.tag not in _LINK_CHILDREN and child.tag not in _NO_PHYSICS:
            warnings.add(f"<{child.tag}> of links is not read", name)
    inertial = element.find("inertial")
    inertia = _inertia.nothing() if inertial is None else _inertial(inertial)
    return Link(name, element, inertia, [_collision(child) for child in element.all("collision")])


def _inertial(element: Element) -> Inertia:
    mass = element.need("mass").number("value", None, 0.0, MAX_MASS)
    entries = element.need("inertia")
    xx, xy, xz, yy, yz, zz = (
        entries.number(name, 0.0 if name in ("ixy", "ixz", "iyz") else None, -MAX_INERTIA, MAX_INERTIA)
        for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    about_center = Inertia(mass, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    return about_center.placed(_origin(element))


def _collision(element: Element) -> Collision:
    geometry = element.need("geometry")
    if len(geometry.children) != 1:
        geometry.fail(f"has {len(geometry.children)} shapes, must have one")
    shape = geometry.children[0]
    if shape.tag not in ("box", "sphere", "cylinder", "capsule", "mesh"):
        shape.fail("is no shape; there are box, sphere, cylinder, capsule, mesh")
    return Collision(element.attributes.get("name", ""), _origin(element), shape)


def _origin(element: Element) -> Placement:
    origin = element.find("origin")
    if origin is None:
        return identity()
    angles = origin.vector("rpy", 3, (0.0, 0.0, 0.0), 1e6)
    return Placement(from_roll_pitch_yaw(angles), origin.vector("xyz", 3, (0.0, 0.0, 0.0), MAX_POSITION))


def _joint(element: Element, warnings: Warnings) -> UrdfJoint:
    name, kind = element.string("name"), element.string("type")
    if kind not in JOINT_TYPES:
        element.fail(f'type is "{kind}", must be one of {", ".join(JOINT_TYPES)}')
    for child in element:
        if child.tag in _MISPLACED and child.tag not in _JOINT_CHILDREN:
            child.fail("does not belong in <joint>")
        if child.tag not in _JOINT_CHILDREN and child.tag not in _NO_PHYSICS:
            warnings.add(f"<{child.tag}> of joints is not read", name)
    joint = UrdfJoint(
        name,
        kind,
        element.need("parent").string("link"),
        element.need("child").string("link"),
        _origin(element),
        np.array([1.0, 0.0, 0.0]),
        element,
    )
    if kind in ("fixed", "floating"):
        if element.find("mimic") is not None:
            warnings.add(f"<mimic> of {kind} joints is not read", name)
        return joint
    axis = element.find("axis")
    if axis is not None:
        joint.axis = axis.vector("xyz", 3, None, 1e6)
        length = float(np.linalg.norm(joint.axis))
        if length < 1e-6:
            axis.fail(f'xyz is "{axis.string("xyz")}", must not be 0')
        joint.axis /= length
    _limit(joint, warnings)
    dynamics = element.find("dynamics")
    if dynamics is not None:
        joint.damping = dynamics.number("damping", 0.0, 0.0)
        joint.friction = dynamics.number("friction", 0.0, 0.0)
    mimic = element.find("mimic")
    if mimic is not None:
        if kind == "planar":
            element.fail("a planar joint cannot mimic another")
        joint.mimic = mimic.string("joint"), mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)
    return joint


def _limit(joint: UrdfJoint, warnings: Warnings) -> None:
    limit = joint.element.find("limit")
    if limit is None:
        if joint.type in ("revolute", "prismatic"):
            joint.element.fail(f"a {joint.type} joint needs <limit>")
        return
    joint.effort = limit.number("effort", 0.0, 0.0, infinite=True)
    if limit.number("velocity", 0.0, 0.0, infinite=True) > 0.0:
        warnings.add("velocity limits are not kept", joint.name)
    if joint.type in ("revolute", "prismatic"):
        joint.lower = limit.number("lower", 0.0, infinite=True)
        joint.upper = limit.number("upper", 0.0, infinite=True)
        if joint.lower > joint.upper:
            limit.fail(f"lower is {joint.lower:g} and upper {joint.upper:g}, lower must not exceed upper")


def _tree(root: Element, links: dict[str, Link], joints: dict[str, UrdfJoint]) -> list[Link]:
    for joint in sorted(joints.values(), key=lambda joint: joint.name):
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                joint.element.need(role).fail(f'link is "{name}", there is no such link')
        if joint.parent == joint.child:
            joint.element.fail(f'parent and child are both "{joint.parent}"')
        child = links[joint.child]
        if child.joint is not None:
            joint.element.fail(f'its child "{child.name}" hangs on joint "{child.joint.name}" already')
        child.joint = joint
        links[joint.parent].children.append(joint)
    roots = [link for link in links.values() if link.joint is None]
    if not roots:
        root.fail("its joints make a loop: no link is without a parent")
    if len(roots) > 1:
        roots[1].element.fail(f'has no parent joint, and neither has "{roots[0].name}"; one link must be the root')
    ordered: list[Link] = []
    stack = [roots[0]]
    while stack:
        link = stack.pop()
        ordered.append(link)
        stack.extend(links[joint.child] for joint in reversed(link.children))
    if len(ordered) < len(links):
        reached = {link.name for link in ordered}
        lost = next(link for link in links.values() if link.name not in reached)
        lost.element.fail("is on a loop of joints that hangs on nothing")
    return ordered


def _check_mimics(joints: dict[str, UrdfJoint]) -> None:
    for joint in joints.values():
        seen = {joint.name}
        current = joint
        while current.mimic is not None:
            element = current.element.need("mimic")
            driver = joints.get(current.mimic[0])
            if driver is None:
                element.fail(f'joint is "{current.mimic[0]}", there is no such joint')
            if driver.type not in ONE_VALUE:
                element.fail(f'joint "{driver.name}" is {driver.type}, must be one of {", ".join(ONE_VALUE)}')
            if driver.name in seen:
                element.fail(f'joint "{driver.name}" mimics, in turn, this one')
            seen.add(driver.name)
            current = driver


# Adding


class Adder:
    def __init__(self, builder: WorldBuilder, robot: Robot, options: Options) -> None:
        self._builder, self._robot, self._options = builder, robot, options
        self._warnings = robot.warnings
        self._finder = FileFinder(robot.file, options.package_dirs)
        self._meshes: dict[Path, mesh.Mesh] = {}
        self._hulls: dict[tuple[Path, tuple[float, ...], bool], list[mesh.Hull]] = {}
        self._added = Added(robot.file)
        self._geometry_names: set[str] = set()
        # A root link called "world" is the world.
        self._world_root = robot.root.name == WORLD and not options.prefix
        if self._world_root and options.floating_base:
            robot.root.element.fail(
                "is the root and stands for the world, which cannot float; floating_base must be off"
            )

    def add(self) -> Added:
        inertias = self._inertias()
        for link in self._robot.links:
            if not (self._world_root and link is self._robot.root):
                self._add_body(link, inertias[link.name])
            for number, collision in enumerate(link.collisions):
                self._add_collision(link, collision, number)
            for element in link.element.all("visual"):
                self._add_visual(link, element)
        self._add_couplings()
        if self._options.motors:
            self._add_motors()
        self._warnings.tell(self._builder)
        return self._added

    def _name(self, name: str) -> str:
        return self._options.prefix + name

    def _call(self, element: Element, function: Callable[[], Result]) -> Result:
        """What the builder refuses, with file, line and element."""
        try:
            return function()
        except InvalidInputError as error:
            element.fail(str(error))

    def _parent(self, link: Link) -> tuple[str, Placement]:
        """Body that a link hangs on, and its placement there."""
        if link.joint is None:
            return WORLD, self._options.placement
        joint, root = link.joint, self._robot.root
        if self._world_root and joint.parent == root.name:
            return WORLD, self._options.placement @ joint.origin
        if joint.type != "floating":
            return self._name(joint.parent), joint.origin
        placement, above = joint.origin, self._robot.link(joint.parent)  # free bodies hang on the world itself
        while above.joint is not None and above.joint.type == "fixed":
            placement, above = above.joint.origin @ placement, self._robot.link(above.joint.parent)
        if above is not root or self._options.floating_base:
            joint.element.fail("a floating joint must hang on what is fixed to the world")
        return WORLD, self._options.placement @ placement

    def _add_body(self, link: Link, inertia: Inertia) -> None:
        parent, placement = self._parent(link)
        element = link.element if link.joint is None else link.joint.element
        joints = self._joints(link)
        self._call(
            element,
            lambda: self._builder.add_body(
                self._name(link.name),
                parent=parent,
                position=placement.position.tolist(),
                orientation=placement.rotation,
                joints=joints,
                mass=inertia.mass,
                center=inertia.center.tolist(),
                inertia=inertia.inertia,
            ),
        )
        self._added.bodies.append(self._name(link.name))

    def _joints(self, link: Link) -> list[Joint]:
        from signorini._world import Joint

        joint = link.joint
        if joint is None:
            return [Joint(self._name("root_joint"), "free")] if self._options.floating_base else []
        name = self._name(joint.name)
        if joint.type == "fixed":
            return []
        if joint.type == "floating":
            return [Joint(name, "free")]
        losses: dict[str, Any] = {"damping": joint.damping, "friction": joint.friction}
        if joint.type == "planar":
            a, b = basis(joint.axis)
            return [
                Joint(f"{name}_x", "prismatic", axis=a.tolist(), **losses),
                Joint(f"{name}_y", "prismatic", axis=b.tolist(), **losses),
                Joint(f"{name}_angle", "revolute", axis=joint.axis.tolist(), **losses),
            ]
        return [
            Joint(
                name,
                "prismatic" if joint.type == "prismatic" else "revolute",
                axis=joint.axis.tolist(),
                lower=joint.lower,
                upper=joint.upper,
                **losses,
            )
        ]

    def _inertias(self) -> dict[str, Inertia]:
        parts = []
        for link in self._robot.links:
            fixed = link.joint if link.joint is not None and link.joint.type == "fixed" else None
            place = identity() if fixed is None else fixed.origin
            fixed_to = None if fixed is None else fixed.parent
            parts.append(_inertia.Part(link.name, link.inertia, link.element, fixed_to, place))
        anchored = set() if self._options.floating_base else {self._robot.root.name}
        return self._possible(parts, anchored)

    def _possible(self, parts: list[_inertia.Part], anchored: set[str]) -> dict[str, Inertia]:
        mended: list[str] = []
        result = _inertia.possible(parts, anchored, self._options.repair_inertia, self._warnings, mended)
        self._added.mended += [self._name(name) for name in mended]
        return result

    def _add_collision(self, link: Link, collision: Collision, number: int) -> None:
        name = collision.name or (link.name if len(link.collisions) == 1 else f"{link.name}_{number}")
        if name in self._geometry_names:  # many files call all their collisions the same
            name = f"{link.name}_{number}"
        self._geometry_names.add(name)
        if collision.geometry.tag != "mesh":
            self._add_geometry(link, collision, self._shape(collision), collision.placement, name)
            return
        hulls = self._mesh_hulls(collision.geometry, self._options.splits(link.name))
        for part, hull in enumerate(hulls):
            shape, inner = mesh.shape(hull)
            part_name = name if len(hulls) == 1 else f"{name}_{part}"
            index = self._add_geometry(link, collision, shape, collision.placement @ inner, part_name)
            self._added.hulls[index] = hull

    def _add_geometry(self, link: Link, collision: Collision, shape: Shape, placement: Placement, name: str) -> int:
        body, placement = self._place(link, placement)
        index = self._call(
            collision.geometry,
            lambda: self._builder.add_geometry(
                body,
                shape,
                position=placement.position.tolist(),
                orientation=placement.rotation,
                name=self._name(name),
                **self._surface(link, collision),
            ),
        )
        self._added.geometries.append(index)
        self._added.body_of_geometry[index] = body
        return index

    def _surface(self, link: Link, collision: Collision) -> dict[str, Any]:
        """What add_geometry() is told about a collision beside shape and place."""
        return {"material": self._options.material_of(link.name)}

    def _place(self, link: Link, placement: Placement) -> tuple[str, Placement]:
        """A place in a link as a body and a place in it."""
        if self._world_root and link is self._robot.root:
            return WORLD, self._options.placement @ placement
        return self._name(link.name), placement

    def _add_visual(self, link: Link, element: Element) -> None:
        """What cannot be drawn is left out: looks must not keep a robot from being simulated."""
        try:
            collision = _collision(element)
            body, placement = self._place(link, collision.placement)
            color, shape = self._color(element), self._visual_shape(collision)
        except InvalidInputError as error:
            self._warnings.add("visuals that cannot be drawn", f"{link.name} ({str(error).splitlines()[0]})")
            return
        self._builder.add_visual(body, shape, position=placement.position, orientation=placement.rotation, color=color)

    def _visual_shape(self, collision: Collision) -> Shape | MeshFile:
        element = collision.geometry
        if element.tag != "mesh":
            return self._shape(collision)
        x, y, z = element.vector("scale", 3, (1.0, 1.0, 1.0), MAX_POSITION)
        return MeshFile(self._finder.find(element, element.string("filename")), (float(x), float(y), float(z)))

    def _color(self, visual: Element) -> Color | None:
        material = visual.find("material")
        if material is not None and material.find("color") is None:
            name = material.attributes.get("name", "")
            material = next((m for m in self._robot.materials if m.attributes.get("name") == name), None)
        color = None if material is None else material.find("color")
        if color is None:
            return None
        r, g, b, a = np.clip(color.vector("rgba", 4, (0.5, 0.5, 0.5, 1.0), 1e6), 0.0, 1.0)
        return float(r), float(g), float(b), float(a)

    def _shape(self, collision: Collision) -> Shape:
        from signorini import _world

        element = collision.geometry

        def length(name: str) -> float:
            value = element.number(name, None, 0.0, MAX_POSITION)
            if value == 0.0:
                element.fail(f"{name} is 0, must be positive")
            return value

        if element.tag == "sphere":
            return _world.Sphere(length("radius"))
        if element.tag == "cylinder":
            return _world.Cylinder(length("radius"), 0.5 * length("length"))
        if element.tag == "capsule":
            return _world.Capsule(length("radius"), 0.5 * length("length"))
        size = element.vector("size", 3, None, MAX_POSITION)
        if (size <= 0.0).any():
            element.fail(f'size is "{element.string("size")}", must be positive')
        return _world.Box((0.5 * size[0], 0.5 * size[1], 0.5 * size[2]))

    def _mesh_hulls(self, element: Element, split: bool) -> list[mesh.Hull]:
        path = self._finder.find(element, element.string("filename"))
        scale = element.vector("scale", 3, (1.0, 1.0, 1.0), MAX_POSITION)
        if (scale == 0.0).any():
            element.fail(f'scale is "{element.string("scale")}", must not be 0')
        key = path, tuple(scale.tolist()), split
        if key not in self._hulls:
            try:
                if path not in self._meshes:
                    self._meshes[path] = mesh.read(path)
                self._hulls[key] = mesh.hulls(self._meshes[path].scaled(scale), self._options.hull_vertices, split)
            except InvalidInputError as error:
                reason = str(error)
                element.fail(reason if str(path) in reason else f"{path}: {reason}")
            self._warnings.add_hulls(path.name, self._hulls[key])
        return self._hulls[key]

    def _add_couplings(self) -> None:
        for joint in self._robot.joints:
            if joint.mimic is not None:
                driver, multiplier, offset = joint.mimic
                name = self._name(joint.name)
                couple = partial(self._builder.add_coupling, name, self._name(driver), (offset, multiplier), name=name)
                self._call(joint.element, couple)

    def _add_motors(self) -> None:
        for joint in self._robot.joints:
            if joint.type in ONE_VALUE and joint.mimic is None:
                effort = joint.effort if joint.effort > 0.0 else math.inf
                name = self._name(joint.name)
                self._builder.add_motor(name, name, force_range=(-effort, effort))
