"""Solo12 walks: the planner against a rigid body and against its own optimality, the terrain, and walks."""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

import signorini
import signorini.recording
from signorini import InvalidInputError, Joint, Material, Sphere, WorldBuilder
from signorini.cli.main import app
from signorini.experiments.walking import walk
from signorini.scenes import robots_folder, worlds
from signorini.scenes._solo import FOOT_RADIUS, Terrain, foothold, trot
from signorini.scenes._solo_mpc import Body, ForcePlanner, Limits, rotation_vector, skew

try:
    robots_folder()
    HAS_ROBOT = True
except FileNotFoundError:
    HAS_ROBOT = False
robot = pytest.mark.skipif(not HAS_ROBOT, reason="needs the package example-robot-data")

GRAVITY = np.array([0.0, 0.0, -9.81])
MASS = 2.5
FEET = np.array([[0.2, 0.14, -0.2], [0.18, -0.15, -0.22], [-0.2, 0.13, -0.25], [-0.19, -0.14, -0.23]])


def exponential(w):
    """Rodrigues."""
    angle = np.linalg.norm(w)
    if angle < 1e-12:
        return np.eye(3) + skew(w)
    K = skew(w / angle)
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K


def body(seed=0):
    random = np.random.default_rng(seed)
    A = random.standard_normal((3, 3))
    return Body(MASS, 0.02 * (A @ A.T + np.eye(3)), GRAVITY)


def balanced(feet):
    """Forces that carry the weight without moment about the origin."""
    rows = np.vstack([np.tile(np.eye(3), 4), np.hstack([skew(foot) for foot in feet])])
    return np.linalg.lstsq(rows, np.concatenate([-MASS * GRAVITY, np.zeros(3)]), rcond=None)[0].reshape(4, 3)


def rigid_body(state, forces, inertia, dt, parts=100):
    """A rigid body pushed at FEET, integrated in small midpoint steps; inertia: at the reference orientation."""
    phi, e, w, v = np.split(np.array(state), 4)
    R = exponential(phi)
    h = dt / parts

    def rates(R, e, w):
        turned = R @ inertia @ R.T
        moment = sum(np.cross(foot - e, f) for foot, f in zip(FEET, forces, strict=True))
        return np.linalg.solve(turned, moment - np.cross(w, turned @ w)), forces.sum(axis=0) / MASS + GRAVITY

    for _ in range(parts):
        spin, push = rates(R, e, w)
        middle_w, middle_v = w + 0.5 * h * spin, v + 0.5 * h * push
        spin, push = rates(exponential(0.5 * h * w) @ R, e + 0.5 * h * v, middle_w)
        R, e, w, v = exponential(h * middle_w) @ R, e + h * middle_v, w + h * spin, v + h * push
    return np.concatenate([rotation_vector(R), e, w, v])


def test_the_planner_s_dynamics_are_the_derivative_of_a_rigid_body():
    model, forces, dt, step = body(), balanced(FEET), 0.1, 1e-4
    A, B, c = model.dynamics(FEET[None], np.zeros(3), dt)
    still = rigid_body(np.zeros(12), forces, model.inertia, dt)
    np.testing.assert_allclose(still, 0.0, atol=1e-12)
    np.testing.assert_allclose(B[0] @ forces.ravel() + c, 0.0, atol=1e-12)
    for k in range(12):
        change = step * np.eye(12)[k]
        forward, back = (rigid_body(s * change, forces, model.inertia, dt) for s in (1.0, -1.0))
        np.testing.assert_allclose(A[:, k], (forward - back) / (2 * step), rtol=1e-4, atol=1e-6, err_msg=f"state {k}")
        push = change.reshape(4, 3)
        forward, back = (rigid_body(np.zeros(12), forces + s * push, model.inertia, dt) for s in (1.0, -1.0))
        np.testing.assert_allclose(
            B[0][:, k], (forward - back) / (2 * step), rtol=1e-4, atol=1e-6, err_msg=f"force {k}"
        )


def test_rotation_vector():
    random = np.random.default_rng(1)
    for angle in (0.0, 1e-9, 0.3, 3.0):
        axis = random.standard_normal(3)
        w = angle * axis / np.linalg.norm(axis)
        np.testing.assert_allclose(rotation_vector(exponential(w)), w, atol=1e-12)


def planner(**changes):
    weights = np.array([20, 20, 10, 0, 20, 200, 0.1, 0.1, 0.1, 5, 5, 5.0])
    return ForcePlanner(**{"dt": 0.02, "state_weights": weights, "force_weight": 1e-3, "limits": Limits(0.5, 1.0, 20.0),
                           **changes})  # fmt: skip


def test_a_plan_obeys_its_limits_and_nothing_is_better():
    pytest.importorskip("proxsuite")
    model, steps = body(), 8
    contact = np.ones((steps, 4), dtype=bool)
    contact[:4, [0, 3]] = contact[4:, [1, 2]] = False
    levers = np.tile(FEET, (steps, 1, 1))
    normal = np.array([-math.sin(0.2), 0.0, math.cos(0.2)])
    velocity = np.array([0.3, 0.0, 0.06])
    state = np.concatenate([[0.1, -0.1, 0.2], [0.0, 0.02, -0.01], [0.5, 0.3, 0.0], [-0.2, 0.6, 0.0]])
    used = planner()
    plan = used.plan(model, state, levers, contact, normal, velocity)
    assert plan.solved
    assert plan.residual <= used.tolerance
    assert (plan.forces[~contact] == 0.0).all()

    limits = used.limits
    forces = plan.forces[contact]
    pressure = forces @ normal
    across = np.cross(normal, np.cross([0.0, 1.0, 0.0], normal))
    tangents = np.stack([forces @ (across / np.linalg.norm(across)), forces @ np.cross([0.0, 1.0, 0.0], normal)])
    assert pressure.min() > limits.lowest - 1e-5
    assert pressure.max() < limits.highest + 1e-5
    share = np.abs(tangents) / pressure
    assert share.max() < limits.friction + 1e-5
    assert share.max() > limits.friction - 1e-4  # it is a state for which friction matters

    A, B, c = model.dynamics(levers, velocity, used.dt)
    weight = -MASS * GRAVITY / contact.sum(axis=1)[:, None]
    wanted = np.concatenate([np.zeros(9), velocity])

    def cost(all_forces):
        x, total = state, 0.0
        for k in range(steps):
            x = A @ x + B[k] @ all_forces[k].ravel() + c
            total += used.state_weights @ (x - wanted) ** 2
            total += used.force_weight * ((all_forces[k] - weight[k]) ** 2)[contact[k]].sum()
        return total

    # The cost is convex: no forces within the limits are better by more than the gap of Frank and Wolfe, whose linear
    # problem is solved by corners of each foot's pyramid.
    step = 1e-3
    gradient = np.zeros_like(plan.forces)
    for index in zip(*np.nonzero(np.repeat(contact[:, :, None], 3, axis=2)), strict=True):
        change = np.zeros_like(plan.forces)
        change[index] = step
        gradient[index] = (cost(plan.forces + change) - cost(plan.forces - change)) / (2 * step)
    t2 = np.cross(normal, across) / np.linalg.norm(across)
    sides = [a * across / np.linalg.norm(across) + b * t2 for a in (-1, 1) for b in (-1, 1)]
    corners = [n * (normal + limits.friction * side) for n in (limits.lowest, limits.highest) for side in sides]
    best = gradient[contact] @ np.array(corners).T
    gap = (gradient[contact] * forces).sum() - best.min(axis=1).sum()
    assert -1e-4 < gap < 1e-3 * cost(plan.forces)


@robot
@pytest.mark.parametrize("slope", [0.0, 15.0])
def test_standing_robot_plans_to_carry_its_weight(slope):
    pytest.importorskip("proxsuite")
    start = worlds()["solo-terrain"](slope=slope)
    simulator = signorini.Simulator(start.world)
    simulator.state.q = start.q
    control = trot(simulator, slope=slope)
    control()
    mass = sum(each.mass for each in start.world.bodies)
    forces = control.plan.forces
    assert control.plan.solved
    # over the plan: on the whole the weight, and no moment about the centre of mass
    np.testing.assert_allclose(forces.sum(axis=1), np.tile(-mass * GRAVITY, (len(forces), 1)), atol=0.02 * mass)
    for _ in range(100):
        control()
        simulator.step()
    force = sum(simulator.contact_force("world", foot) for foot in control.feet)
    np.testing.assert_allclose(force, -mass * GRAVITY, atol=0.05 * mass * 9.81)
    assert np.abs(simulator.state.v).max() < 0.05


def test_terrain_s_height_is_that_of_its_geometry():
    terrain = Terrain.random(math.radians(12.0), 0.04, seed=5)
    builder = WorldBuilder()
    terrain.add_to(builder, Material())
    builder.add_body("ball", joints=[Joint("ball", "free")], mass=1.0, inertia=np.eye(3))
    builder.add_geometry("ball", Sphere(FOOT_RADIUS))
    world = builder.build()
    random, tried = np.random.default_rng(0), 0
    q = world.initial_q
    for x, y in random.uniform([0.0, -0.8], [6.0, 0.8], (200, 2)):
        if terrain.free(x, y, 1.0) and terrain.free(x, y, -1.0):
            q[:3] = foothold(terrain, x, y)
            assert abs(min(d for *_, d in world.touching_pairs(q, 0.1))) < 1e-9, (x, y)
            tried += 1
    assert tried > 50


@robot
@pytest.mark.parametrize("terrain", [{"slope": 15.0}, {"slope": 0.0, "steps": 0.04, "seed": 2}])
def test_it_walks(terrain):
    pytest.importorskip("proxsuite")
    done = walk(0.8, **terrain)
    assert done.distance >= 0.8
    assert done.duration < 3.5
    assert done.upright
    assert done.lowest > 0.19
    assert done.aside < 0.05
    assert done.unsolved == 0
    assert done.worst_relative <= 1e-6
    assert done.cone <= 1e-5  # [N], of the simulator's forces outside its friction cones
    assert done.slip < 0.02
    assert done.plan_rate >= 50.0
    assert done.unsolved_plans == 0
    assert done.worst_residual <= 1e-6
    assert done.torque <= 2.7


@robot
def test_it_recovers_from_a_push():
    """1.2 N s from the side, half of its mass times 1 m/s; later it is back on its line."""
    pytest.importorskip("proxsuite")
    start = worlds()["solo-terrain"](slope=0.0)
    simulator = signorini.Simulator(start.world)
    simulator.state.q = start.q
    control = trot(simulator, slope=0.0)
    for k in range(2400):
        simulator.set_external_wrench("base_link", force=(0.0, 12.0 if 600 <= k < 700 else 0.0, 0.0))
        control()
        simulator.step()
        assert simulator.state.q[2] > 0.19
        if k == 700:
            assert control.velocity[1] > 0.1
    assert abs(control.velocity[1]) < 0.05
    assert abs(simulator.state.q[1]) < 0.02
    assert simulator.report.unsolved == 0


@robot
def test_the_command_walks_it_the_same_way_each_time(tmp_path):
    pytest.importorskip("proxsuite")
    file = tmp_path / "walk.h5"
    arguments = ["run", "solo-terrain", "--duration", "0.6", "--option", "slope=5", "--record", str(file)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    held = signorini.recording.read(file)
    assert held.q[-1, 0] > 0.05
    assert (np.ptp(held.control, axis=0) > 0.1).all()
    result = CliRunner().invoke(app, ["replay", str(file), "--verify"])
    assert result.exit_code == 0, result.output
    CliRunner().invoke(app, arguments)
    assert signorini.recording.read(file).state_hash == held.state_hash  # the QP solver's last bits play no part


@robot
def test_a_missing_solver_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "proxsuite", None)
    result = CliRunner().invoke(app, ["run", "solo-terrain", "--duration", "0.01"])
    assert result.exit_code == 2
    assert "signorini[control]" in result.output


def test_options_are_checked():
    for options in ({"slope": 40.0}, {"steps": -0.1}, {"speed": 2.0}, {"friction": 0.0}, {"seed": -1}):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            worlds()["solo-terrain"](**options)
