"""Worlds and what they are built from: bodies, joints, shapes, materials, constraints, actuators."""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from signorini import _arrays, _simulator
from signorini._core import InvalidInputError
from signorini._visual import Color, MeshFile, TriangleMesh, Visual

Array = NDArray[np.float64]
WORLD = "world"


@dataclass(frozen=True)
class Material:
    """How a surface behaves in contact.

    friction: Coulomb's coefficient, >= 0. restitution: share of the approach speed that comes back, in [0, 1].
    stiffness: of a contact patch [N/m], shared by its points; infinite: rigid. damping: of the same patch [N s/m].
    torsion, rolling: the largest moment of a contact point about its normal, and about its tangents, over its normal
    force [m] (docs/simulation.md, S16); for a ball that rolls or spins. condim: what friction there is, as in MuJoCo: 1
    none, 3 sliding, 4 torsion too, 6 rolling too; None: what the coefficients ask for, 3 at least.
    Two materials mix to: friction sqrt(mu_a mu_b), or the larger where both have friction_mix "maximum"; the larger
    torsion, rolling, condim and restitution; springs in series. priority: of two, the material with the higher one
    counts alone.
    """

    friction: float = 0.8
    restitution: float = 0.0
    stiffness: float = math.inf
    damping: float = 0.0
    friction_mix: Literal["geometric", "maximum"] = "geometric"
    priority: int = 0
    torsion: float = 0.0
    rolling: float = 0.0
    condim: Literal[1, 3, 4, 6] | None = None


@dataclass(frozen=True)
class Sphere:
    radius: float  #: [m]


@dataclass(frozen=True)
class Box:
    half_extents: tuple[float, float, float]  #: [m]


@dataclass(frozen=True)
class Capsule:
    """Along z. half_length: of the axis, without the caps."""

    radius: float  #: [m]
    half_length: float  #: [m]


@dataclass(frozen=True)
class Cylinder:
    """Along z."""

    radius: float  #: [m]
    half_length: float  #: [m]


@dataclass(frozen=True)
class Ellipsoid:
    radii: tuple[float, float, float]  #: [m]


@dataclass(frozen=True)
class HalfSpace:
    """Solid where z <= 0."""


@dataclass(frozen=True, eq=False)
class Convex:
    """A convex polyhedron: the hull's vertices, n x 3 [m], and its triangles, m x 3, winding outwards."""

    vertices: Array
    triangles: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class HeightField:
    """Ground with the given heights over the rectangle [-x, x] x [-y, y]; it has to be fixed to the world.

    heights: (rows, columns) [m], each at least 2 and at most 4096, all above -base. Rows along y from -y to y, columns
    along x from -x to x, as MuJoCo has them. Between four samples the surface is two triangles, which meet in the
    diagonal from (row, column) to (row + 1, column + 1). half_extents: (x, y) [m]. base: solid from z = -base up to the
    surface [m].
    """

    heights: Array
    half_extents: tuple[float, float]
    base: float = 1.0


Shape = Sphere | Box | Capsule | Cylinder | Ellipsoid | HalfSpace | Convex | HeightField

JointType = Literal["free", "ball", "revolute", "prismatic"]


@dataclass(frozen=True)
class Joint:
    """One joint between a body and its parent; `axis` and `anchor` are in the body frame.

    Values (q, v): free 7, 6 (position, quaternion x y z w; linear and angular velocity in the body frame); ball 4, 3;
    revolute and prismatic 1, 1. `reference`: the value at which the body has its placement. Units follow the joint: rad
    and N m, or m and N. lower, upper: limits; of a ball joint upper alone, the largest angle from where its body was
    placed. limit_stiffness, limit_damping: of the limits; infinite: rigid. armature: inertia of the drive, added to the
    rest [kg m^2, kg]. damping: viscous [N m s/rad, N s/m]. friction: dry, the largest force [N m, N].
    stiffness: of a spring that rests at spring_reference.
    """

    name: str
    type: JointType = "revolute"
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    anchor: Sequence[float] = (0.0, 0.0, 0.0)
    reference: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    limit_stiffness: float = math.inf
    limit_damping: float = 0.0
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    spring_reference: float = 0.0


def suggest(name: str, known: Iterable[str]) -> str:
    """The end of an error about a name that does not exist: the nearest that do."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=3) or names[:3]
    return f"; did you mean {', '.join(map(repr, near))}?" if near else ""


def index_of(field: str, name: str, known: Sequence[str] | Mapping[str, int]) -> int:
    """Index of a name in a list, or by a dictionary."""
    if _arrays.text(field, name) not in known:
        raise InvalidInputError(f"{field}: there is no {name!r}{suggest(name, known)}")
    return known[name] if isinstance(known, Mapping) else known.index(name)


def _vector(value: ArrayLike, size: int, field: str) -> Array:
    array = _arrays.numbers(field, value)
    if array.shape != (size,):
        raise InvalidInputError(f"{field}: has shape {array.shape}, must have {size} values")
    return array


def _rotation(value: ArrayLike, field: str) -> Array:
    """3 x 3, from a matrix or a quaternion (x, y, z, w)."""
    array = _arrays.numbers(field, value)
    if array.shape == (3, 3):
        return array
    if array.shape != (4,):
        raise InvalidInputError(f"{field}: has shape {array.shape}, must be a quaternion (x, y, z, w) or 3 x 3")
    norm = float(np.linalg.norm(array))
    if not (math.isfinite(norm) and norm > 1e-9):
        raise InvalidInputError(f"{field}: is a quaternion of length {norm}, must be finite and not 0")
    x, y, z, w = array / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _placement(position: ArrayLike, orientation: ArrayLike, field: str) -> Any:
    placement = _simulator.Placement()
    placement.translation = _vector(position, 3, f"{field}.position")
    placement.rotation = _rotation(orientation, f"{field}.orientation")
    return placement


def _core_material(material: Material) -> Any:
    if not isinstance(material, Material):
        raise InvalidInputError(f"material: is a {type(material).__name__}, must be a signorini.Material")
    core = _simulator.Material()
    for key in ("friction", "restitution", "stiffness", "damping", "torsion", "rolling"):
        setattr(core, key, _arrays.number(key, getattr(material, key)))
    if material.friction_mix not in ("geometric", "maximum"):
        raise InvalidInputError(f"friction_mix: is {material.friction_mix!r}, must be 'geometric' or 'maximum'")
    core.friction_mix = getattr(_simulator.FrictionMix, material.friction_mix)
    if isinstance(material.condim, bool) or material.condim not in (None, 1, 3, 4, 6):
        raise InvalidInputError(f"condim: is {material.condim!r}, must be 1, 3, 4, 6 or None")
    core.condim = int(material.condim or 0)
    core.priority = _arrays.count("priority", material.priority)
    return core


def _radius_and_half_length(shape: Capsule | Cylinder) -> tuple[float, float]:
    return _arrays.number("radius", shape.radius), _arrays.number("half_length", shape.half_length)


def _core_shape(shape: Shape) -> Any:
    make = _simulator.Shape
    match shape:
        case Sphere():
            return make.sphere(_arrays.number("radius", shape.radius))
        case Box():
            return make.box(_vector(shape.half_extents, 3, "half_extents"))
        case Capsule():
            return make.capsule(*_radius_and_half_length(shape))
        case Cylinder():
            return make.cylinder(*_radius_and_half_length(shape))
        case Ellipsoid():
            return make.ellipsoid(_vector(shape.radii, 3, "radii"))
        case HalfSpace():
            return make.half_space()
        case Convex():
            vertices = _arrays.numbers("vertices", shape.vertices)
            triangles = _arrays.numbers("triangles", shape.triangles)
            if not ((np.abs(triangles) < 2**31) & (np.floor(triangles) == triangles)).all():
                raise InvalidInputError("triangles: has entries that are no integers, must be numbers of vertices")
            for field, array in (("vertices", vertices), ("triangles", triangles)):
                if array.ndim != 2 or array.shape[1] != 3:
                    raise InvalidInputError(f"{field}: has shape {array.shape}, must be n x 3")
            return make.convex(vertices, triangles.astype(np.int32))
        case HeightField():
            heights = _arrays.numbers("heights", shape.heights)
            if heights.ndim != 2:
                raise InvalidInputError(f"heights: has shape {heights.shape}, must be rows x columns")
            half_x, half_y = _vector(shape.half_extents, 2, "half_extents")
            return make.height_field(heights, half_x, half_y, _arrays.number("base", shape.base))
    raise InvalidInputError(
        f"shape: is {shape!r}, must be a Sphere, Box, Capsule, Cylinder, Ellipsoid, HalfSpace, Convex, HeightField"
    )


def _core_joint(joint: Joint) -> Any:
    core = _simulator.Joint()
    field = f"joint {joint.name!r}"
    core.name = _arrays.text("joint.name", joint.name)
    if joint.type not in ("free", "ball", "revolute", "prismatic"):
        raise InvalidInputError(f"{field}.type: is {joint.type!r}, must be free, ball, revolute or prismatic")
    core.type = getattr(_simulator.JointType, joint.type)
    core.axis = _vector(joint.axis, 3, f"{field}.axis")
    core.anchor = _vector(joint.anchor, 3, f"{field}.anchor")
    for key in _JOINT_NUMBERS:
        setattr(core, key, _arrays.number(f"{field}.{key}", getattr(joint, key)))
    return core


_JOINT_NUMBERS = (
    *("reference", "lower", "upper", "limit_stiffness", "limit_damping"),
    *("armature", "damping", "friction", "stiffness", "spring_reference"),
)
Range = tuple[float, float]
_UNBOUNDED = (-math.inf, math.inf)


class WorldBuilder:
    """Builds a World from bodies; `load()` uses one for robot files.

        builder = WorldBuilder()
        builder.add_ground()
        builder.add_body("box", joints=[Joint("box", "free")], position=(0, 0, 1), mass=1.0, inertia=np.eye(3) / 6)
        builder.add_geometry("box", Box((0.5, 0.5, 0.5)))
        world = builder.build()

    Names of bodies and of joints are unique. Orientations are quaternions (x, y, z, w) or 3 x 3 rotation matrices.
    Bad input raises InvalidInputError, which names the element, the value and the allowed range.
    """

    def __init__(self, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> None:
        """gravity: acceleration in the world [m/s^2]."""
        self.gravity = _vector(gravity, 3, "gravity")
        self._core = _simulator.WorldBuilder(self.gravity)
        self._body_index: dict[str, int] = {WORLD: 0}
        self._joint_index: dict[str, int] = {}
        self._warnings: list[str] = []
        self._visuals: list[Visual] = []
        self._tendon_index: dict[str, int] = {}

    def body_index(self, name: str, field: str = "body") -> int:
        """Index of a body; 0 is the world. An error calls it `field`."""
        return index_of(field, name, self._body_index)

    def joint_index(self, name: str, field: str = "joint") -> int:
        """Index of a joint, in the order they were added. An error calls it `field`."""
        return index_of(field, name, self._joint_index)

    def tendon_index(self, name: str, field: str = "tendon") -> int:
        """Index of a tendon, in the order they were added. An error calls it `field`."""
        return index_of(field, name, self._tendon_index)

    def add_body(
        self,
        name: str,
        *,
        parent: str = WORLD,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        joints: Sequence[Joint] = (),
        mass: float = 0.0,
        center: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
        gravity_compensation: float = 0.0,
    ) -> str:
        """Adds a body and the joints (from the parent outwards; none: fixed) that it hangs on; returns its name.

        position [m], orientation: in the parent body, joints at reference. mass [kg], center: of mass, in the body
        [m]; inertia: 3 x 3 about the centre of mass, axes of the body [kg m^2], one that a body can have: no principal
        moment is negative or larger than the sum of the other two (by more than 0.1 %). gravity_compensation: share of
        its weight that something else carries.
        """
        field = f"body {name!r}"
        body = _simulator.Body()
        body.name = _arrays.text("body.name", name)
        body.parent = self.body_index(parent, f"{field}.parent")
        body.placement = _placement(position, orientation, field)
        body.mass = _arrays.number(f"{field}.mass", mass)
        body.center = _vector(center, 3, f"{field}.center")
        matrix = np.zeros((3, 3)) if inertia is None else _arrays.numbers(f"{field}.inertia", inertia)
        if matrix.shape != (3, 3):
            raise InvalidInputError(f"{field}.inertia: has shape {matrix.shape}, must be 3 x 3")
        body.inertia = matrix
        body.gravity_compensation = _arrays.number(f"{field}.gravity_compensation", gravity_compensation)
        if not isinstance(joints, Sequence) or not all(isinstance(joint, Joint) for joint in joints):
            raise InvalidInputError(f"{field}.joints: is {joints!r}, must be a list of signorini.Joint")
        body.joints = [_core_joint(joint) for joint in joints]
        self._body_index[name] = self._core.add_body(body)
        for joint in joints:
            self._joint_index[joint.name] = len(self._joint_index)
        return name

    def add_geometry(
        self,
        body: str,
        shape: Shape,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        material: Material | None = None,
        name: str = "",
        group: int = 1,
        mask: int = 1,
    ) -> int:
        """Adds something that collides, at a place in its body (position [m], orientation); returns its index.

        material: None for Material(). name: in contacts and errors; "" for one by index. group, mask: bits.
        Two geometries may touch if (group_a & mask_b) | (group_b & mask_a), they are not on a body (or bodies fixed to
        each other), not on parent and child, and not excluded.
        """
        field = f"geometry {name!r}" if name else f"geometry of body {body!r}"
        geometry = _simulator.Geometry()
        geometry.name = _arrays.text("geometry.name", name)
        geometry.body = self.body_index(body, f"{field}.body")
        geometry.shape = _core_shape(shape)
        geometry.placement = _placement(position, orientation, field)
        geometry.material = _core_material(Material() if material is None else material)
        geometry.group = _arrays.count(f"{field}.group", group, 0, bits=32)
        geometry.mask = _arrays.count(f"{field}.mask", mask, 0, bits=32)
        return int(self._core.add_geometry(geometry))

    def add_visual(
        self,
        body: str,
        shape: Shape | MeshFile | TriangleMesh,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        color: Color | None = None,
    ) -> None:
        """Adds something to look at, without physics; a body without any is drawn as it collides.

        position [m], orientation: in the body.
        color: red, green, blue, opacity in [0, 1]; None: the mesh's own, or as the viewer likes.
        """
        self.body_index(body, "visual.body")
        placed = _vector(position, 3, "visual.position"), _rotation(orientation, "visual.orientation")
        self._visuals.append(Visual(body, shape, *placed, color))

    def add_file(self, path: str | os.PathLike[str], **options: Any) -> Any:
        """Adds a robot file: signorini.load.add_file, where the options are."""
        from signorini.load import add_file

        return add_file(self, path, **options)

    def add_ground(self, material: Material | None = None, height: float = 0.0, name: str = "ground") -> int:
        """Adds a half space below z = height [m], fixed to the world; returns its index. material: None: Material()."""
        position = (0.0, 0.0, _arrays.number("height", height))
        return self.add_geometry(WORLD, HalfSpace(), position=position, material=material, name=name)

    def exclude(self, body_a: str, body_b: str) -> None:
        """The geometries of these two bodies never touch, unless set_pair_material is called for them afterwards."""
        self._core.exclude_bodies(self.body_index(body_a, "exclude"), self.body_index(body_b, "exclude"))

    def exclude_geometries(self, geometry_a: int, geometry_b: int) -> None:
        """These two geometries, by index, never touch."""
        self._core.exclude_geometries(_arrays.count("geometry_a", geometry_a), _arrays.count("geometry_b", geometry_b))

    def set_pair_material(self, geometry_a: int, geometry_b: int, material: Material) -> None:
        """These two geometries, by index, may touch whatever else was said, with a material of their own.

        Only what moves as one never touches itself.
        """
        pair = _simulator.ContactPair()
        pair.geometry_a = _arrays.count("geometry_a", geometry_a)
        pair.geometry_b = _arrays.count("geometry_b", geometry_b)
        pair.material = _core_material(material)
        self._core.add_contact_pair(pair)

    def add_tendon(
        self,
        name: str,
        joints: Mapping[str, float],
        *,
        lower: float = -math.inf,
        upper: float = math.inf,
        limit_stiffness: float = math.inf,
        limit_damping: float = 0.0,
        stiffness: float = 0.0,
        spring_range: Range = (0.0, 0.0),
        damping: float = 0.0,
        friction: float = 0.0,
    ) -> None:
        """A string over pulleys on joints: its length is a sum of joint values, each times its coefficient.

        joints: coefficients by joint. It resists as a joint does: limits of the length (lower, upper; limit_stiffness,
        limit_damping, infinite: rigid), a spring (stiffness) that is slack within spring_range, viscous (damping) and
        dry friction; and actuators and couplings act on it. Units are as the coefficients make them: with lengths in m
        they are N, N/m and N s/m.
        """
        field = f"tendon {name!r}"
        tendon = _simulator.Tendon()
        tendon.name = _arrays.text("tendon.name", name)
        if not isinstance(joints, Mapping):
            raise InvalidInputError(f"{field}.joints: is {joints!r}, must be coefficients by joint, a dict")
        tendon.terms = [
            (self.joint_index(joint, f"{field}.joints"), _arrays.number(f"{field}.joints[{joint!r}]", c))
            for joint, c in joints.items()
        ]
        for key, value in (
            *(
                ("lower", lower),
                ("upper", upper),
                ("limit_stiffness", limit_stiffness),
                ("limit_damping", limit_damping),
            ),
            *(("stiffness", stiffness), ("damping", damping), ("friction", friction)),
        ):
            setattr(tendon, key, _arrays.number(f"{field}.{key}", value))
        tendon.spring_lower, tendon.spring_upper = _vector(spring_range, 2, f"{field}.spring_range").tolist()
        self._tendon_index[name] = self._core.add_tendon(tendon)

    def _constraint(self, kind: str, name: str, stiffness: float, damping: float) -> Any:
        constraint = _simulator.EqualityConstraint()
        constraint.type = getattr(_simulator.ConstraintType, kind)
        constraint.name = _arrays.text(f"{kind}.name", name)
        constraint.stiffness = _arrays.number(f"{kind} {name!r}.stiffness", stiffness)
        constraint.damping = _arrays.number(f"{kind} {name!r}.damping", damping)
        return constraint

    def add_connect(
        self,
        body_a: str,
        body_b: str,
        point_a: ArrayLike,
        point_b: ArrayLike,
        *,
        name: str = "",
        stiffness: float = math.inf,
        damping: float = 0.0,
    ) -> None:
        """point_a of one body [m, in its frame] stays at point_b of another: rigid, or a spring with damper.

        stiffness [N/m], infinite: rigid. damping [N s/m].
        """
        constraint = self._constraint("connect", name, stiffness, damping)
        constraint.body_a, constraint.body_b = self.body_index(body_a, "body_a"), self.body_index(body_b, "body_b")
        constraint.placement_a = _placement(point_a, (0.0, 0.0, 0.0, 1.0), "point_a")
        constraint.placement_b = _placement(point_b, (0.0, 0.0, 0.0, 1.0), "point_b")
        self._core.add_constraint(constraint)

    def add_weld(
        self,
        body_a: str,
        body_b: str,
        *,
        position_a: ArrayLike = (0.0, 0.0, 0.0),
        orientation_a: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        position_b: ArrayLike = (0.0, 0.0, 0.0),
        orientation_b: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str = "",
        stiffness: float = math.inf,
        damping: float = 0.0,
        turn_stiffness: float | None = None,
        turn_damping: float | None = None,
    ) -> None:
        """Two frames, one in each body, stay the same: rigid, or a spring with damper in each of the six rows.

        stiffness [N/m], damping [N s/m] of places; turn_stiffness [N m/rad], turn_damping [N m s/rad] of rotations,
        None: the same numbers.
        """
        constraint = self._constraint("weld", name, stiffness, damping)
        constraint.body_a, constraint.body_b = self.body_index(body_a, "body_a"), self.body_index(body_b, "body_b")
        constraint.placement_a = _placement(position_a, orientation_a, "frame a")
        constraint.placement_b = _placement(position_b, orientation_b, "frame b")
        turn = {"turn_stiffness": (turn_stiffness, stiffness), "turn_damping": (turn_damping, damping)}
        for key, (value, same) in turn.items():
            setattr(constraint, key, _arrays.number(f"weld {name!r}.{key}", same if value is None else value))
        self._core.add_constraint(constraint)

    def add_coupling(
        self,
        joint: str,
        driver: str | None,
        coefficients: Sequence[float] = (0.0, 1.0),
        *,
        reference: float = 0.0,
        driver_reference: float = 0.0,
        name: str = "",
        stiffness: float = math.inf,
        damping: float = 0.0,
        kind: Literal["joint", "tendon"] | None = None,
    ) -> None:
        """q_joint - reference = polynomial(q_driver - driver_reference), at most quartic, constant first.

        Without a driver q_joint is held at reference + coefficients[0]. A URDF mimic joint is one of these. Either may
        be a tendon; then q is its length. kind: what both names are of; None: of joints, or tendons where no joint is
        called so.
        """
        if kind not in ("joint", "tendon", None):
            raise InvalidInputError(f"kind: is {kind!r}, must be joint, tendon or None")
        factors = _arrays.numbers("coefficients", coefficients)
        if factors.ndim != 1 or not 1 <= factors.size <= 5:
            raise InvalidInputError(f"coefficients: has shape {factors.shape}, must have 1 to 5 values")
        constraint = self._constraint("coupling", name, stiffness, damping)
        for side, value in (("b", joint), ("a", driver)):
            if value is None:
                continue
            field = "joint" if side == "b" else "driver"
            named = value in self._tendon_index and value not in self._joint_index
            if kind == "tendon" or (kind is None and named):
                setattr(constraint, f"tendon_{side}", self.tendon_index(value, field))
            else:
                setattr(constraint, f"joint_{side}", self.joint_index(value, field))
        constraint.coefficients = [_arrays.number("coefficients", c) for c in coefficients]
        constraint.reference_a = _arrays.number("driver_reference", driver_reference)
        constraint.reference_b = _arrays.number("reference", reference)
        self._core.add_constraint(constraint)

    def add_actuator(
        self,
        name: str,
        joint: str | None = None,
        *,
        component: int = 0,
        tendon: str | None = None,
        body: str | None = None,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        wrench: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        gear: float = 1.0,
        gain: ArrayLike = (1.0, 0.0, 0.0),
        bias: ArrayLike = (0.0, 0.0, 0.0),
        activation: Literal["none", "integrator", "filter"] = "none",
        time_constant: float = 0.0,
        control_range: Range = _UNBOUNDED,
        activation_range: Range = _UNBOUNDED,
        force_range: Range = _UNBOUNDED,
    ) -> None:
        """Any affine drive: force = gear effort, effort = gain . (1, l, l') input + bias . (1, l, l').

        It acts on one velocity (`component`) of a joint, on a tendon, or on a body: there it pushes at `position`,
        `orientation` with the wrench (force [N], moment [N m]) effort times `wrench`. l is gear times the joint's value
        or the tendon's length, l' its rate (bodies, ball and free joints: l = 0). What resists l and l' is implicit:
        stable at any gain. input: the control; with activation "integrator" its integral over time, with "filter"
        d input / dt = (control - input) / time_constant [s]; then it is a part of the state (Simulator.state).
        Controls, activation and effort are clipped to their ranges.
        """
        field = f"actuator {name!r}"
        actuator = _simulator.Actuator()
        actuator.name, actuator.gear = _arrays.text("actuator.name", name), _arrays.number(f"{field}.gear", gear)
        if joint is not None:
            actuator.joint = self.joint_index(joint, f"{field}.joint")
            actuator.component = _arrays.count(f"{field}.component", component)
        if tendon is not None:
            actuator.tendon = self.tendon_index(tendon, f"{field}.tendon")
        if body is not None:
            actuator.body = self.body_index(body, f"{field}.body")
            actuator.placement = _placement(position, orientation, field)
            actuator.wrench = _vector(wrench, 6, f"{field}.wrench").tolist()
        actuator.gain, actuator.bias = _vector(gain, 3, f"{field}.gain"), _vector(bias, 3, f"{field}.bias")
        if activation not in ("none", "integrator", "filter"):
            raise InvalidInputError(f"{field}.activation: is {activation!r}, must be none, integrator or filter")
        actuator.activation = getattr(_simulator.Activation, activation)
        actuator.time_constant = _arrays.number(f"{field}.time_constant", time_constant)
        for key, values in (("control", control_range), ("activation", activation_range), ("force", force_range)):
            lower, upper = _vector(values, 2, f"{field}.{key}_range").tolist()
            setattr(actuator, f"{key}_lower", lower)
            setattr(actuator, f"{key}_upper", upper)
        self._core.add_actuator(actuator)

    def add_motor(
        self,
        name: str,
        joint: str,
        *,
        component: int = 0,
        gear: float = 1.0,
        control_range: Range = _UNBOUNDED,
        force_range: Range = _UNBOUNDED,
    ) -> None:
        """force = gear * control [N m, N], on one velocity (component) of a joint.

        control_range, force_range: (lower, upper) of the control, and of the force before the gear.
        """
        self.add_actuator(
            name, joint, component=component, gear=gear, control_range=control_range, force_range=force_range
        )

    def add_position_actuator(
        self,
        name: str,
        joint: str,
        *,
        kp: float,
        kv: float = 0.0,
        gear: float = 1.0,
        control_range: Range = _UNBOUNDED,
        force_range: Range = _UNBOUNDED,
    ) -> None:
        """force = gear * (kp (control - gear q) - kv gear v), implicit in q and v: stable at any gain.

        kp, kv: in [0, 1e12]. The other arguments are those of add_motor.
        """
        for key, value in (("kp", kp), ("kv", kv)):
            if not 0.0 <= _arrays.number(f"actuator {name!r}.{key}", value) <= 1e12:
                raise InvalidInputError(f"actuator {name!r}.{key}: is {value}, must be in [0, 1e12]")
        gain, bias = (kp, 0.0, 0.0), (0.0, -kp, -kv)
        self.add_actuator(
            name, joint, gear=gear, gain=gain, bias=bias, control_range=control_range, force_range=force_range
        )

    def add_velocity_actuator(
        self,
        name: str,
        joint: str,
        *,
        kv: float,
        component: int = 0,
        gear: float = 1.0,
        control_range: Range = _UNBOUNDED,
        force_range: Range = _UNBOUNDED,
    ) -> None:
        """force = gear * kv (control - gear v), implicit in v. kv: in [0, 1e12]; the others are those of add_motor."""
        if not 0.0 <= _arrays.number(f"actuator {name!r}.kv", kv) <= 1e12:
            raise InvalidInputError(f"actuator {name!r}.kv: is {kv}, must be in [0, 1e12]")
        self.add_actuator(
            name,
            joint,
            component=component,
            gear=gear,
            gain=(kv, 0.0, 0.0),
            bias=(0.0, 0.0, -kv),
            control_range=control_range,
            force_range=force_range,
        )

    def add_pinocchio(self, model: Any, prefix: str = "") -> None:
        """Adds the joints and bodies of a Pinocchio model: a `pin.Model`, or the text that its saveToString() gives.

        prefix: before all names. Bodies are named after their joints, "<joint> body". Joints: free-flyer, spherical,
        revolute, prismatic; others raise InvalidInputError. Geometry is not part of a model: see add_geometry.
        """
        from signorini._pinocchio import add_pinocchio

        add_pinocchio(self, model, prefix)

    def warn(self, message: str) -> None:
        """Something that was asked for and is not carried over; ends up in World.warnings."""
        self._warnings.append(message)

    def build(self) -> World:
        """The world as it stands; the builder can go on. Raises InvalidInputError, e.g. for something without mass that
        moves."""
        return World(self._core.build(), tuple(self._warnings), tuple(self._visuals))


class World:
    """Robots, objects and ground; constant, shared by simulators. Made by `load()` or a `WorldBuilder`.

    bodies, joints, geometries, constraints, tendons, actuators: tuples of what it consists of, as the C++ core has it
    (joints in the order of their values in q and v, each with q_index, num_q, v_index, num_v).
    warnings: what was in the robot's file and is not carried over.
    visuals: what bodies look like; a body without any looks as it collides.

    Configurations q have num_q values, velocities v num_v; units follow the joints. Methods raise InvalidInputError for
    another number of values, and for a name that is not there, with the nearest that are.
    """

    def __init__(self, core: Any, warnings: tuple[str, ...] = (), visuals: tuple[Visual, ...] = ()) -> None:
        self._core = core
        self.warnings = warnings
        self.visuals = visuals

    def __repr__(self) -> str:
        return (
            f"World({len(self.bodies)} bodies, {len(self.joints)} joints, {len(self.geometries)} geometries, "
            f"{self.num_v} velocities, {self.num_controls} actuators)"
        )

    num_q = property(lambda self: int(self._core.num_q), doc="Values of a configuration.")
    num_v = property(lambda self: int(self._core.num_v), doc="Values of a velocity.")
    num_controls = property(lambda self: int(self._core.num_controls), doc="Actuators.")

    @cached_property
    def bodies(self) -> tuple[Any, ...]:
        return tuple(self._core.bodies)

    @cached_property
    def joints(self) -> tuple[Any, ...]:
        return tuple(self._core.joints)

    @cached_property
    def geometries(self) -> tuple[Any, ...]:
        return tuple(self._core.geometries)

    @cached_property
    def constraints(self) -> tuple[Any, ...]:
        return tuple(self._core.constraints)

    @cached_property
    def tendons(self) -> tuple[Any, ...]:
        return tuple(self._core.tendons)

    def tendon_lengths(self, q: ArrayLike | None = None) -> Array:
        """Length of each tendon, (tendons,), at q (default: initial_q)."""
        return np.array(self._core.tendon_lengths(self.initial_q if q is None else _vector(q, self.num_q, "q")))

    @cached_property
    def actuators(self) -> tuple[Any, ...]:
        return tuple(self._core.actuators)

    @cached_property
    def body_names(self) -> tuple[str, ...]:
        return tuple(body.name for body in self.bodies)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def geometry_names(self) -> tuple[str, ...]:
        return tuple(geometry.name for geometry in self.geometries)

    @cached_property
    def _names_of_geometries(self) -> tuple[tuple[str, str], ...]:
        """Of each its body's name and its own."""
        return tuple((self.body_names[geometry.body], geometry.name) for geometry in self.geometries)

    @cached_property
    def actuator_names(self) -> tuple[str, ...]:
        return tuple(actuator.name for actuator in self.actuators)

    def body_index(self, name: str, field: str = "body") -> int:
        """Index in bodies. An error calls it `field`."""
        return index_of(field, name, self.body_names)

    def geometry_index(self, name: str) -> int:
        """Index in geometries."""
        return index_of("geometry", name, self.geometry_names)

    def actuator_index(self, name: str) -> int:
        """Index in actuators, and of its value in Simulator.control."""
        return index_of("actuator", name, self.actuator_names)

    def joint(self, name: str) -> Any:
        """The joint of that name."""
        return self.joints[index_of("joint", name, self.joint_names)]

    def jacobian(self, q: ArrayLike, body: str, point: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """(6, num_v): J v is the velocity of a point of a body [m/s], then its angular velocity [rad/s], world axes.

        point: in the frame of the body [m]."""
        at, index = _vector(q, self.num_q, "q"), self.body_index(body)
        return np.array(self._core.jacobian(at, index, _vector(point, 3, "point")))

    def q_slice(self, joint: str) -> slice:
        """Where a joint's values are in q."""
        j = self.joint(joint)
        return slice(j.q_index, j.q_index + j.num_q)

    def v_slice(self, joint: str) -> slice:
        """Where a joint's values are in v."""
        j = self.joint(joint)
        return slice(j.v_index, j.v_index + j.num_v)

    @property
    def gravity(self) -> Array:
        """[m/s^2]"""
        return np.array(self._core.gravity)

    @property
    def initial_q(self) -> Array:
        """num_q values, a copy: joints at their reference or the limit next to it, free bodies where built."""
        return np.array(self._core.initial_q)

    def integrate(self, q: ArrayLike, v: ArrayLike, time_step: float) -> Array:
        """q advanced along v for time_step [s], on the manifold of configurations (quaternions stay of length 1)."""
        return np.array(
            self._core.integrate(
                _vector(q, self.num_q, "q"), _vector(v, self.num_v, "v"), _arrays.number("time_step", time_step)
            )
        )

    def body_placement(self, body: str, q: ArrayLike | None = None) -> tuple[Array, Array]:
        """(position [m], 3 x 3 rotation) of a body's frame in the world at q (default: initial_q)."""
        frames = self._core.frame_placements(self.initial_q if q is None else _vector(q, self.num_q, "q"))
        b = self.bodies[self.body_index(body)]
        frame = frames[b.frame]
        return frame.rotation @ b.in_frame.translation + frame.translation, frame.rotation @ b.in_frame.rotation

    def constraint_gaps(self, q: ArrayLike | None = None) -> Array:
        """How far the equalities are from holding at q (default: initial_q): 3 values a connect [m], 6 a weld [m, rad],
        along the axes of the frame on body a, 1 a coupling; in the order of `constraints`."""
        from signorini._closure import gaps

        return gaps(self, self.initial_q if q is None else _vector(q, self.num_q, "q"))

    def closed_configuration(self, q: ArrayLike | None = None, *, tolerance: float = 1e-6) -> Array:
        """A configuration next to q (default: initial_q) at which equalities hold and joints are within their limits;
        free joints stay as they are.

        Raises InvalidInputError when none is found at which they hold to `tolerance` [m, rad]. (Loops in a plane, whose
        axes are parallel but for rounding, do not close perfectly.)
        """
        from signorini._closure import closed

        return closed(self, self.initial_q if q is None else _vector(q, self.num_q, "q"), tolerance)

    def touching_pairs(self, q: ArrayLike | None = None, margin: float = 0.0) -> list[tuple[int, int, float]]:
        """Pairs of geometries (a, b, smallest distance [m]) that may touch and are closer than margin [m] at q."""
        return [
            (int(a), int(b), float(d))
            for a, b, d in self._core.touching_pairs(
                self.initial_q if q is None else _vector(q, self.num_q, "q"), _arrays.number("margin", margin)
            )
        ]

    def pinocchio_model(self) -> str:
        """The world as a text archive of a Pinocchio model: `pin.Model().loadFromString(text)`.

        Joints come in the same order, so q and v are the same.
        """
        from signorini._pinocchio import to_pinocchio

        return str(to_pinocchio(self).saveToString())
