"""Recordings, and the commands run, replay, scenes."""

import json

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from signorini import InvalidInputError, Simulator, recording, scenes
from signorini.cli.main import app

SMALL = ["--option", "num-cubes=4", "--option", "mass-ratio=10"]


def invoke(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "stack.h5"
    result = invoke("run", "cube-stack", "--duration", 0.2, *SMALL, "--option", "slip=0.3", "--record", path)
    assert result.exit_code == 0, result.output
    return path


def test_run_writes_the_json_that_is_documented():
    result = invoke("run", "cube-stack", "--duration", 0.1, *SMALL, "--json", "-")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert set(content) == {
        "scene", "dt", "steps", "seconds", "steps_per_second", "step_time_us", "contacts", "solver", "certificate",
        "physics", "state_hash",
    }  # fmt: skip
    assert set(content["step_time_us"]) == {"p50", "p99", "p99_9"}
    assert set(content["solver"]) == {"iterations_mean", "factorizations_mean", "unsolved"}
    assert set(content["physics"]) == {"max_penetration_m", "energy_initial_J", "energy_final_J"}
    assert content["steps"] == 100
    assert content["contacts"] == {"mean": 16.0, "max": 16}
    assert content["certificate"]["worst_relative"] <= 1e-6
    # 1 kg to 10 kg, centres at .1, .3, .5, .7 m
    energy = 9.81 * sum(10 ** (i / 3) * (0.1 + 0.2 * i) for i in range(4))
    assert content["physics"]["energy_final_J"] == pytest.approx(energy, rel=1e-6)


def test_a_recording_is_replayed_bit_for_bit(recorded):
    result = invoke("replay", recorded, "--verify")
    assert result.exit_code == 0, result.output
    assert "every state the same" in result.output


def test_a_changed_recording_is_found_out(recorded, tmp_path):
    path = tmp_path / "changed.h5"
    path.write_bytes(recorded.read_bytes())
    with h5py.File(path, "r+") as file:
        file["q"][100, 0] += 1e-15
    result = invoke("replay", path, "--verify")
    assert result.exit_code == 1
    assert "after step 99 differs" in result.output


def test_h5py_alone_reads_it(recorded):
    with h5py.File(recorded) as file:
        assert file.attrs["format"] == "signorini recording"
        assert file["q"].shape == (201, 28)
        assert file["v"].shape == (201, 24)
        assert file["relative"][()].max() <= 1e-6
        assert json.loads(file.attrs["source"])["scene"] == "cube-stack"


def test_an_interrupted_run_leaves_a_readable_recording(tmp_path):
    start = scenes.worlds()["cube-stack"](num_cubes=2)
    simulator = Simulator(start.world)
    path = tmp_path / "interrupted.h5"

    def interrupted():
        with recording.Recorder(path, simulator, {"scene": "cube-stack"}) as recorder:
            recorder.add(simulator.run(10, keep_states=True))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    held = recording.read(path)
    assert (held.num_steps, held.complete) == (10, False)
    assert np.array_equal(held.q[-1], simulator.state.q)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda p: p.write_bytes(p.read_bytes()[:3000]), "not a readable recording"),
        (lambda p: p.write_bytes(b"nothing"), "not a readable recording"),
        (lambda p: p.unlink(), "no such file"),
        (lambda p: edit(p, lambda f: f.attrs.__setitem__("version", 99)), "version 99"),
        (lambda p: edit(p, lambda f: f.attrs.__setitem__("format", "other")), "not a recording"),
        (lambda p: edit(p, lambda f: f.__delitem__("v")), "not a readable recording"),
        (lambda p: edit(p, lambda f: f["q"].resize(5, axis=0)), "damaged"),
    ],
)
def test_damaged_and_newer_recordings_are_refused(recorded, tmp_path, damage, message):
    path = tmp_path / "bad.h5"
    path.write_bytes(recorded.read_bytes())
    damage(path)
    with pytest.raises(InvalidInputError, match=message):
        recording.read(path)
    assert invoke("replay", path).exit_code == 2


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "no-such-scene"),
        ("run", "missing.urdf"),
        ("run", "cube-stack", "--dt", "0"),
        ("run", "cube-stack", "--duration", "-1"),
        ("run", "cube-stack", "--tolerance", "5"),
        ("run", "cube-stack", "--option", "num-cubes"),
        ("run", "cube-stack", "--option", "num-cubes=many"),
        ("run", "cube-stack", "--option", "colour=1"),
        ("run", "cube-stack", "--option", "num-cubes=0"),
    ],
)
def test_bad_input_exits_with_2(arguments):
    result = invoke(*arguments)
    assert result.exit_code == 2, result.output
    assert "error" in result.output.lower()


def test_an_unsolved_step_exits_with_1():
    result = invoke("run", "cube-stack", "--duration", 0.01, "--solver", "pgs", "--tolerance", 1e-14)
    assert result.exit_code == 1


def test_scenes_are_listed():
    result = invoke("scenes")
    assert result.exit_code == 0
    for name in ("cube-stack", "humanoid", "talos-fall", "ur5", "spheres", "boxes"):
        assert name in result.output


def driven_sled(**options):
    from signorini import Box, Joint, WorldBuilder
    from signorini.scenes import Start

    builder = WorldBuilder()
    builder.add_ground()
    slide = Joint("slide", "prismatic", axis=(1, 0, 0))
    builder.add_body("rail", position=(0, 0, 1), joints=[slide], mass=1.0, inertia=np.eye(3))
    builder.add_body("sled", joints=[Joint("sled", "free")], position=(0, 0, 0.1), mass=1.0, inertia=np.eye(3) / 60)
    builder.add_geometry("sled", Box((0.1, 0.1, 0.1)))
    builder.add_motor("push", "slide")
    world = builder.build()
    return Start(world, world.initial_q, np.zeros(world.num_v))


def swing(simulator, start, options):
    """A force that makes the rail a unit mass on a spring: x'' = -w^2 (x - target)."""

    def control():
        simulator.control[0] = -(options["rate"] ** 2) * (simulator.state.q[start.world.q_slice("slide")][0] - 1.0)

    return control


def test_a_scene_with_a_controller_is_driven_recorded_and_replayed(monkeypatch, tmp_path):
    scene = scenes.WorldScene("sled", "driven", 1.0, "here", driven_sled, controller=swing)
    monkeypatch.setattr("signorini.scenes._worlds._SCENES", (scene,))
    path = tmp_path / "sled.h5"
    options = ("--option", "rate=5", "--record", path, "--hardest", tmp_path / "steps")
    result = invoke("run", "sled", "--duration", 0.5, *options)
    assert result.exit_code == 0, result.output
    held = recording.read(path)
    x = held.q[:, 0]
    np.testing.assert_allclose(x, 1.0 - np.cos(5.0 * 1e-3 * np.arange(501)), atol=0.02)
    np.testing.assert_allclose(held.control[:, 0], -25.0 * (x[:-1] - 1.0), atol=1e-12)  # of each step, not of a block
    result = invoke("replay", path, "--verify")
    assert result.exit_code == 0, result.output
    assert invoke("run", "sled", "--duration", 0.5, "--option", "rate=5", "--json", tmp_path / "o.json").exit_code == 0
    assert json.loads((tmp_path / "o.json").read_text())["state_hash"] == held.state_hash  # --hardest changed nothing


def test_a_run_has_controls_or_a_controller():
    world, _, _ = driven_sled()
    simulator = Simulator(world)
    with pytest.raises(InvalidInputError, match="controls"):
        simulator.run(2, np.zeros((2, 1)), controller=lambda: None)
    assert simulator.run(0, controller=lambda: None).controls.shape == (0, 1)
