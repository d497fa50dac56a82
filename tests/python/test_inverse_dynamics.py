"""Inverse dynamics of a step: closed forms, Pinocchio, and back through the Simulator."""

import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.optimize import minimize
from test_physics import G, _close_three_bars, add_box, add_sphere, pendulum

from signorini import (
    Box,
    InvalidInputError,
    InverseDynamics,
    Joint,
    Material,
    Simulator,
    SimulatorSettings,
    Sphere,
    World,
    WorldBuilder,
    inverse_dynamics,
    scenes,
)

DT = 1e-3


def stepped(world, q, v, force, dt=DT, *, control=None, wrench=None, tolerance=1e-12, **settings):
    """A simulator that made one step."""
    simulator = Simulator(world, time_step=dt, tolerance=tolerance, **settings)
    simulator.state.q, simulator.state.v, simulator.applied_force = q, v, force
    if control is not None:
        simulator.control = control
    for body, values in (wrench or {}).items():
        simulator.set_external_wrench(body, values[:3], values[3:])
    simulator.step()
    return simulator


def off(world, v, wanted, dt=DT):
    """By how much v misses what was wanted, over the speed or that of a fall."""
    return np.abs(v - wanted).max() / max(np.abs(wanted).max(), dt * max(G, np.linalg.norm(world.gravity)))


def check_round_trip(world, q, v, v_next, guess=None, dt=DT, law="ncp", *, control=None, wrench=None, within=1e-10):
    """Inverse, then the step with what it says; returns both."""
    result = inverse_dynamics(
        world, (q, v), v_next, dt, guess, law, control=control, external_wrench=wrench, tolerance=1e-10
    )
    assert result.solved, result
    assert result.relative <= 1e-10
    assert result.v_next == pytest.approx(v_next, abs=0)
    back = stepped(world, q, v, result.force, dt, control=control, wrench=wrench, law=law)
    assert off(world, back.state.v, v_next, dt) <= within
    return result, back


# A box on the ground.

MASS, HALF, MU = 2.0, 0.1, 0.5


def box_world(material=None, height=HALF, **ground):
    builder = WorldBuilder()
    builder.add_ground(Material(friction=MU, **ground))
    add_box(builder, "box", MASS, (HALF, HALF, HALF), (0.0, 0.0, height), material or Material(friction=MU))
    return builder.build()


def pressed(contacts, impulses):
    """Normal impulses as a guess."""
    guess = np.zeros((len(contacts), 3))
    guess[:, 2] = impulses
    return guess


def test_a_box_at_rest_needs_nothing_when_the_ground_carries_it():
    world = box_world()
    contacts = InverseDynamics(world).contacts(world.initial_q)
    assert len(contacts) == 4
    guess = pressed(contacts, MASS * G * DT / 4)
    result = inverse_dynamics(world, (world.initial_q, np.zeros(6)), np.zeros(6), DT, guess)
    assert result.solved
    assert result.residual == pytest.approx(0.0, abs=1e-12)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-9)
    assert result.contact_impulse == pytest.approx(guess, abs=1e-15)
    assert sum(c.force for c in result.contacts) == pytest.approx([0.0, 0.0, MASS * G])
    assert {c.mode for c in result.contacts} == {"stick"}
    alone = inverse_dynamics(world, (world.initial_q, np.zeros(6)), np.zeros(6), DT)
    assert alone.force == pytest.approx([0.0, 0.0, MASS * G, 0.0, 0.0, 0.0], abs=1e-9)  # who else would carry it
    assert not alone.contact_impulse.any()


def test_a_box_dragged_at_constant_speed():
    world = box_world()
    v = np.array([0.6, 0.8, 0.0, 0.0, 0.0, 0.0])
    contacts = InverseDynamics(world).contacts(world.initial_q)
    result, back = check_round_trip(world, world.initial_q, v, v, pressed(contacts, MASS * G * DT / 4))
    friction = -MU * MASS * G * v[:3]
    moment = np.cross([0.0, 0.0, -HALF], friction)
    assert result.force == pytest.approx(-np.r_[friction, moment], abs=1e-9)
    assert sum(c.force for c in result.contacts) == pytest.approx(friction + [0.0, 0.0, MASS * G])
    assert {c.mode for c in result.contacts} == {"slide"}
    assert back.contact_force("world", "box") == pytest.approx(friction + [0.0, 0.0, MASS * G], abs=1e-6)


def test_a_box_that_slides_to_rest_by_itself():
    world = box_world()
    v, v_next = np.zeros(6), np.zeros(6)
    v[0], v_next[0] = 1.0, 1.0 - MU * G * DT
    contacts = InverseDynamics(world).contacts(world.initial_q)
    # Friction below the centre tips the box: the front corners carry more.
    load = np.array([1.0 + MU * HALF / HALF * np.sign(c.position[0]) for c in contacts]) * MASS * G * DT / 4
    result = inverse_dynamics(world, (world.initial_q, v), v_next, DT, pressed(contacts, load))
    assert result.solved
    assert result.force == pytest.approx(np.zeros(6), abs=1e-9)


def test_a_box_in_the_air_falls_for_nothing():
    world = box_world(height=3.0)
    v = np.array([0.3, 0.0, -1.0, 0.0, 0.0, 0.0])
    result = inverse_dynamics(world, (world.initial_q, v), v - DT * np.array([0, 0, G, 0, 0, 0]), DT)
    assert result.solved
    assert not result.contacts
    assert result.contact_impulse.shape == (0, 3)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-9)
    assert (result.worst, result.residual, result.relative) == ("", 0.0, 0.0)


def test_a_box_on_a_soft_ground():
    k, d, depth = 3e3, 40.0, 2e-3
    world = box_world(height=HALF - depth, stiffness=k, damping=d)
    for speed in (0.0, 0.02, -0.05, 0.5):
        v_next = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
        result, _ = check_round_trip(world, world.initial_q, np.zeros(6), v_next)
        spring = max(0.0, k * (depth - DT * speed) - d * speed)  # at the end of the step
        assert result.force[2] == pytest.approx(MASS * (G + speed / DT) - spring, abs=1e-8)
        assert result.contact_impulse[:, 2].sum() == pytest.approx(DT * spring, abs=1e-12)
        guessed = inverse_dynamics(
            world, (world.initial_q, np.zeros(6)), v_next, DT, pressed(result.contacts, 3.0), tolerance=1e-10
        )
        assert guessed.force == pytest.approx(result.force, abs=1e-6)  # nothing is left to a guess but sticking


def test_wanted_motions_into_the_ground_or_away_from_a_held_box():
    world = box_world()
    v_next = np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
    result = inverse_dynamics(world, (world.initial_q, np.zeros(6)), v_next, DT)
    assert result.status == "infeasible"
    assert not result.solved
    assert result.residual == pytest.approx(0.2)
    assert result.worst == "contact of 'ground' and 'box'"
    up = inverse_dynamics(world, (world.initial_q, np.zeros(6)), -v_next, DT)
    assert up.solved
    assert up.force == pytest.approx([0, 0, MASS * (G + 0.2 / DT), 0, 0, 0])


def test_speeds_are_judged_against_that_of_a_fall():
    world = box_world()
    for speed in (1e-9, 1e-6):
        result = inverse_dynamics(world, (world.initial_q, np.zeros(6)), [0.0, 0.0, -speed, 0.0, 0.0, 0.0], DT)
        assert result.residual == pytest.approx(speed)
        assert result.relative == pytest.approx(speed / (G * DT))
        assert result.solved == (speed < 1e-6 * G * DT)


def test_the_relaxation_cannot_drag_a_rigid_box():
    v = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    world = box_world()
    result = inverse_dynamics(world, (world.initial_q, v), v, DT, law="ccp")
    assert result.status == "infeasible"
    assert result.residual >= MU / np.hypot(1.0, MU) * (1 - 1e-6)
    lifts = v + [0.0, 0.0, MU, 0.0, 0.0, 0.0]
    check_round_trip(world, world.initial_q, v, lifts, law="ccp")
    soft = box_world(stiffness=1e4)
    check_round_trip(soft, soft.initial_q, v, v, law="ccp", within=1e-7)


# Free bodies that spin.


def tumbling(seed, gravity=(0.3, -0.2, -9.81)):
    """A body with its centre anywhere, turned."""
    rng = np.random.default_rng(seed)
    builder = WorldBuilder(gravity=gravity)
    inertia = np.diag([0.02, 0.05, 0.06]) + 0.004 * (np.ones((3, 3)) - np.eye(3))
    builder.add_body(
        "stone",
        joints=[Joint("stone", "free")],
        orientation=rng.normal(size=4),
        mass=1.3,
        center=0.2 * rng.normal(size=3),
        inertia=inertia,
    )
    return builder.build()


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("seed", range(4))
def test_a_spinning_body_goes_where_it_should(seed, dt):
    world = tumbling(seed)
    rng = np.random.default_rng(100 + seed)
    for spin in (0.1, 3.0, 20.0):
        v, v_next = rng.normal(size=(2, 6)) * [1, 1, 1, spin, spin, spin]
        result, _ = check_round_trip(world, world.initial_q, v, v_next, dt=dt)
        assert result.torque == pytest.approx(np.zeros(6), abs=0)
        assert result.root_wrench["stone"] == pytest.approx(result.force, abs=0)


@pytest.mark.parametrize("seed", range(4))
def test_a_body_that_spins_freely_needs_nothing(seed):
    world = tumbling(seed)
    v = np.random.default_rng(seed).normal(size=6) * [1, 1, 1, 5, 5, 5]
    free = stepped(world, world.initial_q, v, np.zeros(6))
    result = inverse_dynamics(world, (world.initial_q, v), free.state.v, DT)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-10 / DT)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("turn", [0.29, 0.3, 0.31, 0.6, 1.0, 5.0])
def test_a_body_that_turns_by_radians_in_a_step_needs_nothing(seed, turn):
    world = tumbling(seed)
    spin = np.random.default_rng(seed).normal(size=3)
    v = np.array([1.0, 2.0, 3.0, *(turn / DT * spin / np.linalg.norm(spin))])
    free = stepped(world, world.initial_q, v, np.zeros(6))
    result = inverse_dynamics(world, (world.initial_q, v), free.state.v, DT)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-10 * turn / DT**2)


@pytest.mark.parametrize("turn", [0.31, 1.0])
def test_a_thin_rod_askew_in_its_frame_needs_nothing(turn):
    """Rounding of its momentum is a thousand times as much of its spin about itself."""
    rng = np.random.default_rng(3)
    thin, across = 0.01**2 / 2, 1.0 / 12
    for _ in range(20):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        inertia = axes @ np.diag([thin, across, across]) @ axes.T
        builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
        builder.add_body("rod", joints=[Joint("rod", "free")], mass=1.0, inertia=0.5 * (inertia + inertia.T))
        world = builder.build()
        spin = rng.normal(size=3)
        v = np.array([0.0, 0.0, 0.0, *(turn / DT * spin / np.linalg.norm(spin))])
        free = stepped(world, world.initial_q, v, np.zeros(6))
        result = inverse_dynamics(world, (world.initial_q, v), free.state.v, DT)
        assert result.force == pytest.approx(np.zeros(6), abs=1e-9 * across * turn / DT**2)


def test_a_turn_of_many_radians_in_a_step_is_refused():
    world = tumbling(0)
    v_next = np.array([0.0, 0.0, 0.0, 4e4, 1e4, 2e4])
    with pytest.raises(InvalidInputError, match=r"v_next.*20 rad"):
        inverse_dynamics(world, (world.initial_q, v_next), v_next, 0.1)


# Arms.


def random_inertia(rng):
    a = rng.normal(size=(3, 3))
    spread = 0.02 * (a @ a.T + np.eye(3))  # of the mass, about its centre
    return np.trace(spread) * np.eye(3) - spread


def arm(seed, root=False, *, friction=True, springs=True, actuators=False, num_bodies=5):
    """A tree of joints of all kinds in open space."""
    rng = np.random.default_rng(seed)
    builder = WorldBuilder(gravity=(0.3, -0.2, -9.81))
    names, scalar, balls = ["world"], [], []

    def body(joints):
        names.append(
            builder.add_body(
                f"body{len(names)}",
                parent=names[rng.integers(1, len(names))] if len(names) > 1 else "world",
                position=0.3 * rng.normal(size=3),
                orientation=(0.0, 0.0, 0.0, 1.0) if joints[0].type == "free" else rng.normal(size=4),
                joints=joints,
                mass=0.5 + rng.uniform(),
                center=0.1 * rng.normal(size=3),
                inertia=random_inertia(rng),
            )
        )

    if root:
        body([Joint("root", "free")])
    for i in range(num_bodies):
        kinds = [("revolute",), ("ball",), ("prismatic",), ("revolute", "prismatic"), ("ball", "revolute")][i % 5]
        joints = []
        for kind in kinds:
            own = {"armature": 0.05 * rng.uniform(), "damping": 0.3 * rng.uniform()}
            own["friction"] = 0.2 * rng.uniform() * friction
            if kind != "ball":
                own |= {"stiffness": 5.0 * rng.uniform() * springs, "spring_reference": rng.normal()}
            name = f"{kind}{i}"
            (balls if kind == "ball" else scalar).append(name)
            joints.append(
                Joint(name, kind, axis=tuple(rng.normal(size=3)), anchor=tuple(0.1 * rng.normal(size=3)), **own)
            )
        body(joints)
    if actuators:
        builder.add_motor("motor", scalar[0], gear=2.0)
        builder.add_motor("ball motor", balls[0], component=1, gear=-1.5)
        builder.add_position_actuator("position", scalar[1], kp=50.0, kv=2.0, gear=1.5)
        builder.add_velocity_actuator("velocity", scalar[2], kv=4.0, gear=0.7)
        builder.add_position_actuator("saturated", scalar[3], kp=1e3, gear=1.2, force_range=(-3.0, 3.0))
    return builder.build()


def state_of(world, seed):
    rng = np.random.default_rng(seed + 1000)
    return world.integrate(world.initial_q, 0.5 * rng.normal(size=world.num_v), 1.0), rng.normal(size=world.num_v)


def scalar_joints(world):
    return [joint for joint in world.joints if joint.num_q == 1]


@pytest.mark.parametrize("root", [False, True], ids=["fixed", "floating"])
@pytest.mark.parametrize("seed", range(5))
def test_torques_are_those_of_pinocchio(seed, root):
    pin = pytest.importorskip("pinocchio")
    world = arm(seed, root)
    model = pin.Model()
    model.loadFromString(world.pinocchio_model())
    data = model.createData()
    q, v = state_of(world, seed)
    v_next = v + 0.1 * np.random.default_rng(seed).normal(size=world.num_v)
    then = v_next.copy()
    if root:  # in the frame as it stands at the start (S4), then in the one that moves along (S3)
        then[:3] = pin.exp3(DT * v_next[3:6]) @ v_next[:3]
    a = (then - v) / DT
    if root:
        a[:3] -= np.cross(v[3:6], v[:3])
    expected = pin.rnea(model, data, q, v, a)
    for joint in world.joints:
        rows = slice(joint.v_index, joint.v_index + joint.num_v)
        expected[rows] += joint.damping * v_next[rows] + joint.friction * np.sign(v_next[rows])
        if joint.stiffness > 0.0:  # at the end of the step
            expected[rows] += joint.stiffness * (q[joint.q_index] + DT * v_next[rows] - joint.spring_reference)
    result = inverse_dynamics(world, (q, v), v_next, DT)
    assert result.solved
    assert result.force == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("root", [False, True], ids=["fixed", "floating"])
@pytest.mark.parametrize("seed", range(5))
def test_arms_go_where_they_should(seed, root):
    world = arm(seed, root, actuators=True)
    rng = np.random.default_rng(seed)
    for dt in (1e-4, 1e-3, 1e-2):
        q, v = state_of(world, seed)
        control = rng.normal(size=world.num_controls)
        wrench = {"body2": 3.0 * rng.normal(size=6), "body4": rng.normal(size=6)}
        v_next = v + rng.normal(size=world.num_v)
        check_round_trip(world, q, v, v_next, dt=dt, control=control, wrench=wrench)
        v_next[-2:] = 0.0  # dry friction may hold
        check_round_trip(world, q, v, v_next, dt=dt, control=control, wrench=wrench)


def test_armature_and_a_pendulum_by_hand():
    world = pendulum(1, armature=0.3, damping=0.7, stiffness=2.0, spring_reference=0.4, friction=0.05).build()
    q, v, v_next = 0.3, 0.5, -0.2
    inertia = 1.0 * 0.5**2 / 3 + 0.3
    expected = inertia * (v_next - v) / DT - 1.0 * G * 0.25 * np.cos(q) + 0.7 * v_next - 0.05
    expected += 2.0 * (q + DT * v_next - 0.4)
    result = inverse_dynamics(world, ([q], [v]), [v_next], DT)
    assert result.torque == pytest.approx([expected])
    assert result.root_wrench == {}


def test_dry_friction_holds_as_much_as_the_guess_says():
    world = pendulum(1, friction=5.0).build()
    load = -1.0 * G * 0.25
    held = stepped(world, [0.0], [0.0], [0.0])
    assert held.state.v == pytest.approx([0.0], abs=1e-12)
    result = inverse_dynamics(world, ([0.0], [0.0]), [0.0], DT, held)
    assert result.torque == pytest.approx([0.0], abs=1e-9)
    assert inverse_dynamics(world, ([0.0], [0.0]), [0.0], DT).torque == pytest.approx([load])
    for v_next in (0.2, -0.2):  # moving
        result = inverse_dynamics(world, ([0.0], [0.0]), [v_next], DT, held)
        assert result.torque == pytest.approx([0.5**2 / 3 * v_next / DT + load + 5.0 * np.sign(v_next)])


def test_controls_that_act_are_taken_off():
    world = arm(1, actuators=True)
    q, v = state_of(world, 1)
    v_next = v + 0.3
    without = inverse_dynamics(world, (q, v), v_next, DT)
    control = np.array([0.3, -0.7, 0.2, 0.9, 1.0])
    given = inverse_dynamics(world, (q, v), v_next, DT, control=control)
    expected = np.zeros(world.num_v)
    for actuator, u in zip(world.actuators, control, strict=True):
        joint = world.joints[actuator.joint]
        at = joint.v_index + actuator.component
        if actuator.name in ("motor", "ball motor"):
            effort = u
        elif actuator.name == "position":  # implicit
            x = actuator.gear * (q[joint.q_index] + DT * v_next[at])
            effort = actuator.gain[0] * (u - x) + actuator.bias[2] * actuator.gear * v_next[at]
        elif actuator.name == "velocity":
            effort = actuator.gain[0] * (u - actuator.gear * v_next[at])
        else:
            effort = 3.0 * np.sign(u - actuator.gear * q[joint.q_index])
        expected[at] += actuator.gear * effort
    assert without.force - given.force == pytest.approx(expected, abs=1e-9)


def test_motors_set_to_the_torque_make_the_motion():
    builder = pendulum(3)
    gears = (2.0, -1.0, 0.5)
    for i, gear in enumerate(gears):
        builder.add_motor(f"motor{i}", f"hinge{i}", gear=gear)
    world = builder.build()
    q, v, v_next = np.array([0.3, -0.5, 1.0]), np.array([1.0, -2.0, 0.5]), np.array([1.2, -1.7, 0.1])
    result = inverse_dynamics(world, (q, v), v_next, DT)
    simulator = stepped(world, q, v, np.zeros(3), control=result.torque / gears)
    assert off(world, simulator.state.v, v_next) < 1e-11


@pytest.mark.parametrize("root", [False, True], ids=["fixed", "floating"])
def test_an_external_wrench_is_work_that_others_do(root):
    world = arm(2, root)
    q, v = state_of(world, 2)
    v_next = v + 0.1
    wrench = np.array([3.0, -1.0, 2.0, 0.3, 0.2, -0.5])
    plain = inverse_dynamics(world, (q, v), v_next, DT)
    helped = inverse_dynamics(world, (q, v), v_next, DT, external_wrench={"body4": wrench})
    assert plain.force - helped.force == pytest.approx(world.jacobian(q, "body4").T @ wrench, abs=1e-9)


# Joint limits.


def test_pushing_against_a_joint_limit():
    world = pendulum(1, lower=-1.0, upper=1.0).build()
    load = -1.0 * G * 0.25 * np.cos(1.0)  # of gravity, pressing it on
    rest = stepped(world, [1.0], [0.0], [0.0])
    assert rest.state.v == pytest.approx([0.0], abs=1e-12)
    held = inverse_dynamics(world, ([1.0], [0.0]), [0.0], DT, rest)
    assert held.torque == pytest.approx([0.0], abs=1e-9)
    pushed = stepped(world, [1.0], [0.0], [7.0])
    assert inverse_dynamics(world, ([1.0], [0.0]), [0.0], DT, pushed).torque == pytest.approx([7.0])
    assert inverse_dynamics(world, ([1.0], [0.0]), [0.0], DT).torque == pytest.approx([load])
    leaves = inverse_dynamics(world, ([1.0], [0.0]), [-0.3], DT, pushed)
    assert leaves.torque == pytest.approx([0.5**2 / 3 * -0.3 / DT + load])
    through = inverse_dynamics(world, ([1.0], [0.0]), [0.3], DT)
    assert through.status == "infeasible"
    assert through.residual == pytest.approx(0.3)
    assert through.worst == "upper limit of joint 'hinge0'"
    below = inverse_dynamics(world, ([-1.0], [0.0]), [-0.3], DT)
    assert (below.status, below.worst) == ("infeasible", "lower limit of joint 'hinge0'")


def test_a_joint_that_arrives_at_its_limit():
    world = pendulum(2, lower=-1.0, upper=1.0).build()
    q, v = np.array([0.999, -0.9995]), np.array([2.0, -1.0])
    there = stepped(world, q, v, [20.0, -10.0])
    q_next = q + DT * there.state.v
    assert q_next[0] == pytest.approx(1.0, abs=2e-7)
    check_round_trip(world, q, v, there.state.v)
    result, _ = check_round_trip(world, q, v, there.state.v, there)
    assert result.force == pytest.approx([20.0, -10.0], rel=1e-3)


# Loops.


def test_a_four_bar_linkage_turns_round():
    world = pendulum(3, close=(0.6, 0.0, 0.0)).build()
    q = _close_three_bars(0.6)
    simulator = Simulator(world, tolerance=1e-12)
    simulator.state.q = q
    simulator.applied_force[0] = 8.0
    simulator.step(100)
    q, v = simulator.state.q.copy(), simulator.state.v.copy()
    assert np.abs(v).min() > 0.1
    torque = np.array([3.0, -2.0, 1.0])
    there = stepped(world, q, v, torque)
    back, _ = check_round_trip(world, q, v, there.state.v, there)
    assert back.torque == pytest.approx(torque, abs=1e-6)
    alone, _ = check_round_trip(world, q, v, there.state.v)
    # What differs is what the loop can carry: a force at the end.
    j = world.jacobian(q, "link2", (0.5, 0.0, 0.0))[:3]
    inside = alone.torque - torque
    assert inside - j.T @ np.linalg.lstsq(j.T, inside, rcond=None)[0] == pytest.approx(np.zeros(3), abs=1e-6)
    opening = np.linalg.pinv(j) @ [0.05, 0.0, 0.0]
    opens = inverse_dynamics(world, (q, v), there.state.v + opening, DT)
    assert opens.status == "infeasible"
    assert opens.residual == pytest.approx(0.05, rel=1e-6)
    assert opens.worst.startswith("equality")


def test_a_welded_box():
    builder = WorldBuilder()
    add_box(builder, "box", 2.0, (0.1, 0.1, 0.1), (0.3, 0.0, 1.0), None)
    builder.add_weld("world", "box", position_a=(0.0, 0.0, 1.0), position_b=(-0.3, 0.0, 0.0), name="bolt")
    world = builder.build()
    rest = stepped(world, world.initial_q, np.zeros(6), np.zeros(6))
    held = inverse_dynamics(world, (world.initial_q, np.zeros(6)), np.zeros(6), DT, rest)
    assert held.solved
    assert held.force == pytest.approx(np.zeros(6), abs=1e-6)
    alone, _ = check_round_trip(world, world.initial_q, np.zeros(6), np.zeros(6))
    assert alone.force == pytest.approx([0, 0, 2.0 * G, 0, 0, 0], abs=1e-9)
    for row, speed, residual in ((2, 0.1, 0.1), (3, 0.4, 0.4), (5, 0.1, 0.1)):
        v_next = np.zeros(6)
        v_next[row] = speed
        torn = inverse_dynamics(world, (world.initial_q, np.zeros(6)), v_next, DT)
        assert torn.status == "infeasible"
        assert torn.residual == pytest.approx(residual)
        assert torn.worst == "equality 'bolt'"


@pytest.mark.parametrize("stiffness", [np.inf, 1e4])
def test_a_coupled_joint(stiffness):
    builder = pendulum(2)
    builder.add_coupling("hinge1", "hinge0", (0.1, -0.5, 0.2), name="gear", stiffness=stiffness, damping=5.0)
    world = builder.build()
    slope = -0.5 + 2 * 0.2 * 0.3
    q = np.array([0.3, 0.1 - 0.5 * 0.3 + 0.2 * 0.09])
    v = np.array([1.0, slope])
    torque = np.array([2.0, -1.0])
    there = stepped(world, q, v, torque)
    back, _ = check_round_trip(world, q, v, there.state.v, there)
    assert back.torque == pytest.approx(torque, abs=1e-6)
    alone, _ = check_round_trip(world, q, v, there.state.v)
    wrong = there.state.v + [0.0, 0.02]
    broken = inverse_dynamics(world, (q, v), wrong, DT)
    if np.isinf(stiffness):
        assert broken.status == "infeasible"
        assert broken.residual == pytest.approx(0.02, rel=1e-6)
        assert broken.worst == "equality 'gear'"
        assert abs((alone.torque - torque) @ [1.0, slope]) < 1e-6  # only along the gear
    else:
        assert broken.solved
        assert alone.torque == pytest.approx(torque, abs=1e-6)
        # k dt + d more [N s/m] to pull against, over what the bodies take
        plain = inverse_dynamics(pendulum(2).build(), (q, v), wrong, DT).torque
        before = inverse_dynamics(pendulum(2).build(), (q, v), there.state.v, DT).torque
        pull = (broken.torque - plain) - (alone.torque - before)
        assert pull == pytest.approx(0.02 * (stiffness * DT + 5.0) * np.array([-slope, 1.0]), rel=1e-6)


# Bounces.


def ball(restitution, gap=0.0, **material):
    builder = WorldBuilder()
    surface = Material(restitution=restitution, **material)
    builder.add_ground(surface)
    add_sphere(builder, "ball", MASS, 0.1, (0.0, 0.0, 0.1 + gap), surface)
    return builder.build()


def upwards(speed):
    return np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("gap", [0.0, 4e-4, -1e-4])
def test_a_ball_that_bounces(gap):
    world = ball(0.6, gap)
    q, v, v_next = world.initial_q, upwards(-1.0), upwards(0.6)
    for push in (0.0, -30.0, 50.0):
        there = stepped(world, q, v, upwards(push))
        assert there.state.v == pytest.approx(v_next, abs=1e-9)
        impulse = MASS * 1.6 + DT * (MASS * G - push)
        for guess in (there, there.contacts, [[0.0, 0.0, impulse]]):
            result, _ = check_round_trip(world, q, v, v_next, guess)
            assert result.force == pytest.approx(upwards(push), abs=1e-6)
            assert result.contact_impulse == pytest.approx(np.array([[0.0, 0.0, impulse]]), rel=1e-9)
    alone, _ = check_round_trip(world, q, v, v_next)
    assert alone.force == pytest.approx(upwards(MASS * (G + 1.6 / DT)))
    # Slower than it bounces, but not there yet: only where nothing stops it.
    if gap > 0.0:
        braked, _ = check_round_trip(world, q, v, upwards(-0.2))
        assert braked.force == pytest.approx(upwards(MASS * (G + 0.8 / DT)))


@pytest.mark.parametrize("gap", [0.0, 4e-4, -1e-4])
def test_what_bounces_cannot_arrive_and_stay(gap):
    e, touching = 0.6, 1e-7
    world, plastic = ball(e, gap), ball(0.0, gap)
    arrives = upwards(-(gap - 0.8 * touching) / DT if gap > touching else 0.2 * -gap / DT)  # (S6)
    there = stepped(plastic, plastic.initial_q, upwards(-1.0), np.zeros(6))
    assert there.state.v == pytest.approx(arrives, abs=1e-9)
    result, _ = check_round_trip(plastic, plastic.initial_q, upwards(-1.0), arrives, there)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-6)
    inside = -gap / DT - 1e-3 if gap > 0.0 else arrives[2]  # closes the gap
    for guess in (None, [[0.0, 0.0, 2.0 * MASS]]):
        result = inverse_dynamics(world, (world.initial_q, upwards(-1.0)), upwards(inside), DT, guess)
        assert result.status == "infeasible"
        assert result.residual == pytest.approx(e - inside)
        assert result.worst == "contact of 'ground' and 'ball'"


@pytest.mark.parametrize("speed", [-0.02, -1.0])
def test_a_ball_that_bounces_on_a_spring(speed):
    k, d, e, depth = 1e4, 30.0, 0.6, 1e-3
    world = ball(e, -depth, stiffness=2 * k, damping=d)  # two in series
    q, v = world.initial_q, upwards(speed)
    for v_next in (-1.2, -0.3, 0.1, 0.5, 2.0):
        result, _ = check_round_trip(world, q, v, upwards(v_next))
        bounce = e * speed if speed < -0.05 else 0.0
        spring = max(0.0, (k * DT + d) * -(v_next + bounce) + k * depth)  # (S7), (S8)
        carried = MASS * (G + (v_next - speed) / DT)
        if bounce and not -depth + DT * (v_next - DT * spring / MASS) <= 0.0:
            spring = max(0.0, (k * DT + d) * -v_next + k * depth)
        assert result.force == pytest.approx(upwards(carried - spring), abs=1e-6)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
def test_a_bounce_that_slides(law):
    world = ball(0.6, friction=0.2)
    q, v = world.initial_q, np.array([3.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    there = stepped(world, q, v, np.zeros(6), law=law)
    assert {c.mode for c in there.contacts} == {"slide"}
    result, _ = check_round_trip(world, q, v, there.state.v, there, law=law)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-5)
    check_round_trip(world, q, v, there.state.v, law=law)


# What is left to choose.


def finger(friction=MU):
    """A ball on two slides, on the ground."""
    builder = WorldBuilder()
    material = Material(friction=friction)
    builder.add_ground(material)
    slides = [Joint("x", "prismatic", axis=(1, 0, 0)), Joint("z", "prismatic", axis=(0, 0, 1))]
    builder.add_body("tip", position=(0.0, 0.0, 0.1), joints=slides, mass=MASS, inertia=np.eye(3))
    builder.add_geometry("tip", Sphere(0.1), material=material, name="tip")
    return builder.build()


@pytest.mark.parametrize("force", [0.0, 1.0, 25.0, 400.0])
def test_a_finger_slides_and_presses_as_it_is_told(force):
    world = finger()
    v, v_next = np.array([0.5, 0.0]), np.array([0.51, 0.0])
    guess = [[0.0, 0.0, force * DT]]
    result, back = check_round_trip(world, world.initial_q, v, v_next, guess)
    assert result.torque == pytest.approx([MASS * 0.01 / DT + MU * force, MASS * G - force], abs=1e-9)
    assert result.contacts[0].force == pytest.approx([-MU * force, 0.0, force], abs=1e-9)
    assert back.contact_force("world", "tip") == pytest.approx([-MU * force, 0.0, force], abs=1e-6)
    # The answer as the next guess.
    for again in (result.contact_impulse, result.contacts):
        repeated = inverse_dynamics(world, (world.initial_q, v), v_next, DT, again)
        assert repeated.torque == pytest.approx(result.torque, abs=1e-9)


def test_one_contact_that_comes_off_leaves_the_others_as_they_are():
    builder = WorldBuilder()
    material = Material(friction=MU)
    builder.add_ground(material)
    for name, x in (("a", 0.0), ("b", 1.0)):
        joint = Joint(name, "prismatic", axis=(0, 0, 1))
        builder.add_body(name, position=(x, 0.0, 0.1), joints=[joint], mass=MASS, inertia=np.eye(3))
        builder.add_geometry(name, Sphere(0.1), material=material, name=name)
    world = builder.build()
    load = MASS * G * DT
    # a leaves the ground at a speed that is no speed (1e-9 of a fall in one step), b for good.
    v_next = np.array([1e-9 * G * DT, 0.1])
    guess = [[0.0, 0.0, load], [0.0, 0.0, load]]
    result = inverse_dynamics(world, (world.initial_q, np.zeros(2)), v_next, DT, guess)
    assert result.solved
    assert result.torque == pytest.approx([0.0, MASS * (G + 0.1 / DT)], abs=1e-6)


def test_a_step_may_start_from_what_was_found():
    world = box_world()
    inverse = InverseDynamics(world, DT)
    # Two legs of a table, across, carry most of it: one of many ways.
    diagonal = np.array([np.sign(c.position[0] * c.position[1]) for c in inverse.contacts(world.initial_q)])
    guess = pressed(diagonal, MASS * G * DT / 4 * (1.0 + 0.6 * diagonal))
    result = inverse((world.initial_q, np.zeros(6)), np.zeros(6), guess)
    assert result.force == pytest.approx(np.zeros(6), abs=1e-9)
    simulator = Simulator(world, time_step=DT, tolerance=1e-12)
    inverse.warm_start(simulator)
    simulator.step()
    carried = np.array([DT * c.force_local for c in simulator.contacts])
    assert carried == pytest.approx(guess, abs=1e-12)
    assert off(world, simulator.state.v, np.zeros(6)) < 1e-12
    for bad in (None, world, Simulator(finger())):
        with pytest.raises(InvalidInputError, match="simulator"):
            inverse.warm_start(bad)


# The closest motion.


def floating(height=HALF, **material):
    """A stool on three feet with an arm of two links: torques at the hinges alone."""
    builder = WorldBuilder()
    surface = Material(**{"friction": 0.8, **material})
    builder.add_ground(surface)
    builder.add_body(
        "base", joints=[Joint("base", "free")], position=(0.0, 0.0, height), mass=3.0, inertia=0.03 * np.eye(3)
    )
    for x, y in ((0.2, 0.0), (-0.15, 0.15), (-0.15, -0.15)):
        builder.add_geometry("base", Sphere(0.03), position=(x, y, 0.03 - HALF), material=surface, name=f"foot {x} {y}")
    for name, parent, place, axis in (
        ("arm", "base", (0.0, 0.0, 0.1), (0.0, 1.0, 0.0)),
        ("hand", "arm", (0.0, 0.0, 0.5), (0.1, 1.0, 0.2)),
    ):
        builder.add_body(
            name,
            parent=parent,
            position=place,
            joints=[Joint(name, "revolute", axis=axis)],
            mass=1.0,
            center=(0.03, 0.0, 0.22),
            inertia=np.diag([0.02, 0.02, 0.001]),
        )
    return builder.build()


FLOATING = {
    "in the air": {"height": 1.0},
    "on rigid ground": {},
    "slipping": {"friction": 0.05},
    "on soft ground": {"stiffness": 2e4, "damping": 20.0, "height": HALF - 1e-3},
}


def start_of(world, seed, kind):
    rng = np.random.default_rng(seed)
    q, v = world.initial_q, np.zeros(world.num_v)
    q[world.q_slice("arm")], q[world.q_slice("hand")] = 0.3, -0.5
    v[-2:] = 0.3 * rng.normal(size=2)
    if kind == "slipping":
        v[:2] = 0.3, 0.1
    return q, v, rng


@pytest.mark.parametrize("kind", FLOATING)
@pytest.mark.parametrize("seed", range(4))
def test_closest_needs_no_hand_of_god_and_is_what_the_torques_do(kind, seed):
    world = floating(**FLOATING[kind])
    q, v, rng = start_of(world, seed, kind)
    tight = SimulatorSettings(tolerance=1e-11)
    wanted = v + 0.02 * rng.normal(size=world.num_v)
    result = inverse_dynamics(world, (q, v), wanted, DT, closest=True, settings=tight)
    assert result.solved, result
    assert result.relative <= 1e-6
    assert result.root_wrench["base"] == pytest.approx(np.zeros(6), abs=1e-9 * np.abs(result.force).max())
    back = stepped(world, q, v, result.torque)
    assert off(world, back.state.v, result.v_next) <= 1e-7


@pytest.mark.parametrize("kind", FLOATING)
@pytest.mark.parametrize("seed", range(4))
def test_closest_leaves_alone_what_can_be(kind, seed):
    world = floating(**FLOATING[kind])
    q, v, rng = start_of(world, seed, kind)
    torque = np.r_[np.zeros(6), rng.normal(size=2) * [10.0, 3.0]]
    there = stepped(world, q, v, torque)
    tight = SimulatorSettings(tolerance=1e-11)
    for guess in (None, there):
        result = inverse_dynamics(world, (q, v), there.state.v, DT, guess, closest=True, settings=tight)
        assert result.solved, result
        assert result.relative <= 1e-6
        assert off(world, result.v_next, there.state.v) <= 1e-8
        assert result.force == pytest.approx(torque, abs=1e-6)
    # Without being asked for the closest one, too.
    plain = inverse_dynamics(world, (q, v), there.state.v, DT, there)
    assert plain.force == pytest.approx(torque, abs=1e-4)


@pytest.mark.parametrize("kind", FLOATING)
def test_closest_is_about_the_closest(kind):
    """All that the stool can do are two torques: a search over them knows how near it can get."""
    world = floating(**FLOATING[kind])
    simulator = Simulator(world, time_step=DT, tolerance=1e-10)
    simulator.state.q = start_of(world, 0, kind)[0]
    mass = simulator.mass_matrix
    ratios = []
    for seed in range(8):
        q, v, rng = start_of(world, seed, kind)
        wanted = v + 0.02 * rng.normal(size=world.num_v)

        def distance(torque, q=q, v=v, wanted=wanted):
            simulator.reset()
            simulator.state.q, simulator.state.v = q, v
            simulator.applied_force[-2:] = torque
            simulator.step()
            away = simulator.state.v - wanted
            return np.sqrt(away @ mass @ away)

        tight = SimulatorSettings(tolerance=1e-10)
        ours = inverse_dynamics(world, (q, v), wanted, DT, closest=True, settings=tight).torque[-2:]
        # Torques for the wanted motion as if nothing touched are never better.
        assert distance(ours) <= (1.0 + 1e-6) * distance(inverse_dynamics(world, (q, v), wanted, DT).torque[-2:])
        starts = (ours, 0.5 * ours, ours + [20.0, 5.0], ours - [20.0, 5.0])
        options = {"maxfev": 250, "xatol": 1e-3, "fatol": 1e-9}
        least = min(minimize(distance, start, method="Nelder-Mead", options=options).fun for start in starts)
        ratios.append(distance(ours) / least)
    assert max(ratios) < {"in the air": 1.0 + 1e-6, "slipping": 1.2}.get(kind, 1.1)
    assert np.median(ratios) < 1.005


def test_closest_in_the_air_is_a_projection():
    world = floating(height=2.0)
    q, v, rng = start_of(world, 7, "")
    wanted = v + 0.1 * rng.normal(size=world.num_v)
    wanted[3:6] = v[3:6] = 0.0  # so that frames do not turn: then steps are affine in the torque
    result = inverse_dynamics(world, (q, v), wanted, DT, closest=True)
    assert result.v_next[-2:] == pytest.approx(wanted[-2:], abs=1e-12)
    there = stepped(world, q, v, np.zeros(8)).state.v
    simulator = Simulator(world, time_step=DT)
    simulator.state.q = q
    can = np.linalg.inv(simulator.mass_matrix)[:, -2:]  # ways that torques move it
    metric = can.T @ simulator.mass_matrix
    expected = there + can @ np.linalg.solve(metric @ can, metric @ (wanted - there))
    # Angular velocity of the base turns its frame by dt w within the step.
    assert result.v_next == pytest.approx(expected, abs=DT * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(6))
def test_closest_of_what_nobody_drives_is_what_happens_anyway(seed):
    world = arm(seed, root=seed % 2 == 1, actuators=True)
    q, v = state_of(world, seed)
    rng = np.random.default_rng(seed)
    acting = {"control": rng.normal(size=5)}
    wrench = {"body3": rng.normal(size=6)}
    anyway = stepped(world, q, v, np.zeros(world.num_v), wrench=wrench, **acting)
    nobody = np.zeros(world.num_v, dtype=bool)
    tight = SimulatorSettings(tolerance=1e-11)
    inverse = InverseDynamics(world, DT, settings=tight)
    for wanted in (anyway.state.v, v, v + rng.normal(size=world.num_v)):
        result = inverse((q, v), wanted, actuated=nobody, closest=True, external_wrench=wrench, **acting)
        assert off(world, result.v_next, anyway.state.v) <= 1e-9
        assert result.force == pytest.approx(np.zeros(world.num_v), abs=1e-7)
        assert not result.torque.any()
        assert set(result.root_wrench) == set(world.joint_names)
        assert result.solved


def test_closest_is_certified_where_dry_friction_slides():
    world = arm(0)
    q, v = state_of(world, 0)
    nobody = np.zeros(world.num_v, dtype=bool)
    for tolerance in (1e-6, 1e-11):
        settings = SimulatorSettings(tolerance=tolerance)
        result = inverse_dynamics(world, (q, v), v, DT, actuated=nobody, closest=True, settings=settings)
        assert result.solved
        assert result.relative <= 1e-6


@pytest.mark.parametrize("restitution", [0.0, 0.6])
@pytest.mark.parametrize("gap", [0.0, 4e-4])
def test_closest_of_a_falling_ball_is_its_fall(gap, restitution):
    world = ball(restitution, gap)
    v = upwards(-1.0)
    anyway = stepped(world, world.initial_q, v, np.zeros(6))
    tight = SimulatorSettings(tolerance=1e-11)
    for wanted in (anyway.state.v, np.zeros(6), upwards(1.0), upwards(-3.0)):
        for guess in (None, anyway):
            result = inverse_dynamics(world, (world.initial_q, v), wanted, DT, guess, closest=True, settings=tight)
            assert result.v_next == pytest.approx(anyway.state.v, abs=1e-9)
            assert result.solved
            assert result.relative <= 1e-6


def test_closest_stops_at_the_ground_and_presses_as_it_is_told():
    world = finger()
    v = np.array([0.2, 0.0])
    for wanted, possible in (((0.2, -0.5), (0.2, 0.0)), ((-1.0, -1.0), (-1.0, 0.0)), ((0.3, 0.4), (0.3, 0.4))):
        for force in (0.0, 10.0):
            guess = [[0.0, 0.0, force * DT]]
            result = inverse_dynamics(world, (world.initial_q, v), wanted, DT, guess, closest=True)
            assert result.solved
            assert result.v_next == pytest.approx(possible, abs=1e-6)
            assert result.root_wrench == {}
            lifted = possible[1] > 0.0
            assert result.contacts[0].force[2] == pytest.approx(0.0 if lifted else force, abs=1e-6)
            back = stepped(world, world.initial_q, v, result.force)
            assert off(world, back.state.v, possible) < 1e-5


@pytest.mark.parametrize("lower", [-1.0, -100.0, -np.inf])
def test_closest_keeps_to_limits_however_far_others_are(lower):
    world = pendulum(2, lower=lower, upper=1.0).build()
    q, tight = [1.0, 0.2], SimulatorSettings(tolerance=1e-11)
    simulator = Simulator(world, time_step=DT)
    simulator.state.q = q
    mass = simulator.mass_matrix
    for wanted in ([0.5, 0.3], [0.01, 0.3]):
        # Least change in the metric of the masses that stops the first joint: the second one gives way.
        expected = [0.0, wanted[1] + mass[0, 1] / mass[1, 1] * wanted[0]]
        result = inverse_dynamics(world, (q, [0.0, 0.0]), wanted, DT, closest=True)
        assert result.solved
        assert result.v_next == pytest.approx(expected, abs=5e-5)
        precise = inverse_dynamics(world, (q, [0.0, 0.0]), wanted, DT, closest=True, settings=tight)
        assert precise.v_next == pytest.approx(expected, abs=1e-8)
        back = stepped(world, q, [0.0, 0.0], precise.force)
        assert off(world, back.state.v, precise.v_next) <= 1e-8


def test_closest_keeps_a_loop_together():
    loop = pendulum(3, close=(0.6, 0.0, 0.0)).build()
    q = _close_three_bars(0.6)
    j = loop.jacobian(q, "link2", (0.5, 0.0, 0.0))[:3]
    simulator = Simulator(loop, time_step=DT)
    simulator.state.q = q
    mass = simulator.mass_matrix
    wanted = np.array([0.3, 0.2, -0.5])
    still = inverse_dynamics(loop, (q, np.zeros(3)), wanted, DT, closest=True)
    assert still.solved
    free = np.linalg.svd(j)[2][2]  # the one way it moves
    assert j @ free == pytest.approx(np.zeros(3), abs=1e-12)
    assert still.v_next == pytest.approx(free * (free @ mass @ wanted) / (free @ mass @ free), abs=1e-5)


# What comes out.


def test_names_of_what_is_missing():
    world = floating(height=1.0)
    q, v, rng = start_of(world, 1, "")
    wanted = v + 0.1 * rng.normal(size=world.num_v)
    inverse = InverseDynamics(world, DT)
    assert inverse.actuated.tolist() == [False] * 6 + [True] * 2
    result = inverse((q, v), wanted)
    assert set(result.root_wrench) == {"base"}
    assert result.root_wrench["base"].shape == (6,)
    assert not result.torque[:6].any()
    assert np.r_[result.root_wrench["base"], result.torque[6:]] == pytest.approx(result.force, abs=0)
    mask = np.ones(8, dtype=bool)
    assert inverse((q, v), wanted, actuated=mask).root_wrench == {}
    mask[[1, 7]] = False
    some = inverse((q, v), wanted, actuated=mask)
    assert set(some.root_wrench) == {"base", "hand"}
    assert some.root_wrench["base"].nonzero()[0].tolist() == [1]
    assert some.root_wrench["hand"] == pytest.approx(result.force[7:], abs=0)
    assert some.torque[[1, 7]].tolist() == [0.0, 0.0]
    assert some.torque[0] == result.force[0]
    assert "solved" in repr(result)


def test_actuators_say_what_is_actuated():
    world = arm(3, actuators=True)
    mask = InverseDynamics(world).actuated
    with_one = {(a.joint, a.component) for a in world.actuators}
    for index, joint in enumerate(world.joints):
        for k in range(joint.num_v):
            assert mask[joint.v_index + k] == ((index, k) in with_one)
    mask[:] = False  # a copy
    assert InverseDynamics(world).actuated.sum() == len(with_one)
    assert InverseDynamics(arm(3, root=True)).actuated.sum() == arm(3, root=True).num_v - 6


def soft_pile():
    """Two soft boxes on each other, tumbling a little: everything is unique."""
    builder = WorldBuilder()
    material = Material(friction=0.4, stiffness=1e4, damping=50.0)
    builder.add_ground(material)
    add_box(builder, "low", 2.0, (0.1, 0.12, 0.1), (0.0, 0.0, 0.099), material)
    add_box(builder, "high", 1.0, (0.1, 0.1, 0.08), (0.02, 0.01, 0.278), material)
    builder.add_body("pole", joints=[Joint("pole", "free")], position=(0.6, 0.0, 0.099), mass=1.0, inertia=np.eye(3))
    builder.add_geometry("pole", Sphere(0.1), material=material, name="pole")
    world = builder.build()
    simulator = Simulator(world, time_step=DT, tolerance=1e-12)
    simulator.state.v = 0.1 * np.random.default_rng(0).normal(size=world.num_v)
    simulator.step(10)
    return world, simulator.state.q.copy(), simulator.state.v.copy()


def test_contacts_are_those_of_the_simulator():
    world, q, v = soft_pile()
    there = stepped(world, q, v, np.zeros(world.num_v))
    inverse = InverseDynamics(world, DT, tolerance=1e-10)
    listed = inverse.contacts(q)
    result = inverse((q, v), there.state.v)
    assert result.solved
    assert result.force == pytest.approx(np.zeros(world.num_v), abs=1e-5)
    assert len(listed) == len(result.contacts) == len(there.contacts) == len(result.contact_impulse) > 4
    for one, ours, theirs, impulse in zip(listed, result.contacts, there.contacts, result.contact_impulse, strict=True):
        for a in (one, ours):
            assert (a.geometry_a, a.geometry_b) == (theirs.geometry_a, theirs.geometry_b)
            assert (a.body_a, a.body_b) == (theirs.body_a, theirs.body_b)
            assert a.position == pytest.approx(theirs.position, abs=1e-12)
            assert a.frame == pytest.approx(theirs.frame, abs=1e-12)
            assert a.distance == pytest.approx(theirs.distance, abs=1e-12)
        assert not one.force.any()
        assert ours.force_local * DT == pytest.approx(impulse)
        assert ours.force == pytest.approx(theirs.force, abs=1e-5)
        assert ours.velocity == pytest.approx(theirs.velocity, abs=1e-9)
        assert ours.mode == theirs.mode


def test_a_simulator_that_ran_for_a_while_is_a_guess():
    """Its detector, which remembers, lists the points of a pair in another order."""
    world, q, v = scenes.worlds()["boxes"](size=8)
    simulator = Simulator(world, tolerance=1e-11)
    simulator.state.q, simulator.state.v = q, v
    inverse = InverseDynamics(world, DT)
    permuted = 0
    for _ in range(12):
        simulator.step(30)
        q, v = simulator.state.q.copy(), simulator.state.v.copy()
        simulator.step()
        listed = np.array([c.position for c in inverse.contacts(q)])
        theirs = np.array([c.position for c in simulator.contacts])
        assert listed.shape == theirs.shape
        permuted += not np.allclose(listed, theirs, rtol=0, atol=1e-9)
        for guess in (simulator, simulator.contacts):
            if not guess:
                continue
            result = inverse((q, v), simulator.state.v, guess)
            assert result.solved
            # Nothing but contact and gravity moved it.
            assert result.force == pytest.approx(np.zeros(world.num_v), abs=1e-3 * G)
    assert permuted > 3


def test_ways_to_give_a_state_and_a_guess():
    world = finger()
    v, v_next = np.array([0.5, 0.0]), np.array([0.5, 0.0])
    there = stepped(world, world.initial_q, v, [MU * 30.0, MASS * G - 30.0])
    assert there.contact_force("world", "tip")[2] == pytest.approx(30.0)
    simulator = Simulator(world, time_step=DT)
    simulator.state.q, simulator.state.v = world.initial_q, v
    impulse = np.array([DT * c.force_local for c in there.contacts])
    torques = [
        inverse_dynamics(world, state, v_next, DT, guess).torque
        for state in ((world.initial_q, v), [list(world.initial_q), list(v)], simulator, simulator.state)
        for guess in (impulse, impulse.ravel(), impulse.tolist(), there.contacts, tuple(there.contacts), there)
    ]
    assert np.array(torques) == pytest.approx(np.tile([MU * 30.0, MASS * G - 30.0], (24, 1)), abs=1e-6)
    assert simulator.state.v == pytest.approx(v, abs=0)
    # At rest the tangents are the guess's, too.
    push = [3.0, MASS * G - 30.0]
    held = stepped(world, world.initial_q, np.zeros(2), push)
    for guess in (held, held.contacts, [DT * held.contacts[0].force_local]):
        still = inverse_dynamics(world, (world.initial_q, np.zeros(2)), np.zeros(2), DT, guess)
        assert still.torque == pytest.approx(push, abs=1e-6)
    # A quaternion need not be of length 1.
    world = box_world(height=2.0)
    q = world.initial_q
    q[3:] *= 2.0
    one = inverse_dynamics(world, (q, np.zeros(6)), np.ones(6), DT)
    assert one.force == pytest.approx(inverse_dynamics(world, (world.initial_q, np.zeros(6)), np.ones(6), DT).force)
    assert q[6] == 2.0


def test_settings_are_those_of_the_step():
    world = box_world(height=HALF - 1e-3)  # an overlap
    settings = SimulatorSettings(time_step=2e-3, baumgarte=0.5, max_correction_speed=10.0)
    inverse = InverseDynamics(world, settings=settings)
    assert inverse.settings == settings
    out = upwards(0.5 * 1e-3 / 2e-3)
    held = inverse((world.initial_q, np.zeros(6)), out, pressed(inverse.contacts(world.initial_q), 1.0))
    assert held.solved
    assert held.contact_impulse[:, 2] == pytest.approx([1.0] * 4)
    slower = inverse((world.initial_q, np.zeros(6)), 0.9 * out)
    assert slower.status == "infeasible"
    assert slower.residual == pytest.approx(0.1 * out[2])
    changed = InverseDynamics(world, 1e-3, "ccp", settings=settings)
    assert (changed.settings.time_step, changed.settings.law, changed.settings.baumgarte) == (1e-3, "ccp", 0.5)


def test_worlds_with_nothing_in_them():
    empty = WorldBuilder().build()
    result = inverse_dynamics(empty, ([], []), [], DT)
    assert result.solved
    assert result.force.shape == (0,)
    assert inverse_dynamics(empty, ([], []), [], DT, closest=True).solved


# Repetition.


def everything(result):
    return [result.force.tobytes(), result.contact_impulse.tobytes(), result.v_next.tobytes(), result.residual]


def calls():
    """Questions of different sizes and worlds, closest ones too."""
    pile, q, v = soft_pile()
    robot = floating()
    start, speed, _ = start_of(robot, 0, "")
    asked = [
        (pile, (q, v), v + 0.01, False),
        (robot, (start, speed), speed + 0.01, True),
        (robot, (start, speed), speed + 0.02, False),
        (box_world(), (box_world().initial_q, np.zeros(6)), np.zeros(6), False),
    ]
    return [(world, state, v_next, DT, None, "ncp", closest) for world, state, v_next, closest in asked]


def answer(call, inverse=None):
    world, state, v_next, dt, guess, law, closest = call
    if inverse is not None:
        return everything(inverse(state, v_next, guess, closest=closest))
    return everything(inverse_dynamics(world, state, v_next, dt, guess, law, closest=closest))


def test_same_input_same_bits():
    asked = calls()
    first = [answer(call) for call in asked]
    assert [answer(call) for call in reversed(asked)] == first[::-1]
    fresh = [answer(call, InverseDynamics(call[0], DT)) for call in asked]
    assert fresh == first
    kept = InverseDynamics(asked[1][0], DT)  # of one world, in any order
    for i in (1, 2, 1, 1, 2):
        assert answer(asked[i], kept) == first[i]
    assert len(kept.contacts(asked[1][1][0])) == 3
    assert answer(asked[1], kept) == first[1]


def test_contacts_do_not_depend_on_what_was_asked_before():
    world, q, v = scenes.worlds()["boxes"](size=8)
    simulator = Simulator(world)
    simulator.state.q, simulator.state.v = q, v
    simulator.step(100)
    kept, seen = InverseDynamics(world), 0
    for _ in range(30):
        simulator.step(5)
        q = simulator.state.q.copy()
        fresh = InverseDynamics(world).contacts(q)
        for one, other in zip(kept.contacts(q), fresh, strict=True):
            assert (one.position == other.position).all()
            assert (one.frame == other.frame).all()
        seen += len(fresh)
    assert seen > 100


def test_two_threads_get_the_same_answers():
    asked = calls()
    first = [answer(call) for call in asked]
    found = {}

    def work(which):
        found[which] = [[answer(call) for call in asked] for _ in range(10)]

    threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(one == first for which in (0, 1) for one in found[which])


# What is refused.

BAD = {
    "no world": ({"world": None}, "world.*NoneType"),
    "the class": ({"world": World}, "world.*type"),
    "state missing": ({"state": None}, "state.*NoneType"),
    "state a number": ({"state": 3.0}, "state.*float"),
    "state of three": ({"state": ([0.0], [0.0], [0.0])}, "state.*tuple"),
    "q short": ({"state": ([0.0], [0.0, 0.0])}, "q.*1.*2"),
    "q nan": ({"state": ([0.0, np.nan], [0.0, 0.0])}, r"q\[1\].*nan"),
    "q 1e300": ({"state": ([0.0, 1e300], [0.0, 0.0])}, r"q\[1\].*1e\+300"),
    "v long": ({"state": ([0.0, 0.0], [0.0] * 3)}, "v.*3.*2"),
    "v inf": ({"state": ([0.0, 0.0], [np.inf, 0.0])}, r"v\[0\].*inf"),
    "v of text": ({"state": ([0.0, 0.0], ["a", "b"])}, "v"),
    "v_next short": ({"v_next": [0.0]}, "v_next.*1.*2"),
    "v_next a matrix": ({"v_next": np.zeros((1, 2))}, r"v_next.*\(1, 2\)"),
    "v_next nan": ({"v_next": [np.nan, 0.0]}, r"v_next\[0\].*nan"),
    "v_next 1e300": ({"v_next": [0.0, 1e300]}, r"v_next\[1\].*1e\+300"),
    "v_next none": ({"v_next": None}, "v_next"),
    "dt zero": ({"dt": 0.0}, "dt.*0"),
    "dt negative": ({"dt": -1e-3}, r"dt.*-0\.001"),
    "dt long": ({"dt": 1.0}, r"dt.*1\.0"),
    "dt nan": ({"dt": np.nan}, "dt.*nan"),
    "dt text": ({"dt": "1"}, "dt.*'1'"),
    "dt an array": ({"dt": np.array([1e-3])}, "dt"),
    "law": ({"law": "lcp"}, "law.*lcp.*ncp"),
    "law of another type": ({"law": ["ncp"]}, "law"),
    "guess short": ({"impulse_guess": [0.0]}, "impulse_guess.*1.*3"),
    "guess of two contacts": ({"impulse_guess": np.zeros((2, 3))}, r"impulse_guess"),
    "guess nan": ({"impulse_guess": [[0.0, np.nan, 0.0]]}, r"impulse_guess\[1\].*nan"),
    "guess text": ({"impulse_guess": "zero"}, "impulse_guess"),
    "guess of another shape": ({"impulse_guess": np.zeros((3, 1))}, r"impulse_guess: has shape \(3, 1\), .*\(1, 3\)"),
    "guess ragged": ({"impulse_guess": [[0.0], [1.0, 2.0]]}, "impulse_guess: is not a rectangular"),
    "guess no contacts": ({"impulse_guess": []}, "impulse_guess.*0.*3"),
    "control of nobody": ({"control": [1.0]}, "control.*1.*0"),
    "wrench on nobody": ({"external_wrench": {"tipp": np.zeros(6)}}, "body.*'tipp'.*'tip'"),
    "wrench names itself": ({"external_wrench": {"tipp": np.zeros(6)}}, "^external_wrench"),
    "wrench on a number": ({"external_wrench": {3: np.zeros(6)}}, "^external_wrench.*3.*string"),
    "closest in words": ({"closest": "no"}, "closest: is 'no', must be True or False"),
    "wrench of three": ({"external_wrench": {"tip": np.zeros(3)}}, "external_wrench.*tip.*3.*6"),
    "wrench nan": ({"external_wrench": {"tip": [np.nan] * 6}}, "external_wrench.*nan"),
    "wrench without a name": ({"external_wrench": np.ones(6)}, "external_wrench.*ndarray"),
    "actuated numbers": ({"actuated": [0.0, 1.0]}, "actuated.*float64.*bool"),
    "actuated short": ({"actuated": [True]}, r"actuated.*\(1,\)"),
    "settings": ({"settings": {"time_step": 1e-3}}, "settings.*dict"),
    "bad settings": ({"settings": SimulatorSettings(baumgarte=2.0)}, "baumgarte.*2"),
    "tolerance": ({"tolerance": 0.0}, "tolerance.*0"),
    "tolerance text": ({"tolerance": "small"}, "tolerance"),
    "weight": ({"proximal_weight": -1.0}, "proximal_weight.*-1"),
    "weight nan": ({"proximal_weight": np.nan}, "proximal_weight.*nan"),
    "iterations": ({"max_iterations": 0}, "max_iterations.*0"),
    "half an iteration": ({"max_iterations": 100.0}, r"max_iterations.*100\.0"),
}


@pytest.fixture(scope="module")
def tip() -> World:
    return finger()


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD.keys())
def test_inverse_dynamics_refuses(tip, changes, message):
    good = {"world": tip, "state": (tip.initial_q, np.zeros(2)), "v_next": np.zeros(2), "dt": DT}
    assert inverse_dynamics(**good).solved
    with pytest.raises(InvalidInputError, match=message) as caught:
        inverse_dynamics(**(good | changes))
    assert isinstance(caught.value, ValueError)
    assert inverse_dynamics(**good).solved


def test_guesses_of_another_world_or_configuration_are_refused(tip):
    other = Simulator(finger(), time_step=DT)
    other.step()
    with pytest.raises(InvalidInputError, match="impulse_guess.*another world"):
        inverse_dynamics(tip, (tip.initial_q, np.zeros(2)), np.zeros(2), DT, other)
    builder = WorldBuilder()
    builder.add_ground()
    for i in range(2):
        add_sphere(builder, f"ball{i}", 1.0, 0.1, (i, 0.0, 0.1), None)
    world = builder.build()
    low, high = world.initial_q, world.initial_q
    high[9] += 1.0
    both, one = (stepped(world, q, np.zeros(12), np.zeros(12)) for q in (low, high))
    assert (len(both.contacts), len(one.contacts)) == (2, 1)
    zero = np.zeros(12)
    with pytest.raises(InvalidInputError, match=r"impulse_guess\[1\].*ball1.*has none"):
        inverse_dynamics(world, (high, zero), zero, DT, both.contacts)
    with pytest.raises(InvalidInputError, match=r"impulse_guess\[0\].*'ball1'.*has none"):
        inverse_dynamics(world, (high, zero), zero, DT, both.contacts[1:])
    with pytest.raises(InvalidInputError, match=r"impulse_guess.*other contacts"):
        inverse_dynamics(world, (high, zero), zero, DT, both)
    # A contact that was not there starts from 0: the torques carry that ball.
    assert inverse_dynamics(world, (low, zero), zero, DT, one).force[[2, 8]] == pytest.approx([0.0, 9.81], abs=1e-6)
    with pytest.raises(InvalidInputError, match=r"impulse_guess.*no step"):
        inverse_dynamics(world, (low, zero), zero, DT, Simulator(world))
    assert inverse_dynamics(world, (low, zero), zero, DT, both).force == pytest.approx(zero, abs=1e-6)


def test_a_quaternion_of_length_zero_is_refused():
    world = box_world()
    with pytest.raises(InvalidInputError, match=r"q.*quaternion of length 0"):
        inverse_dynamics(world, (np.zeros(7), np.zeros(6)), np.zeros(6), DT)
    with pytest.raises(InvalidInputError, match=r"q.*quaternion of length 0"):
        InverseDynamics(world).contacts(np.zeros(7))
    with pytest.raises(InvalidInputError, match=r"q.*3.*7"):
        InverseDynamics(world).contacts(np.zeros(3))


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("size", [1e5, 1e30, 1e99])
def test_huge_numbers_are_refused_or_answered(size, closest):
    for world in (finger(), pendulum(2, friction=1.0, lower=-1.0).build(), floating()):
        v = np.full(world.num_v, size)
        try:
            result = inverse_dynamics(world, (world.initial_q, v), -v, DT, closest=closest)
        except InvalidInputError:
            continue
        assert result.status != "solved" or np.isfinite(result.force).all()


def test_after_a_refused_call_nothing_is_left():
    world = box_world()
    stepped_there = Simulator(world, time_step=DT)
    stepped_there.step()
    away = world.initial_q
    away[0] += 1.0
    inverse = InverseDynamics(world, dt=DT)
    with pytest.raises(InvalidInputError, match="other contacts"):
        inverse((away, np.zeros(6)), np.zeros(6), stepped_there)
    assert not len(inverse._core.contacts()[3])
    assert inverse._core.worst() == ""
    other = Simulator(world, time_step=DT)
    other.state.q = away
    inverse.warm_start(other)
    other.step()
    assert other.report.status == "solved"


def test_a_guess_from_another_time_step_is_the_same_force():
    world = box_world()
    coarse = Simulator(world, time_step=10.0 * DT)
    coarse.step()
    at_rest = (world.initial_q, np.zeros(6))
    for guess in (coarse, coarse.contacts):
        result = inverse_dynamics(world, at_rest, np.zeros(6), DT, guess)
        assert result.force == pytest.approx(np.zeros(6), abs=1e-6)
    with pytest.raises(InvalidInputError, match="simulator: has the time step"):
        InverseDynamics(world, DT).warm_start(coarse)


def test_many_threads_and_more_settings_than_are_kept():
    world = box_world()
    q, zero = world.initial_q, np.zeros(6)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            work = [pool.submit(inverse_dynamics, world, (q, zero), zero, DT * (1 + k % 12)) for k in range(2000)]
            assert all(one.result().solved for one in work)
    finally:
        sys.setswitchinterval(interval)


@pytest.mark.parametrize("driven", [True, False])
def test_closest_under_the_ccp_lifts_what_slides(driven):
    world = box_world()
    slides = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    result = inverse_dynamics(
        world, (world.initial_q, slides), slides, DT, law="ccp", closest=True, actuated=np.full(6, driven)
    )
    assert result.solved, result
    for contact in result.contacts:
        assert contact.velocity[2] >= MU * np.hypot(*contact.velocity[:2]) - 1e-7
    if driven:  # no farther than sliding slower and lifting, without turning
        share = 0.3 / (1.0 + MU**2)
        simulator = Simulator(world)
        away, lifts = result.v_next - slides, np.array([share - 0.3, 0.0, MU * share, 0.0, 0.0, 0.0])
        assert away @ simulator.mass_matrix @ away <= (1.0 + 1e-6) * lifts @ simulator.mass_matrix @ lifts


def test_an_external_wrench_that_is_not_finite_names_its_body():
    world = box_world()
    with pytest.raises(InvalidInputError, match=r"external_wrench\['box'\].*nan"):
        inverse_dynamics(world, (world.initial_q, np.zeros(6)), np.zeros(6), DT, external_wrench={"box": [np.nan] * 6})


def test_a_wrench_on_the_world_and_numbers_that_overflow_are_refused():
    world = box_world()
    at_rest = (world.initial_q, np.zeros(6))
    with pytest.raises(InvalidInputError, match=r"external_wrench\['world'\].*can move"):
        inverse_dynamics(world, at_rest, np.zeros(6), DT, external_wrench={"world": np.ones(6)})
    stool = floating()
    state = (stool.initial_q, np.full(stool.num_v, 1e90))
    with pytest.raises(InvalidInputError, match=r"v, v_next: are too large"):
        inverse_dynamics(stool, state, np.zeros(stool.num_v), DT, closest=True)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
@pytest.mark.parametrize("stiffness", [np.inf, 2e4])
@pytest.mark.parametrize("loop", [False, True])
def test_a_certified_step_is_undone_to_the_tolerance_it_was_made_with(law, stiffness, loop):
    soft = {} if np.isinf(stiffness) else {"stiffness": stiffness, "damping": 50.0}
    material = Material(friction=0.6, restitution=0.5, **soft)
    builder = WorldBuilder()
    builder.add_ground(material)
    builder.add_body("base", joints=[Joint("root", "free")], position=(0, 0, 0.16), mass=2, inertia=np.eye(3) * 0.02)
    builder.add_geometry("base", Box((0.15, 0.1, 0.05)), material=material)
    for i, y in enumerate((-0.12, 0.12)):
        knee = Joint(f"knee {i}", "revolute", axis=(0, 1, 0), friction=0.02, lower=-0.3, upper=0.3)
        leg = {"mass": 0.3, "center": (0, 0, -0.08), "inertia": np.eye(3) * 0.001}
        builder.add_body(f"leg {i}", parent="base", position=(0.1, y, 0), joints=[knee], **leg)
        builder.add_geometry(f"leg {i}", Sphere(0.03), position=(0, 0, -0.13), material=material)
    if loop:
        builder.add_coupling("knee 1", "knee 0", (0, 1.0))
    world = builder.build()
    inverse = InverseDynamics(world, dt=1e-3, law=law)
    rng = np.random.default_rng(3)
    touched = 0
    for _ in range(40):
        simulator = Simulator(world, law=law)
        change, v = rng.normal(size=world.num_v) * 0.15, rng.normal(size=world.num_v)
        change[2] = -rng.uniform(0, 0.02)
        if loop:
            change[7], v[7] = change[6], v[6]
        q = world.integrate(world.initial_q, change, 1.0)
        simulator.state.q, simulator.state.v = q, v
        simulator.applied_force[:] = applied = rng.normal(size=world.num_v) * 2
        simulator.step()
        assert simulator.report.unsolved == 0
        result = inverse((q, v), simulator.state.v, simulator, actuated=np.ones(world.num_v, bool))
        largest = max([1.0] + [np.linalg.norm(contact.force) for contact in simulator.contacts])
        touched += largest > 1.0
        assert result.solved
        assert result.relative <= 1e-4
        assert abs(result.force - applied).max() <= 1e-3 * largest
    assert touched > 10


@pytest.mark.parametrize(("scene", "law"), [("spheres", "ncp"), ("boxes", "ccp")])
def test_undone_steps_of_heaps_obey_the_law(scene, law):
    """A last bit of impulse where a contact parts, or just off the border of a cone, is no violation."""
    world, q, v = scenes.worlds()[scene]()
    simulator = Simulator(world, law=law)
    simulator.state.q, simulator.state.v = q, v
    inverse = InverseDynamics(world, dt=simulator.settings.time_step, law=law)
    for _ in range(60):
        simulator.run(5)
        q, v = simulator.state.q.copy(), simulator.state.v.copy()
        simulator.step()
        result = inverse((q, v), simulator.state.v, simulator, actuated=np.ones(world.num_v, bool))
        assert result.solved
        assert result.relative <= 1e-5


@pytest.mark.parametrize("other", [{"max_correction_speed": 0.0}, {"restitution_threshold": 10.0}, {"baumgarte": 1.0}])
def test_a_step_with_other_corrections_is_another_step(other):
    builder = WorldBuilder()
    material = Material(restitution=0.5 if "restitution_threshold" in other else 0.0)
    builder.add_ground(material)
    inertia = 0.01 * np.eye(3)
    builder.add_body("ball", joints=[Joint("ball", "free")], position=(0, 0, 0.0995), mass=1.0, inertia=inertia)
    builder.add_geometry("ball", Sphere(0.1), material=material)
    world = builder.build()
    simulator = Simulator(world)
    simulator.state.v[2] = -1.0
    q, v = simulator.state.q.copy(), simulator.state.v.copy()
    simulator.step()
    inverse = InverseDynamics(world, settings=SimulatorSettings(**other))
    result = inverse((q, v), simulator.state.v, simulator, actuated=np.ones(6, bool))
    assert not result.solved or result.relative <= 1e-6
