"""Worlds to simulate, measure and compare with: blocks, heaps and robots, each with where it starts.

scene = signorini.scenes.worlds()["cube-stack"]
world, q, v = scene(mass_ratio=1.0)
"""

from __future__ import annotations

import importlib.util
import inspect
import math
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from signorini import _arrays
from signorini._core import InvalidInputError
from signorini.scenes._solo import solo_controller, solo_terrain

if TYPE_CHECKING:
    from signorini._simulation import Simulator
    from signorini._world import Material, Shape, World, WorldBuilder

Array = npt.NDArray[np.float64]
PAPER = "Carpentier, Le Lidec, Montaut 2024"
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


class Start(NamedTuple):
    """A world, its configuration q (nq,) and its velocity v (nv,) at the start."""

    world: World
    q: Array
    v: Array


@dataclass(frozen=True)
class WorldScene:
    """A world by name. duration: of a run that shows what it is for [s]; source: where it is from. Called with options
    of `make`, it returns a Start.

    controller: given a simulator of that world, where it started and these options, returns what is to be called before
    every step, to set simulator.control; None: nobody drives.
    """

    name: str
    description: str
    duration: float
    source: str
    make: Callable[..., Start]
    controller: Callable[[Simulator, Start, dict[str, Any]], Callable[[], None]] | None = None

    def __call__(self, **options: Any) -> Start:
        """Raises InvalidInputError for an option that is not there, of another type, or out of range."""
        known = inspect.signature(self.make).parameters
        for option, value in options.items():
            if option not in known:
                raise InvalidInputError(f"option: there is no {option!r}; {self.name} has {', '.join(known) or 'none'}")
            _check_type(option, value, known[option].default)
        return self.make(**options)


def worlds() -> dict[str, WorldScene]:
    """All world scenes by name."""
    from signorini.scenes._blocks import BLOCKS
    from signorini.scenes._hand import HAND

    return {scene.name: scene for scene in (*_SCENES, *BLOCKS, *HAND)}


def cube_stack(
    num_cubes: int = 15,
    mass_ratio: float = 1e4,
    *,
    misalignment: float = 0.0,
    slip: float = 0.0,
    edge: float = 0.2,
    friction: float = 0.8,
) -> Start:
    """Cubes lying exactly on each other, 1 kg at the bottom, mass_ratio kg at the top, geometric between.

    misalignment: horizontal offset of each cube from the one below, in directions that turn [m]. slip: velocity across
    the top interface along x [m/s]; it falls linearly to a fifth of it on the ground. edge [m]. friction: of all.

    Raises InvalidInputError naming the option and what is allowed.
    """
    _check(num_cubes=(num_cubes, 1, 10_000), mass_ratio=(mass_ratio, 1e-12, 1e12), edge=(edge, 1e-4, 40.0))
    _check(misalignment=(misalignment, 0.0, 0.49 * edge), slip=(slip, -1e3, 1e3), friction=(friction, 0.0, 1e3))
    material = _material(friction)
    builder = _builder()
    builder.add_ground(material)
    masses = np.geomspace(1.0, mass_ratio, num_cubes) if num_cubes > 1 else np.ones(1)
    angles = _GOLDEN * np.arange(num_cubes)
    offsets = misalignment * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    centres = np.cumsum(offsets, axis=0) - offsets[0]
    speeds = np.cumsum(np.linspace(0.2 * slip, slip, num_cubes) if num_cubes > 1 else [slip])
    for i in range(num_cubes):
        inertia = masses[i] * edge**2 / 6.0 * np.eye(3)
        position = (centres[i, 0], centres[i, 1], edge * (i + 0.5))
        _add_free(builder, f"cube-{i}", _box(edge, edge, edge), masses[i], inertia, position, material)
    world = builder.build()
    v = np.zeros(world.num_v)
    for i in range(num_cubes):
        v[world.v_slice(f"cube-{i}")][0] = speeds[i]
    return Start(world, world.initial_q, v)


def spheres(
    size: int = 100, seed: int = 0, *, radius: float = 0.05, density: float = 1000.0, friction: float = 0.5
) -> Start:
    """Spheres poured into a bin: loose layers between four walls that fall to a heap about as high as it is wide.

    size: number of spheres, 1 to 100 000. seed: of radii (within 20 % of `radius` [m]), places and velocities.
    density [kg/m^3].
    """
    random = _granular(size, seed, density, friction, radius=radius)
    radii = radius * random.uniform(0.8, 1.2, size)
    builder, material, places, v = _bin(size, 1.25 * radius, friction, random)
    for i in range(size):
        mass = density * 4.0 / 3.0 * math.pi * radii[i] ** 3
        inertia = 0.4 * mass * radii[i] ** 2 * np.eye(3)
        _add_free(builder, f"sphere-{i}", _sphere(radii[i]), mass, inertia, places[i], material)
    return _at_rest_but(builder.build(), v)


def boxes(
    size: int = 100, seed: int = 0, *, edge: float = 0.1, density: float = 1000.0, friction: float = 0.5
) -> Start:
    """Boxes tipped into a bin: as `spheres`, with edges between 0.6 and 1.4 of `edge` [m] and random orientations."""
    random = _granular(size, seed, density, friction, edge=edge)
    edges = edge * random.uniform(0.6, 1.4, (size, 3))
    builder, material, places, v = _bin(size, 0.5 * math.sqrt(3.0) * 1.42 * edge, friction, random)
    orientations = random.standard_normal((size, 4))
    orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
    for i in range(size):
        mass = density * float(np.prod(edges[i]))
        inertia = mass / 12.0 * np.diag((edges[i] ** 2).sum() - edges[i] ** 2)
        _add_free(builder, f"box-{i}", _box(*edges[i]), mass, inertia, places[i], material, orientations[i])
    return _at_rest_but(builder.build(), v)


def humanoid(height: float | None = None) -> Start:
    """MuJoCo's humanoid of capsules as gymnasium has it, dropped, unactuated.

    height: of its root [m], from where the feet touch the ground on; None: that of its file.
    """
    from signorini.load import load
    from signorini.load._ground import lowest_point

    world = load(gymnasium_file("humanoid.xml"))
    q = world.initial_q
    if height is not None:
        root = world.q_slice("root").start + 2
        touching = q[root] - (lowest_point(world) or 0.0)
        _check(height=(height, math.ceil(1e4 * touching) / 1e4, 1e3))
        q[root] = height
    return Start(world, q, np.zeros(world.num_v))


def talos_fall(height: float = 0.02, *, self_collision: bool = True, friction: float = 0.8) -> Start:
    """The humanoid Talos in half-sitting pose, its soles `height` above the ground [m], unactuated: it falls.

    height: at least 0.5 mm, as the meshes of the soles are uneven by that. Links touch unless the robot's SRDF file
    says that they never do.
    """
    from signorini.load import load, srdf

    _check(height=(height, 5e-4, 1e3), friction=(friction, 0.0, 1e3))
    folder = robots_folder() / "talos_data"
    srdf_file = folder / "srdf" / "talos.srdf"
    state = srdf.read(srdf_file).states["half_sitting"]
    material = _material(friction)

    def pose(world: World) -> Array:
        q = srdf.configuration(world, state)
        q[world.q_slice("root_joint")][2] += height
        return q

    world = load(
        folder / "robots" / "talos_reduced.urdf",
        floating_base=True,
        ground=True,
        material=material,
        ground_material=material,
        self_collision=self_collision,
        srdf=srdf_file,
        exclude_overlapping=pose,
    )
    return Start(world, pose(world), np.zeros(world.num_v))


def cassie(height: float = 0.02, *, friction: float = 0.8) -> Start:
    """The biped Cassie, its four loops closed, standing, its lowest point `height` above the ground [m], unactuated: it
    drops and folds up.

    What collides are the hulls of its visual meshes; links whose hulls overlap at the start never touch.
    """
    from signorini._world import WorldBuilder
    from signorini.load import exclude_overlapping_pairs, sdf, srdf
    from signorini.load._options import Options

    _check(height=(height, 0.0, 1e3), friction=(friction, 0.0, 1e3))
    folder = robots_folder() / "cassie_description"
    robot = sdf.read(folder / "robots" / "cassie_v2.sdf")
    robot.collide_as_seen()
    material = _material(friction)
    builder = WorldBuilder()
    added = robot.add(builder, Options(material=material))
    builder.add_ground(material)
    world = builder.build()
    state = srdf.read(folder / "srdf" / "cassie_v2.srdf").states["standing"]
    q = world.closed_configuration(srdf.configuration(world, state))
    root = world.q_slice("root_joint")
    q[root] = [0.0, 0.0, q[root][2], 0.0, 0.0, 0.0, 1.0]
    exclude_overlapping_pairs(builder, world, [added], [q])
    ground = world.geometry_index("ground")
    q[root][2] += height - min(distance for a, b, distance in world.touching_pairs(q, 1.0) if ground in (a, b))
    world = builder.build()
    return Start(world, q, np.zeros(world.num_v))


def ur5(q: npt.ArrayLike = (0.0, -0.3, 0.4, 0.0, 0.5, 0.0), *, ground: bool = False) -> Start:
    """The arm UR5, fixed, convex hulls of its meshes, self-collision on, unactuated: it swings.

    q: (6,) where it starts [rad], within its limits and apart from itself and the ground.
    """
    from signorini.load import load

    start = _arrays.vector("q", q, 6).copy()
    world = load(robots_folder() / "ur_description" / "urdf" / "ur5_robot.urdf", ground=bool(ground))
    for k, joint in enumerate(world.joints):
        if not joint.lower <= start[k] <= joint.upper:
            limits = f"[{joint.lower:g}, {joint.upper:g}]"
            raise InvalidInputError(f"q: is {start[k]} at {joint.name!r}, must be in {limits}")
    _check_apart("q", start, world, start)
    return Start(world, start, np.zeros(world.num_v))


def ur5_wall(stiffness: float = math.inf, damping: float = 0.0, friction: float = 0.5) -> Start:
    """The arm UR5 with a ball of 2 cm as its tool, which touches a wall that faces the robot; elbow up, tool level.

    stiffness [N/m], damping [N s/m] of the wall: math.inf, rigid. The contact is that of the geometries "tool", "wall".
    """
    from signorini._world import HalfSpace, Material, Sphere, WorldBuilder
    from signorini.load import add_file

    _check(stiffness=(stiffness, 1e-3, math.inf), damping=(damping, 0.0, 1e9), friction=(friction, 0.0, 1e3))
    material = Material(friction=friction, stiffness=stiffness, damping=damping)
    builder = WorldBuilder()
    add_file(builder, robots_folder() / "ur_description" / "urdf" / "ur5_robot.urdf")
    radius = 0.02
    builder.add_body("tool", parent="ee_link", position=(0.03, 0.0, 0.0), mass=0.1, inertia=1.6e-5 * np.eye(3))
    builder.add_geometry("tool", Sphere(radius), material=material, name="tool")
    q = np.array([-0.2, -1.3, 1.8, -0.5, 0.5 * math.pi, 0.0])
    front = builder.build().body_placement("tool", q)[0][0] + radius
    half = math.sqrt(0.5)
    toward_robot = (0.0, -half, 0.0, half)
    builder.add_geometry(
        "world", HalfSpace(), position=(front, 0.0, 0.0), orientation=toward_robot, material=material, name="wall"
    )
    return Start(builder.build(), q, np.zeros(6))


def talos_wall(friction: float = 0.8) -> Start:
    """The humanoid Talos stands, and its right hand just touches a wall in front of it.

    Plates of 20 cm x 12 cm under the feet (geometries "sole-left" and "sole-right"): the meshes of the soles are uneven
    by a millimetre. All gaps are 0 to rounding.
    """
    from signorini.load import srdf

    _check(friction=(friction, 0.0, 1e3))
    world = _talos_before_wall(1.0, friction)
    state = srdf.read(robots_folder() / "talos_data" / "srdf" / "talos.srdf").states["half_sitting"]
    q = srdf.configuration(world, state)
    for name, angle in (("arm_right_1_joint", 0.0), ("arm_right_4_joint", -1.7)):
        q[world.q_slice(name)] = angle
    for side in ("left", "right"):  # ankles, until the soles are level
        ankle = [world.joint(f"leg_{side}_{k}_joint") for k in (5, 6)]
        for _ in range(10):
            up = world.body_placement(f"leg_{side}_6_link", q)[1][:, 2]
            turning = world.jacobian(q, f"leg_{side}_6_link")[3:5, [joint.v_index for joint in ankle]]
            q[[joint.q_index for joint in ankle]] += np.linalg.solve(turning, np.cross(up, [0.0, 0.0, 1.0])[:2])
    q[world.q_slice("root_joint")][2] += _SOLE - world.body_placement("leg_left_6_link", q)[0][2]
    wall = world.geometry_index("wall")
    gap = min(distance for a, b, distance in world.touching_pairs(q, 1.0) if wall in (a, b))
    world = _talos_before_wall(1.0 - gap, friction)
    return Start(world, q, np.zeros(world.num_v))


_SOLE = 0.11  # [m] from the ankle down, 3 mm below the mesh


def _talos_before_wall(front: float, friction: float) -> World:
    from signorini._world import HalfSpace, WorldBuilder
    from signorini.load import add_file

    folder = robots_folder() / "talos_data"
    material = _material(friction)
    builder = WorldBuilder()
    add_file(
        builder,
        folder / "robots" / "talos_reduced.urdf",
        floating_base=True,
        material=material,
        srdf=folder / "srdf" / "talos.srdf",
    )
    for side in ("left", "right"):
        foot, plate = f"leg_{side}_6_link", _box(0.2, 0.12, 0.01)
        builder.add_geometry(foot, plate, position=(0, 0, 0.005 - _SOLE), material=material, name=f"sole-{side}")
    builder.add_ground(material)
    half = math.sqrt(0.5)
    faces_back = (0.0, -half, 0.0, half)
    builder.add_geometry(
        "world", HalfSpace(), position=(front, 0, 0), orientation=faces_back, material=material, name="wall"
    )
    return builder.build()


def robots_folder() -> Path:
    """Where the package example-robot-data keeps its robots. Raises FileNotFoundError naming the extra to install."""
    candidates = [
        Path(sysconfig.get_path(key)) / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
        for key in ("purelib", "platlib")
    ]
    spec = importlib.util.find_spec("pinocchio")  # where else such wheels may be
    if spec is not None and spec.origin is not None:
        candidates += [p / "share" / "example-robot-data" / "robots" for p in Path(spec.origin).parents]
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise FileNotFoundError("robot files of the package example-robot-data: pip install 'signorini[robots]'")


def gymnasium_file(name: str) -> Path:
    """A file of gymnasium's MuJoCo environments, without importing gymnasium."""
    spec = importlib.util.find_spec("gymnasium")
    if spec is not None and spec.origin is not None:
        path = Path(spec.origin).parent / "envs" / "mujoco" / "assets" / name
        if path.is_file():
            return path
    raise FileNotFoundError(f"{name} of the package gymnasium: pip install 'signorini[robots]'")


# Pieces


def _check_type(option: str, value: Any, default: Any) -> None:
    if isinstance(default, bool):
        if not isinstance(value, (bool, np.bool_, int)) or value not in (0, 1):
            raise InvalidInputError(f"{option}: is {value!r}, must be 0 or 1")
    elif isinstance(default, int):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
            raise InvalidInputError(f"{option}: is {value!r}, must be an integer")
    elif isinstance(default, float) or (value is not None and default is None):
        _arrays.number(option, value)


def _check(**options: tuple[float, float, float]) -> None:
    for name, (value, lower, upper) in options.items():
        if not lower <= value <= upper:
            raise InvalidInputError(f"{name}: is {value}, must be in [{lower:g}, {upper:g}]")


def _check_apart(option: str, value: Any, world: World, q: Array) -> None:
    """The option's value leads to a configuration in which nothing overlaps."""
    a, b, distance = min(world.touching_pairs(q), key=lambda pair: pair[2], default=(0, 0, 0.0))
    if distance < -1e-6:
        names = f"{world.geometry_names[a]!r} and {world.geometry_names[b]!r}"
        raise InvalidInputError(f"{option}: is {value}, {names} overlap by {-1e3 * distance:.3g} mm, must be apart")


def _material(friction: float) -> Material:
    from signorini._world import Material

    return Material(friction=friction)


def _box(x: float, y: float, z: float) -> Shape:
    from signorini._world import Box

    return Box((0.5 * x, 0.5 * y, 0.5 * z))


def _sphere(radius: float) -> Shape:
    from signorini._world import Sphere

    return Sphere(radius)


def _builder() -> WorldBuilder:
    from signorini._world import WorldBuilder

    return WorldBuilder()


def _add_free(
    builder: WorldBuilder,
    name: str,
    shape: Shape,
    mass: float,
    inertia: Array,
    position: npt.ArrayLike,
    material: Material,
    orientation: npt.ArrayLike = (0.0, 0.0, 0.0, 1.0),
) -> None:
    """A body with a free joint and one geometry, all called the same."""
    from signorini._world import Joint

    joints = [Joint(name, "free")]
    builder.add_body(name, position=position, orientation=orientation, joints=joints, mass=mass, inertia=inertia)
    builder.add_geometry(name, shape, material=material, name=name)


def _granular(size: int, seed: int, density: float, friction: float, **lengths: float) -> np.random.Generator:
    _check(size=(size, 1, 100_000), density=(density, 1e-3, 1e5), friction=(friction, 0.0, 1e3), seed=(seed, 0, 2**63))
    _check(**{name: (length, 1e-4, 50.0) for name, length in lengths.items()})
    return np.random.default_rng(seed)


def _bin(
    size: int, radius: float, friction: float, random: np.random.Generator
) -> tuple[WorldBuilder, Material, Array, Array]:
    """Ground and four walls; places (size, 3) where balls of this radius are apart from each other and from the walls;
    slow velocities (size, 3)."""
    from signorini._world import HalfSpace

    spacing = 2.1 * radius
    per_side = max(1, round(size ** (1.0 / 3.0)))
    half_width = 0.5 * spacing * per_side
    index = np.arange(size)
    layer, rest = np.divmod(index, per_side**2)
    row, column = np.divmod(rest, per_side)
    places = spacing * np.stack([column + 0.5, row + 0.5, layer + 0.5], axis=1).astype(np.float64)
    places[:, :2] -= half_width
    places += 0.04 * radius * random.uniform(-1.0, 1.0, (size, 3))
    material = _material(friction)
    builder = _builder()
    builder.add_ground(material)
    s = math.sqrt(0.5)
    for name, position, orientation in (  # the normal points into the bin
        ("wall-west", (-half_width, 0.0, 0.0), (0.0, s, 0.0, s)),
        ("wall-east", (half_width, 0.0, 0.0), (0.0, -s, 0.0, s)),
        ("wall-south", (0.0, -half_width, 0.0), (-s, 0.0, 0.0, s)),
        ("wall-north", (0.0, half_width, 0.0), (s, 0.0, 0.0, s)),
    ):
        builder.add_geometry(
            "world", HalfSpace(), position=position, orientation=orientation, material=material, name=name
        )
    return builder, material, places, 0.1 * random.standard_normal((size, 3))


def _at_rest_but(world: World, linear: Array) -> Start:
    """With these linear velocities (n, 3) of the free bodies, in their own axes."""
    v = np.zeros((len(linear), 6))
    v[:, :3] = linear
    return Start(world, world.initial_q, v.ravel())


_SCENES = (
    WorldScene(
        "cube-stack",
        "15 cubes on each other, 1 kg at the bottom, 10 t on top",
        10.0,
        f"{PAPER}, Fig. 1",
        cube_stack,
    ),
    WorldScene("humanoid", "capsule humanoid, dropped", 2.0, f"{PAPER}, Fig. 6; robot of gymnasium", humanoid),
    WorldScene(
        "talos-fall", "humanoid Talos falls unactuated", 2.0, f"{PAPER}, Fig. 4-6; example-robot-data", talos_fall
    ),
    WorldScene(
        "cassie", "biped Cassie drops unactuated, loops closed", 2.0, f"{PAPER}, Fig. 6; example-robot-data", cassie
    ),
    WorldScene("ur5", "arm swings unactuated, self-collision on", 2.0, f"{PAPER}, Fig. 6; example-robot-data", ur5),
    WorldScene("ur5-wall", "arm, its tool at a wall", 2.0, f"{PAPER}, Fig. 8; example-robot-data", ur5_wall),
    WorldScene("talos-wall", "humanoid Talos stands, a hand at a wall", 2.0, "example-robot-data", talos_wall),
    WorldScene(
        "solo-terrain",
        "quadruped Solo12 walks up a slope under model-predictive control",
        15.0,
        "example-robot-data; Di Carlo et al. 2018",
        solo_terrain,
        solo_controller,
    ),
    WorldScene("spheres", "spheres poured into a bin", 2.0, "built in", spheres),
    WorldScene("boxes", "boxes tipped into a bin", 2.0, "built in", boxes),
)
