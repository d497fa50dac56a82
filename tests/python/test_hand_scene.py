"""The hand and its cubes against statics and against the plan of the fingers."""

import numpy as np
import pytest

import signorini
from signorini import InvalidInputError
from signorini.scenes import worlds

TIPS = ("link_3.0_tip", "link_7.0_tip", "link_15.0_tip")


def started(**options):
    scene = worlds()["allegro-cubes"]
    try:
        start = scene(**options)
    except FileNotFoundError as error:
        pytest.skip(str(error))
    simulator = signorini.Simulator(start.world)
    simulator.state.q, simulator.state.v = start.q, start.v
    return simulator, scene.controller(simulator, start, options)


def cube_velocities(simulator, num_cubes):
    return np.concatenate([simulator.state.v[simulator.world.v_slice(f"cube-{i}")] for i in range(num_cubes)])


def assert_cones_are_obeyed(simulator, friction=1.0):
    for contact in simulator.contacts:
        tangential, normal = np.linalg.norm(contact.force_local[:2]), contact.force_local[2]
        assert normal >= 0.0
        assert tangential <= friction * normal + 1e-9


def test_only_fingertips_touch_the_lowest_cube():
    simulator, _ = started()
    world = simulator.world
    near = {
        (world.geometry_names[a], world.geometry_names[b]) for a, b, _ in world.touching_pairs(simulator.state.q, 5e-4)
    }
    assert near == {(tip, "cube-0") for tip in TIPS} | {("cube-0", "cube-1"), ("cube-1", "cube-2")}


@pytest.mark.parametrize("num_cubes", [1, 3])
def test_a_stack_is_held_still_and_the_fingertips_carry_its_weight(num_cubes):
    simulator, control = started(num_cubes=num_cubes)
    trace = simulator.run(700, controller=control)
    start = simulator.state.q.copy()
    more = simulator.run(300, controller=control)
    assert np.all(trace.solved)
    assert np.all(more.solved)
    assert np.abs(cube_velocities(simulator, num_cubes)).max() < 1e-6
    assert np.abs(simulator.state.q - start).max() < 1e-6
    weight = num_cubes * 0.05 * 9.81
    held = sum(simulator.contact_force(tip, "cube-0") for tip in TIPS)
    np.testing.assert_allclose(held, [0.0, 0.0, weight], atol=1e-6 * weight)
    for i in range(1, num_cubes):  # each carries what is above it
        force = simulator.contact_force(f"cube-{i - 1}", f"cube-{i}")
        np.testing.assert_allclose(force, [0.0, 0.0, (num_cubes - i) * 0.05 * 9.81], atol=1e-6 * weight)
    assert_cones_are_obeyed(simulator)
    np.testing.assert_allclose(simulator.body_placement("cube-0")[0], [0.02, -0.021, 0.21], atol=2e-4)
    thumb = next(c for c in simulator.contacts if "link_15.0_tip" in (c.geometry_a, c.geometry_b))
    assert thumb.force_local[2] == pytest.approx(4.0, rel=0.1)


def test_without_friction_enough_the_stack_slips_out():
    """Two sides press with 4 N each: they carry 2 * 4 N * friction; two thirds of the weight here."""
    simulator, control = started(num_cubes=1, friction=0.4, mass=0.5)
    simulator.run(300, controller=control)
    assert simulator.body_placement("cube-0")[0][2] < 0.2


def test_a_cube_is_turned_as_planned_and_never_let_go():
    simulator, control = started(task=1)
    largest = 0.0
    for k in range(1250):
        trace = simulator.run(1, controller=control)
        assert trace.solved[0]
        if k % 25:
            continue
        rotation = simulator.body_placement("cube-0")[1]
        angle = np.arctan2(rotation[0, 2], rotation[2, 2])
        planned = 0.7 * min(1.0, simulator.state.time) * np.sin(2.0 * np.pi * simulator.state.time / 2.5)
        assert angle == pytest.approx(planned, abs=0.12)
        pushing = {c.geometry_a for c in simulator.contacts if c.geometry_b == "cube-0" and c.mode == "stick"}
        assert pushing >= set(TIPS)
        assert_cones_are_obeyed(simulator)
        largest = max(largest, angle)
    assert largest > np.radians(25.0)
    np.testing.assert_allclose(simulator.body_placement("cube-0")[0], [0.02, -0.021, 0.21], atol=1e-3)


def test_options_are_checked():
    for options in ({"task": 2}, {"task": 0.5}, {"edge": 0.1}, {"num_cubes": 0}, {"squeeze": -1.0}, {"mass": 0.0}):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            worlds()["allegro-cubes"](**options)
