"""Inverse dynamics of whole robots: against forward dynamics, MuJoCo's inverse, and the paper's Fig. 8."""

import math

import numpy as np
import pytest

from signorini import scenes
from signorini.experiments import inverse, inverse_checks

ROBOTS = ["UR5", "Allegro", "Talos", "humanoid"]


@pytest.fixture(scope="module", autouse=True)
def robot_files():
    try:
        scenes.robots_folder()
    except FileNotFoundError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("stiffness", [math.inf, 1e5])
def test_round_trips(robot, stiffness):
    if robot == "humanoid":
        pytest.importorskip("mujoco")
        pytest.importorskip("gymnasium")
    found = inverse_checks.round_trips(inverse_checks.robots()[robot], stiffness, 20, seed=7)
    counts, worst = found["counts"], found["worst"]
    assert counts["states"] == 20
    assert counts["in contact"] >= 4
    assert max(worst["warm"], worst["zero guess"], worst["any motion"]) < 1e-9
    if math.isfinite(stiffness):
        assert worst["torque"] < 1e-8


def test_forces_and_torques_of_mujocos_inverse():
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium")
    found = inverse_checks.against_mujoco(30, seed=3)
    assert found["contacts"] > 15
    assert found["worst"]["force"] < 1e-10
    assert found["worst"]["torque"] < 1e-10


@pytest.mark.parametrize("stiffness", [math.inf, inverse.STIFFNESS])
def test_sliding_along_a_wall(stiffness):
    found = inverse.slide(stiffness, 8)
    assert set(found["ncp_status"]) == {"solved"}
    assert found["iterations"].max() <= 2
    assert found["error"].max() < 1e-9
    force = found["inverse_force"]
    assert force == pytest.approx(found["forward_force"], abs=1e-6)
    assert force[:, 2] == pytest.approx(inverse.PRESS, rel=1e-3)
    assert np.hypot(force[:, 0], force[:, 1]) == pytest.approx(inverse.FRICTION * force[:, 2], rel=1e-9)
    if math.isinf(stiffness):  # the CCP lifts what slides at mu |v_T|
        assert set(found["ccp_status"]) == {"infeasible"}
        speed = inverse.RADIUS * 2.0 * math.pi / inverse.PERIOD
        lift = inverse.FRICTION * speed / math.hypot(1.0, inverse.FRICTION)
        assert found["ccp_residual"] == pytest.approx(lift, rel=1e-4)


def test_algorithm_2_as_written():
    found = inverse.by_iteration(inverse.slide(math.inf, 1)["first"])
    assert all(found[f"ncp, {start}"]["iterations"] in (0, 1, 2) for start in ("pressed", "zero"))
    diverges = found["ccp, pressed"]["force"]
    assert found["ccp, pressed"]["iterations"] is None
    growth = np.diff(diverges)[1:]
    assert growth == pytest.approx(growth[0], rel=1e-6)  # by the same step again and again, of size 1 / rho
    assert growth[0] > 1e9


def test_talos_stands_and_pushes():
    found = inverse.talos(30)
    assert set(found["status"]) == {"solved"}
    assert found["root"].max() < 1e-6  # nothing but the joints' torques
    assert found["forward"] == pytest.approx(found["wanted"], abs=0.01 * inverse.TALOS_PUSH)
    assert found["forward"].max() > 0.98 * inverse.TALOS_PUSH
    assert found["moved"] < 1e-6
