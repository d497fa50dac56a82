"""The hand Allegro and cubes: it holds a stack by its fingertips, or turns one cube between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from signorini import _arrays
from signorini._core import InvalidInputError
from signorini.scenes._worlds import (
    PAPER,
    Array,
    Start,
    WorldScene,
    _add_free,
    _box,
    _builder,
    _check,
    _material,
    robots_folder,
)

if TYPE_CHECKING:
    from signorini._simulation import Simulator
    from signorini._world import World

HOLD, ROLL = 0, 1
NUM_CUBES = {HOLD: 3, ROLL: 1}
EDGE, MASS = 0.05, 0.05  # of a cube [m, kg]
SQUEEZE = 4.0  # of the thumb; the fingers share it [N]
HEIGHT = 0.15  # of the palm's frame [m]; the palm's surface is 11 mm above it
CENTRE = np.array([0.02, -0.021, HEIGHT + 0.06])  # of the lowest cube, above the palm's edge [m]
TIP = 0.012  # radius of a fingertip [m]
TURN, PERIOD = 0.7, 2.5  # of the cube that is turned to and fro about y: amplitude [rad], period [s]
STIFFNESS, DAMPING = 5.0, 0.1  # of the drives [N m/rad, N m s/rad]
# Where a finger holds the lowest cube, by its last link: place of the contact in half edges, joints to search from
_GRIPS = {
    "link_3.0_tip": ((1.0, -0.68, 0.0), (-0.17, 0.3, 0.87, 1.61)),
    "link_7.0_tip": ((1.0, 0.68, 0.0), (0.07, 0.3, 0.91, 1.62)),
    "link_15.0_tip": ((-1.0, 0.0, 0.0), (1.13, 0.48, 0.65, 1.64)),
}


def allegro_cubes(
    task: int = HOLD,
    num_cubes: int | None = None,
    *,
    edge: float = EDGE,
    mass: float = MASS,
    friction: float = 1.0,
    squeeze: float = SQUEEZE,
) -> Start:
    """The hand Allegro, palm up, holds the lowest cube of a stack between thumb, index and middle finger.

    task: 0: it holds still; 1: it turns the cube to and fro. num_cubes: on each other; None: 3 to hold, 1 to turn.
    edge, mass: of a cube [m, kg]. friction: of all. squeeze: force of the thumb; the fingers share it [N].

    Drives are servos, limited by the efforts in the robot's file. Its dampers (3 to 10 N m s/rad) and dry friction (5
    to 12 N m) are left out, since they alone would hold fifty cubes; joints are damped by 0.1 N m s/rad.

    Raises InvalidInputError naming the option and what is allowed.
    """
    if task not in NUM_CUBES:
        raise InvalidInputError(f"task: is {task}, must be 0 (hold) or 1 (turn)")
    _check(edge=(edge, 0.04, 0.055), mass=(mass, 1e-6, 1e3), squeeze=(squeeze, 0.0, 100.0))
    num_cubes = NUM_CUBES[task] if num_cubes is None else _arrays.count("num_cubes", num_cubes)
    _check(num_cubes=(num_cubes, 1, 100), friction=(friction, 0.0, 1e3))
    from signorini.load import exclude_overlapping_pairs, urdf
    from signorini.load._options import Options
    from signorini.load._placement import Placement

    material = _material(friction)
    builder = _builder()
    builder.add_ground(material)
    robot = urdf.read(robots_folder() / "allegro_hand_description" / "urdf" / "allegro_right_hand.urdf")
    for joint in robot.joints:
        joint.damping, joint.friction = DAMPING, 0.0
    palm_up = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # fingers along x
    placement = Placement(palm_up, np.array([0.0, 0.0, HEIGHT]))
    added = robot.add(builder, Options(placement=placement, material=material, motors=False))
    for joint in robot.joints:
        if joint.type == "revolute":
            limit = (-joint.effort, joint.effort)
            builder.add_position_actuator(joint.name, joint.name, kp=STIFFNESS, force_range=limit)
    for i in range(num_cubes):
        position = CENTRE + [0.0, 0.0, i * edge]
        _add_free(
            builder, f"cube-{i}", _box(edge, edge, edge), mass, mass * edge**2 / 6.0 * np.eye(3), position, material
        )
    world = builder.build()
    q = _posture(world, edge)
    if exclude_overlapping_pairs(builder, world, [added], [q]):
        world = builder.build()
    return Start(world, q, np.zeros(world.num_v))


def drive(simulator: Simulator, start: Start, options: dict[str, Any]) -> Callable[[], None]:
    """What sets the targets of the drives before every step: a planned grip that carries the cubes and the hand."""
    world = start.world
    given = {"task": HOLD, "edge": EDGE, "mass": MASS, "squeeze": SQUEEZE} | options
    turns, edge = given["task"] == ROLL, given["edge"]
    num_cubes = given.get("num_cubes") or NUM_CUBES[given["task"]]
    weight = num_cubes * given["mass"] * -world.gravity
    angles = np.linspace(-TURN, TURN, 49) if turns else np.zeros(1)
    middle = len(angles) // 2
    targets = np.zeros((len(angles), world.num_controls))
    for order in (range(middle, len(angles)), range(middle - 1, -1, -1)):
        q = start.q
        for k in order:
            q = _rolled(world, start.q, q, edge, angles[k])
            targets[k] = _targets(world, q, angles[k], given["squeeze"], weight)

    def control() -> None:
        time = simulator.state.time
        angle = TURN * min(1.0, time) * math.sin(2.0 * math.pi * time / PERIOD) if turns else 0.0
        for joint in range(world.num_controls):
            simulator.control[joint] = np.interp(angle, angles, targets[:, joint])

    return control


def _posture(world: World, edge: float) -> Array:
    """q (nq,) with the fingers at the lowest cube and the ring finger stretched."""
    q = world.initial_q
    for tip, (_, values) in _GRIPS.items():
        q[_finger(world, tip)] = values
    return _grip(world, q, edge, 0.0)


def _finger(world: World, tip: str) -> slice:
    """Of the four joints of a finger in q, v and control."""
    last = int(tip.removeprefix("link_").removesuffix(".0_tip"))
    first = world.joint(f"joint_{last - 3}.0").q_index
    return slice(first, first + 4)


def _turn(angle: float) -> Array:
    """(3, 3): about y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _rolled(world: World, start: Array, q: Array, edge: float, angle: float) -> Array:
    """q (nq,) with the fingertips at a cube turned about y by `angle` [rad], on which they rolled from `start`."""
    shift = dict.fromkeys(_GRIPS, 0.0)
    for _ in range(20):
        q = _grip(world, q, edge, angle, shift)
        for tip, (place, _) in _GRIPS.items():
            turned = world.body_placement(tip, q)[1] @ world.body_placement(tip, start)[1].T
            about_y = math.atan2(turned[0, 2] - turned[2, 0], turned[0, 0] + turned[2, 2])
            shift[tip] = -math.copysign(TIP, place[0]) * (about_y - angle)
    return q


def _grip(world: World, q: Array, edge: float, angle: float, shift: dict[str, float] | None = None) -> Array:
    """q (nq,) with the fingertips at a cube turned about y by `angle` [rad], found from q by Newton steps.

    shift: of the tips along the turned cube's z [m]."""
    q = q.copy()
    lower, upper = (np.array([getattr(joint, key) for joint in world.joints[:16]]) for key in ("lower", "upper"))
    for tip, (place, _) in _GRIPS.items():
        local = 0.5 * edge * np.array(place)
        local[0] += math.copysign(TIP, local[0])
        local[2] += shift[tip] if shift else 0.0
        target = CENTRE + _turn(angle) @ local
        joints = _finger(world, tip)
        for _ in range(100):
            error = target - world.body_placement(tip, q)[0]
            if np.abs(error).max() < 1e-9:
                break
            jacobian = world.jacobian(q, tip)[:3, joints]
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-9 * np.eye(3), error)
            q[joints] = np.clip(q[joints] + np.clip(step, -0.2, 0.2), lower[joints], upper[joints])
        else:
            raise InvalidInputError(f"edge: is {edge}, a cube of it is out of reach of {tip}")
    return q


def _targets(world: World, q: Array, angle: float, squeeze: float, weight: Array) -> Array:
    """Of the drives (16,), so that at q they carry the hand and a weight (3,) [N] and press the tips on the cube."""
    torque = np.zeros(world.num_v)
    for body in world.bodies[1:]:
        if body.mass > 0.0 and not body.name.startswith("cube"):
            torque -= body.mass * world.gravity @ world.jacobian(q, body.name, body.center)[:3]
    for tip, (place, _) in _GRIPS.items():
        share = 0.5 if place[0] < 0.0 else 0.25
        force = share * (weight - 2.0 * squeeze * np.sign(place[0]) * _turn(angle)[:, 0])
        torque += force @ world.jacobian(q, tip)[:3]
    return np.asarray(q[:16] + torque[:16] / STIFFNESS)


HAND = (
    WorldScene(
        "allegro-cubes",
        "hand Allegro holds a stack of cubes by its fingertips; task=1: turns one",
        5.0,
        f"{PAPER}, Fig. 3, 5; example-robot-data",
        allegro_cubes,
        drive,
    ),
)
