"""Worlds of many simple bodies: a wall and a ball, capsules in a bin, a chain, a cable; the same ones for one seed."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini.scenes._worlds import (
    Array,
    Start,
    WorldScene,
    _add_free,
    _at_rest_but,
    _bin,
    _box,
    _builder,
    _check,
    _granular,
    _material,
    _sphere,
)

if TYPE_CHECKING:
    from signorini._world import Shape

BALL_DENSITY = 7850.0  # steel [kg/m^3]


def cube_wall(
    rows: int = 5,
    columns: int = 3,
    mass_ratio: float = 1e4,
    seed: int = 0,
    *,
    ball_mass: float = 1e3,
    speed: float = 20.0,
    edge: float = 0.2,
    gap: float = 1e-3,
    friction: float = 0.8,
) -> Start:
    """A wall of boxes 2 edge long, edge wide and high, every other row shifted by half a box, hit by a ball of steel.

    rows, columns: of boxes; shifted rows end in cubes. mass_ratio: masses are 1 to mass_ratio kg, geometric, dealt out
    over the wall by seed. ball_mass [kg]: flies along +y at the middle of the wall from 0.1 m before it, at `speed`
    [m/s]; 0: no ball. edge, gap between neighbours in a row [m]. friction: of all. The wall lies along x.

    Raises InvalidInputError naming the option and what is allowed.
    """
    _check(rows=(rows, 1, 100), columns=(columns, 1, 100), mass_ratio=(mass_ratio, 1e-12, 1e12), seed=(seed, 0, 2**63))
    if ball_mass != 0.0 and not 1e-9 <= ball_mass <= 1e9:
        raise InvalidInputError(f"ball_mass: is {ball_mass}, must be 0, or in [1e-9, 1e9]")
    _check(speed=(speed, -1e3, 1e3), friction=(friction, 0.0, 1e3))
    _check(edge=(edge, 1e-4, 40.0), gap=(gap, 0.0, 0.5 * edge))
    spans = []  # (middle, length, row)
    for row in range(rows):
        ends = 2.0 * edge * np.arange(columns + 1)
        if row % 2 == 1:
            ends = np.concatenate([[0.0], ends[:-1] + edge, [ends[-1]]])
        spans += [(0.5 * (left + right), right - left - gap, row) for left, right in pairwise(ends)]
    masses = np.random.default_rng(seed).permutation(np.geomspace(1.0, mass_ratio, len(spans)))
    material = _material(friction)
    builder = _builder()
    builder.add_ground(material)
    for i, (middle, length, row) in enumerate(spans):
        size = np.array([length, edge, edge])
        position = (middle - edge * columns, 0.0, edge * (row + 0.5))
        inertia = _box_inertia(masses[i], size)
        _add_free(builder, f"box-{i}", _box(*size), masses[i], inertia, position, material)
    if ball_mass > 0.0:
        radius = (ball_mass / BALL_DENSITY * 0.75 / math.pi) ** (1.0 / 3.0)
        position = (0.0, -0.5 * edge - 0.1 - radius, max(0.5 * edge * rows, radius))
        inertia = 0.4 * ball_mass * radius**2 * np.eye(3)
        _add_free(builder, "ball", _sphere(radius), ball_mass, inertia, position, material)
    world = builder.build()
    v = np.zeros(world.num_v)
    if ball_mass > 0.0:
        v[world.v_slice("ball")][1] = speed
    return Start(world, world.initial_q, v)


def capsules_box(
    size: int = 100,
    seed: int = 0,
    *,
    radius: float = 0.03,
    length: float = 0.12,
    density: float = 1000.0,
    friction: float = 0.7,
) -> Start:
    """Capsules poured into a bin: as `spheres`, with random orientations.

    radius, length: of the caps, and of the axis between their centres [m], each within 20 %.
    """
    random = _granular(size, seed, density, friction, radius=radius, length=length)
    radii = radius * random.uniform(0.8, 1.2, size)
    lengths = length * random.uniform(0.8, 1.2, size)
    builder, material, places, v = _bin(size, 1.25 * radius + 0.61 * length, friction, random)
    orientations = random.standard_normal((size, 4))
    orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
    for i in range(size):
        mass, inertia = _capsule_inertia(density, radii[i], lengths[i])
        shape = _capsule(radii[i], lengths[i])
        _add_free(builder, f"capsule-{i}", shape, mass, inertia, places[i], material, orientations[i])
    return _at_rest_but(builder.build(), v)


def chain(
    size: int = 11, mass_ratio: float = 1.0, *, speed: float = 1.0, wire: float = 0.005, friction: float = 0.3
) -> Start:
    """A hanging chain: links of wire, each turned by a right angle, held by contact alone; the first one is fixed.

    size: links, the fixed one included, 2 to 10 000. mass_ratio: the last link over the second, which has 0.02 kg;
    geometric between. speed: of the lower end at the start [m/s]; the chain turns about its upper end, straight, about
    the x axis. wire: radius [m]; a link is 12 of it long and 8 wide. friction: of all.
    """
    _check(size=(size, 2, 10_000), mass_ratio=(mass_ratio, 1e-12, 1e12), speed=(speed, -1e3, 1e3))
    _check(wire=(wire, 1e-4, 10.0), friction=(friction, 0.0, 1e3))
    from signorini._world import Joint

    half_length, half_width = 5.0 * wire, 3.0 * wire  # of the wire's axis
    pitch = 2.0 * half_length - 2.0 * wire
    material = _material(friction)
    builder = _builder()
    masses = 0.02 * np.geomspace(1.0, mass_ratio, size - 1) if size > 2 else np.array([0.02])
    s = math.sqrt(0.5)
    upright, along_y = (0.0, 0.0, 0.0, 1.0), (-s, 0.0, 0.0, s)
    # Four wires, in proportion to their length, and their moments about the middle
    share = np.array([half_length, half_width]) / (2.0 * (half_length + half_width))
    unit = np.zeros((3, 3))
    for weight, direction, offset in (
        (share[0], (0.0, 0.0, half_length), (0.0, half_width, 0.0)),
        (share[1], (0.0, half_width, 0.0), (0.0, 0.0, half_length)),
    ):
        for axis in range(3):
            across = np.eye(3)[axis]
            d = np.linalg.norm(np.cross(across, direction))
            o = np.linalg.norm(np.cross(across, offset))
            unit[axis, axis] += 2.0 * weight * (d**2 / 3.0 + o**2)
    for i in range(size):
        turned = (0.0, 0.0, s, s) if i % 2 == 1 else upright
        centre = (0.0, 0.0, -pitch * i)
        if i == 0:
            builder.add_body("link-0", position=centre, orientation=turned)
        else:
            joints = [Joint(f"link-{i}", "free")]
            mass = masses[i - 1]
            builder.add_body(
                f"link-{i}", position=centre, orientation=turned, joints=joints, mass=mass, inertia=mass * unit
            )
        for k, (position, orientation, length) in enumerate(
            (
                ((0.0, half_width, 0.0), upright, half_length),
                ((0.0, -half_width, 0.0), upright, half_length),
                ((0.0, 0.0, half_length), along_y, half_width),
                ((0.0, 0.0, -half_length), along_y, half_width),
            )
        ):
            builder.add_geometry(
                f"link-{i}",
                _capsule(wire, 2.0 * length),
                position=position,
                orientation=orientation,
                material=material,
                name=f"link-{i}-{k}",
            )
    world = builder.build()
    v = np.zeros((size - 1, 6))
    pivot = -half_length
    rate = np.array([speed / (pitch * (size - 1) + pivot), 0.0, 0.0])
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # of the odd links
    for i in range(1, size):
        rotation = quarter if i % 2 == 1 else np.eye(3)
        v[i - 1, :3] = rotation.T @ np.cross(rate, [0.0, 0.0, -pitch * i - pivot])
        v[i - 1, 3:] = rotation.T @ rate
    return Start(world, world.initial_q, v.ravel())


def cable(
    size: int = 20, mass_ratio: float = 100.0, *, angle: float = 0.5, pitch: float = 0.1, friction: float = 0.5
) -> Start:
    """A cable of capsules that hold each other end to end by constraints, a heavy ball at the end; it swings.

    size: capsules, 1 to 10 000. mass_ratio: the ball over one capsule of 0.1 kg. angle: of the straight cable from the
    vertical at the start [rad]. pitch: from one end of a capsule to the next [m]. friction: of all.

    Short links under tension vibrate fast: the time step must be below about sqrt(pitch m / (12 tension)), m of a link.
    """
    _check(size=(size, 1, 10_000), mass_ratio=(mass_ratio, 1e-12, 1e12), angle=(angle, -math.pi, math.pi))
    _check(pitch=(pitch, 1e-3, 1e3), friction=(friction, 0.0, 1e3))
    radius = 0.15 * pitch
    material = _material(friction)
    builder = _builder()
    down = np.array([math.sin(angle), 0.0, -math.cos(angle)])
    orientation = (0.0, -math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle))
    mass = 0.1
    unit, inertia = _capsule_inertia(1.0, radius, pitch)
    inertia *= mass / unit
    above = "world"
    for i in range(size):
        centre = (i + 0.5) * pitch * down
        name = f"capsule-{i}"
        _add_free(builder, name, _capsule(radius, pitch), mass, inertia, centre, material, orientation)
        low = (0.0, 0.0, 0.0) if i == 0 else (0.0, 0.0, -0.5 * pitch)
        builder.add_connect(above, name, low, (0.0, 0.0, 0.5 * pitch), name=f"end-{i}")
        if i > 0:
            builder.exclude(above, name)
        above = name
    heavy = mass_ratio * mass
    ball = (heavy / BALL_DENSITY * 0.75 / math.pi) ** (1.0 / 3.0)
    _add_free(
        builder,
        "ball",
        _sphere(ball),
        heavy,
        0.4 * heavy * ball**2 * np.eye(3),
        (size * pitch + ball) * down,
        material,
        orientation,
    )
    builder.add_connect(above, "ball", (0.0, 0.0, -0.5 * pitch), (0.0, 0.0, ball), name="hook")
    builder.exclude(above, "ball")
    world = builder.build()
    return Start(world, world.initial_q, np.zeros(world.num_v))


# Pieces


def _capsule(radius: float, length: float) -> Shape:
    from signorini._world import Capsule

    return Capsule(radius, 0.5 * length)


def _box_inertia(mass: float, size: npt.ArrayLike) -> Array:
    squares = np.asarray(size, dtype=np.float64) ** 2
    return np.asarray(mass / 12.0 * np.diag(squares.sum() - squares))


def _capsule_inertia(density: float, radius: float, length: float) -> tuple[float, Array]:
    """Mass and inertia (3, 3) of a solid capsule along z; length: between the centres of its caps [m]."""
    cylinder = density * math.pi * radius**2 * length
    caps = density * 4.0 / 3.0 * math.pi * radius**3
    along = 0.5 * cylinder * radius**2 + 0.4 * caps * radius**2
    across = cylinder * (0.25 * radius**2 + length**2 / 12.0)
    across += caps * (0.4 * radius**2 + 0.25 * length**2 + 0.375 * length * radius)
    return cylinder + caps, np.diag([across, across, along])


BLOCKS = (
    WorldScene("cube-wall", "a wall of boxes of 1 to 1e4 kg, hit by a ball of 1e3 kg", 3.0, "built in", cube_wall),
    WorldScene("capsules-box", "capsules poured into a bin", 2.0, "built in", capsules_box),
    WorldScene("chain", "a chain of wire links swings, held by contact alone", 2.0, "built in", chain),
    WorldScene("cable", "a cable of capsules, end to end, swings a heavy ball", 2.0, "built in", cable),
)
