import json

import numpy as np
import pytest
from typer.testing import CliRunner

import signorini
from signorini import engines, scenes
from signorini.cli.main import app
from signorini.engines import _exchange
from signorini.experiments import Options, simulators

BY_NAME = {engine.name: engine for engine in engines.ENGINES}


def robot():
    """A free body; on it, through two joints of one body, an arm; on that a slider. All off their origins, turned."""
    builder = signorini.WorldBuilder()
    builder.add_ground()
    joint = signorini.Joint
    inertia = np.array([[0.03, 0.002, 0.001], [0.002, 0.04, -0.003], [0.001, -0.003, 0.05]])
    some = {"mass": 1.3, "center": (0.02, -0.01, 0.03), "inertia": inertia}
    builder.add_body("trunk", position=(0, 0, 1.0), joints=[joint("trunk", "free")], **some)
    hinges = [
        joint("first", axis=(1, 0, 0), anchor=(0.1, 0.2, 0.0), reference=0.4, damping=1.0, armature=0.1, lower=-1.0),
        joint("second", axis=(0, 0.6, 0.8), anchor=(0.0, 0.1, -0.1), reference=-0.3),
    ]
    turned = (0.1, 0.2, 0.3, 0.9)
    builder.add_body("arm", parent="trunk", position=(0.3, 0.1, 0.0), orientation=turned, joints=hinges, **some)
    slide = [joint("slide", "prismatic", axis=(0, 1, 0), reference=0.1)]
    builder.add_body("hand", parent="arm", position=(0.3, 0, 0), orientation=turned, joints=slide, **some)
    builder.add_body("tip", parent="hand", position=(0.0, 0.2, 0.0), orientation=turned, **some)
    builder.add_geometry("trunk", signorini.Box((0.1, 0.1, 0.1)))
    builder.add_geometry("hand", signorini.Capsule(0.05, 0.1), position=(0, 0, 0.1), orientation=turned)
    builder.add_geometry("tip", signorini.Sphere(0.1))
    builder.exclude("trunk", "hand")
    builder.exclude("trunk", "tip")  # links exclude each other, and the tip is fixed to the hand
    return builder.build()


def some_q(world):
    v = 0.4 * np.random.default_rng(1).standard_normal(world.num_v)
    return world.integrate(world.initial_q, v, 1.0)


def masses(world, q):
    simulator = signorini.Simulator(world)
    simulator.state.q = q
    matrix = simulator.mass_matrix
    for joint in world.joints:  # the plain model has no armature
        if joint.num_v == 1:
            matrix[joint.v_index, joint.v_index] -= joint.armature
    return matrix


def test_the_plain_model_moves_as_the_world():
    world = robot()
    q = some_q(world)
    copy = _exchange.build(json.loads(json.dumps(_exchange.plain(world, 0.8))))
    np.testing.assert_allclose(masses(copy, q), masses(world, q), atol=1e-12)
    expected = {(a, b): d for a, b, d in world.touching_pairs(q, 10.0)}
    found = {(a, b): d for a, b, d in copy.touching_pairs(q, 10.0)}
    assert found == pytest.approx(expected)
    assert (1, 2) not in found  # trunk and hand
    assert all(joint.damping == 0.0 and joint.upper == np.inf for joint in copy.joints)


def test_the_mjcf_file_has_the_mass_matrix(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    assert mujoco.__version__
    world = robot()
    model = _exchange.plain(world, 0.8)
    q = some_q(world)
    _exchange.write(model, q, tmp_path)
    python = engines.interpreter(BY_NAME["mujoco"])
    answer = engines.run(python, BY_NAME["mujoco"], "accurate", tmp_path, time_step=1e-3, steps=20)
    assert "error" not in answer
    assert np.shape(answer["mass_matrix"]) == (9, 9)
    assert simulators.mass_error(_exchange.build(model), q, answer) < 1e-12
    ours = engines.run(
        engines.interpreter(BY_NAME["signorini"]), BY_NAME["signorini"], "default", tmp_path, time_step=1e-3, steps=20
    )
    assert "error" not in ours
    for k in (0, 1, 2):  # in flight: the same motion, but for what an integrator leaves in 20 ms
        for mine, other in zip(ours["states"][k], answer["states"][k], strict=True):
            np.testing.assert_allclose(mine, other, atol=5e-4)


def test_what_has_no_place_in_the_plain_model_is_said():
    builder = signorini.WorldBuilder()
    builder.add_geometry("world", signorini.HeightField(np.zeros((2, 2)), (1.0, 1.0)), name="hills")
    with pytest.raises(signorini.InvalidInputError, match="hills"):
        _exchange.plain(builder.build(), 0.8)


@pytest.mark.parametrize("turn", [(0, 0, 0, 1), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.5, -0.1, 0.3, -0.2)])
def test_quaternion(turn):
    expected = np.array(turn, dtype=float) / np.linalg.norm(turn)
    from signorini._world import _rotation

    found = np.array(_exchange.quaternion(_rotation(turn, "turn")))
    np.testing.assert_allclose(found * np.sign(found @ expected), expected, atol=1e-15)


def test_an_engine_that_is_not_there_is_named(tmp_path, monkeypatch):
    missing = engines.Engine("mujoco", "Nowhere", "no_such_module", ("nothing",), "-", ("default",))
    monkeypatch.setattr(engines, "ENGINES", (BY_NAME["signorini"], missing))
    monkeypatch.setattr(simulators, "SCENES", {"cube-stack": {"mass_ratio": 1.0, "num_cubes": 2}})
    monkeypatch.setattr(simulators, "QUICK_DURATION", 0.05)
    result = CliRunner().invoke(app, ["experiment", "simulators", "--output", str(tmp_path), "--quick"])
    assert result.exit_code == 0, result.output
    assert "not installed" in result.output
    content = json.loads((tmp_path / "simulators.json").read_text())
    found = content["scenes"]["cube-stack"]["engines"]
    assert found["Nowhere"] == {"error": "not installed"}
    assert found["ours"]["unsolved"] == 0
    assert found["ours"]["overlap"] < 1e-9  # at rest: nothing moves
    assert found["ours"]["error_horizon"] < 1e-9


def test_an_engine_that_dies_is_named(tmp_path):
    _exchange.write(_exchange.plain(robot(), 0.8), robot().initial_q, tmp_path)
    answer = engines.run("/bin/false", BY_NAME["signorini"], "default", tmp_path, time_step=1e-3, steps=1)
    assert "ended with 1" in answer["error"]
    (tmp_path / "model.json").write_text("{}")
    python = engines.interpreter(BY_NAME["signorini"])
    answer = engines.run(python, BY_NAME["signorini"], "default", tmp_path, time_step=1e-3, steps=1)
    assert "KeyError" in answer["error"]


def test_the_judge_knows_a_fall():
    """Free fall by first-order steps is g dt t / 2 ahead of the parabola."""
    start = scenes.worlds()["cube-stack"](num_cubes=1)
    q = np.array(start.q)
    q[2] += 5.0
    model = _exchange.plain(start.world, 0.8)
    world = _exchange.build(model)
    places, horizon, tolerance = simulators.reference(world, q, 0.3, 10)
    assert tolerance == 1e-10
    assert horizon == pytest.approx(0.3)
    simulator = signorini.Simulator(world, time_step=1e-3)
    simulator.state.q = q
    states = [(q.tolist(), [0.0] * 6)]
    for _ in range(30):
        simulator.run(10)
        states.append((simulator.state.q.tolist(), simulator.state.v.tolist()))
    found = simulators.Judge(world, places, horizon)({"states": states})
    expected = 9.81 * 0.3 * (1e-3 - 1e-4) / 2
    assert found["error_horizon"] == pytest.approx(expected, rel=1e-6)
    assert found["energy_change"] == pytest.approx(-9.81 * 9.81 * 0.3 * 1e-3 / 2, rel=1e-6)
    assert found["overlap"] == 0.0
    assert found["parted"] is None


def test_an_unknown_engine_is_said(tmp_path):
    with pytest.raises(signorini.InvalidInputError, match="havok"):
        simulators.run(Options(tmp_path, quick=True), only=("havok",))
