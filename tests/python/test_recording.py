"""Recordings, and the commands run, replay, scenes."""

import errno
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import h5py
import numpy as np
import pytest
from conftest import REPOSITORY
from typer.testing import CliRunner

from signorini import (
    InvalidInputError,
    Joint,
    Simulator,
    UnsolvedStepError,
    WorldBuilder,
    _hdf5,
    recording,
    scenes,
)
from signorini.cli.main import app
from signorini.view.drawables import body_placements, drawables
from signorini.view.looks import Looks

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
            recorder.run(10)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    held = recording.read(path)
    assert (held.num_steps, held.complete) == (10, False)
    assert np.array_equal(held.q[-1], simulator.state.q)


def test_contacts_and_energy_are_kept(tmp_path):
    """Four cubes at rest: the ground carries their weight; then one of them alone falls, and keeps its energy."""
    start = scenes.worlds()["cube-stack"](num_cubes=4, mass_ratio=10.0)
    simulator = Simulator(start.world, time_step=2e-3)
    with recording.Recorder(tmp_path / "stack.h5", simulator, {}) as recorder:
        recorder.run(23)
        recorder.run(30)
    samples = recording.read(tmp_path / "stack.h5").samples
    assert samples.row.tolist() == [0, *range(5, 51, 5)]  # 10 ms apart, whatever the blocks
    assert len(samples.contacts_of(0)) == 0
    masses = 10.0 ** (np.arange(4) / 3.0)
    body = np.array([geometry.body for geometry in start.world.geometries])
    for row in (5, 17, 53):
        held = samples.contacts_of(samples.at(row))
        assert len(held) == 16
        ground = (body[held.geometries] == 0).any(axis=1)
        up = np.where(body[held.geometries[:, 1]] == 0, -1.0, 1.0)[ground, None] * held.force[ground]
        assert np.allclose(up.sum(axis=0), [0.0, 0.0, 9.81 * masses.sum()], atol=1e-3)
        assert np.allclose(np.abs(held.position[ground]), [0.1, 0.1, 0.0], atol=1e-6)
        assert np.allclose(held.friction, 0.8)
        assert np.abs(held.gap).max() < 1e-6
        assert np.allclose(np.abs(held.normal), [0.0, 0.0, 1.0], atol=1e-6)
    assert np.allclose(samples.potential, 9.81 * masses @ [0.1, 0.3, 0.5, 0.7])

    simulator = Simulator(scenes.worlds()["cube-stack"](num_cubes=1).world)
    simulator.state.q[2] += 1.0
    with recording.Recorder(tmp_path / "fall.h5", simulator, {}, contacts_every=1) as recorder:
        recorder.run(100)
    held = recording.read(tmp_path / "fall.h5")
    assert np.allclose(held.time, 1e-3 * np.arange(101))
    assert np.allclose(held.samples.kinetic, 0.5 * (9.81 * held.time) ** 2, rtol=1e-9)
    assert np.ptp(held.samples.kinetic + held.samples.potential) < 0.5 * 9.81**2 * 1e-3 * 0.1 * (1 + 1e-6)


def test_forces_are_in_world_axes(tmp_path):
    """A cube rests on a slope: what carries it points straight up."""
    from signorini import Box, Joint, Material, WorldBuilder

    builder = WorldBuilder()
    angle, axis = np.radians(15.0), np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)
    slope = (*(np.sin(0.5 * angle) * axis), np.cos(0.5 * angle))
    up = np.cos(angle) * np.array([0, 0, 1.0]) + np.sin(angle) * np.cross(axis, [0, 0, 1.0])
    builder.add_geometry("world", Box((2.0, 2.0, 0.1)), orientation=slope, material=Material(friction=0.8))
    builder.add_body(
        "cube", joints=[Joint("cube", "free")], position=0.2 * up, orientation=slope, mass=2.0, inertia=np.eye(3) / 75
    )
    builder.add_geometry("cube", Box((0.1, 0.1, 0.1)), material=Material(friction=0.8))
    with recording.Recorder(tmp_path / "slope.h5", Simulator(builder.build()), {}) as recorder:
        recorder.run(200)
    samples = recording.read(tmp_path / "slope.h5").samples
    held = samples.contacts_of(len(samples.row) - 1)
    assert len(held) == 4
    assert np.allclose(held.normal, up, atol=1e-5)
    assert np.allclose(held.force.sum(axis=0), [0.0, 0.0, 2.0 * 9.81], atol=1e-3)


def test_as_many_steps_count_as_all_data_sets_have(recorded, tmp_path):
    path = tmp_path / "cut.h5"
    path.write_bytes(recorded.read_bytes())
    with h5py.File(path, "r+") as file:
        file.attrs["complete"] = 0
        file["penetration"].resize(105, axis=0)
        file["contacts/gap"].resize(file["samples/last_contact"][7], axis=0)
    held = recording.read(path)
    assert (held.num_steps, len(held.q), len(held.control)) == (105, 106, 105)
    assert held.samples.row.tolist() == list(range(0, 71, 10))


def test_a_recording_can_be_drawn_without_its_world(tmp_path):
    """Its meshes, put where they belong, are those of the world, and its joints move them as the world's do."""
    start = scenes.worlds()["boxes"](size=5)
    with recording.Recorder(tmp_path / "boxes.h5", Simulator(start.world), {}):
        pass
    looks = recording.read(tmp_path / "boxes.h5").looks
    parts = drawables(start.world)
    assert len(parts) == len(looks.body)
    assert len(looks.meshes) < len(parts)  # all boxes are one
    for i, part in enumerate(parts):
        mesh = looks.meshes[looks.mesh[i]]
        size = np.ptp(part.vertices, axis=0).max()
        assert np.allclose(looks.center[i] + looks.scale[i] * mesh.vertices, part.vertices, atol=1e-4 * size)
        assert np.array_equal(mesh.triangles, part.triangles)
        assert (looks.body[i], looks.collision[i]) == (part.body, part.collision)
        assert np.allclose(looks.color[i], part.color)
    q = start.world.integrate(start.q, np.random.default_rng(0).standard_normal(start.world.num_v), 1.0)
    for ours, theirs in zip(looks.placements(q), body_placements(start.world, q), strict=True):
        assert np.allclose(ours, theirs, atol=1e-14)


def test_joints_of_every_type_move_the_drawing(tmp_path):
    from signorini import Joint, WorldBuilder

    builder = WorldBuilder()
    inertia = np.eye(3)
    builder.add_body("a", joints=[Joint("free", "free")], position=(1, 2, 3), mass=1.0, inertia=inertia)
    for name, kind in (("b", "ball"), ("c", "revolute"), ("d", "prismatic")):
        axis = {} if kind == "ball" else {"axis": (0.6, 0.0, 0.8), "reference": 0.3}
        builder.add_body(
            name, parent="abc"["bcd".index(name)], position=(0.1, 0.2, 0.3), orientation=(0.5, 0.5, 0.5, 0.5),
            joints=[Joint(kind, kind, anchor=(0.0, 0.1, 0.2), **axis)], mass=1.0, inertia=inertia,
        )  # fmt: skip
    world = builder.build()
    looks = Looks.from_arrays(Looks.of(world).arrays())
    q = world.integrate(world.initial_q, np.random.default_rng(0).standard_normal(world.num_v), 1.0)
    for ours, theirs in zip(looks.placements(q), body_placements(world, q), strict=True):
        assert np.array_equal(ours, theirs)


def test_a_free_body_with_armature_or_friction_is_drawn_where_it_is():
    """It has another place in q than plain free bodies."""
    from signorini import Joint, WorldBuilder

    for losses in ({"armature": 0.1}, {"friction": 0.2}):
        builder = WorldBuilder()
        for k, more in enumerate(({}, losses, {})):
            joint = Joint(f"j{k}", "free", **more)
            builder.add_body(f"b{k}", joints=[joint], position=(k, 0, 1), mass=1.0, inertia=np.eye(3))
        world = builder.build()
        looks = Looks.from_arrays(Looks.of(world).arrays())
        assert np.array_equal(looks.placements(world.initial_q)[0], [[0, 0, 0], [0, 0, 1], [1, 0, 1], [2, 0, 1]])


def test_recorded_friction_is_that_of_the_contact():
    """Also where a pair of geometries has a material of its own."""
    from signorini import Box, Joint, Material, WorldBuilder

    builder = WorldBuilder()
    ground = builder.add_ground(Material(friction=0.9))
    builder.add_body("b", joints=[Joint("b", "free")], mass=1.0, inertia=np.eye(3), position=(0, 0, 0.1))
    box = builder.add_geometry("b", Box((0.1, 0.1, 0.1)), material=Material(friction=0.4))
    for expected in (0.6, 0.25):
        simulator = Simulator(builder.build())
        simulator.step()
        assert recording.ContactReader(simulator)().friction == pytest.approx([expected] * 4)
        builder.set_pair_material(ground, box, Material(friction=0.25))


WRITER = """
import sys
from signorini import Simulator, recording, scenes
recording.KEEP_SECONDS = 0.2
start = scenes.worlds()["cube-stack"](num_cubes=2)
with recording.Recorder(sys.argv[1], Simulator(start.world), {"scene": "cube-stack"}) as recorder:
    print("started", flush=True)
    while True:
        recorder.run(20)
"""


def test_a_killed_run_leaves_a_readable_recording(tmp_path):
    path = tmp_path / "killed.h5"
    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as writer:
        try:
            assert writer.stdout.readline() == "started\n"
            while (growing := recording.read(path)).num_steps < 1000:  # read while it is written
                assert writer.poll() is None
                time.sleep(0.05)
        finally:
            writer.kill()
    assert writer.returncode == -signal.SIGKILL
    held = recording.read(path)
    assert held.num_steps >= growing.num_steps >= 1000
    assert (held.complete, held.state_hash) == (False, "")
    assert len(held.q) == len(held.time) == held.num_steps + 1
    assert held.samples.row[-1] > held.num_steps - 20
    world = scenes.worlds()["cube-stack"](num_cubes=2).world
    assert recording.replay(held, Simulator(world, held.settings)) is None
    with h5py.File(path) as file:  # as the documentation says
        assert len(file["q"]) == held.num_steps + 1

    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.raises(InvalidInputError, match="is not a readable recording .*truncated"):
        recording.read(path)


def cube():
    return Simulator(scenes.worlds()["cube-stack"](num_cubes=1).world)


def verified(path):
    """The recording, every step of which is as it was made."""
    held = recording.read(path)
    assert recording.replay(held, cube()) is None
    return held


def test_a_file_is_as_before_or_as_after_at_every_write(tmp_path, monkeypatch):
    """What a writer leaves that is killed then, also halfway through a write."""
    path, simulator = tmp_path / "killed.h5", cube()
    pwrite, ftruncate, left = os.pwrite, os.ftruncate, []
    journaled = []

    def watched_pwrite(descriptor, data, offset):
        if offset < size:  # what is there is overwritten: the journal is whole
            left.append(path.read_bytes())
            journaled.append(left[-1])
        pwrite(descriptor, data[: len(data) // 2], offset)
        left.append(path.read_bytes())
        return pwrite(descriptor, data, offset)

    def watched_ftruncate(descriptor, size):
        left.append(path.read_bytes())
        ftruncate(descriptor, size)

    monkeypatch.setattr(recording, "KEEP_SECONDS", 0.0)
    with recording.Recorder(path, simulator, {}) as recorder:
        recorder.run(5)
        monkeypatch.undo()
        size = path.stat().st_size
        recorder.run(15)
        monkeypatch.setattr(os, "pwrite", watched_pwrite)
        monkeypatch.setattr(os, "ftruncate", watched_ftruncate)
    monkeypatch.undo()
    steps = []
    whole = verified(path)
    for content in left:
        path.write_bytes(content)
        held = recording.read(path)
        steps.append(held.num_steps)
        for name in ("q", "v", "time", "relative", "penetration"):
            assert np.array_equal(getattr(held, name), getattr(whole, name)[: len(getattr(held, name))])
    assert steps == sorted(steps)
    assert set(steps) == {5, 20}
    damaged = bytearray(journaled[0])
    damaged[-100] ^= 1
    path.write_bytes(damaged)
    assert verified(path).num_steps == 5


def test_a_full_disk(tmp_path, monkeypatch):
    """Is told, and costs what there was no space for."""
    monkeypatch.setattr(recording, "KEEP_SECONDS", 0.0)
    path = tmp_path / "full.h5"
    command = ("run", "cube-stack", *SMALL, "--option", "slip=0.3", "--duration", 1, "--record", path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for size in (1000, 100_000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            result = invoke(*command)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert (result.exit_code, result.stderr.strip()) == (2, f"error: {path}: File too large")
        assert path.exists() == (size > 1000)
    assert 0 < recording.read(path).num_steps < 1000
    assert "every state the same" in invoke("replay", path, "--verify").output


def test_space_that_comes_back_loses_nothing(tmp_path, monkeypatch):
    def full(descriptor, data, offset):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path, simulator = tmp_path / "full.h5", cube()
    with recording.Recorder(path, simulator, {}) as recorder:
        monkeypatch.setattr(os, "pwrite", full)
        monkeypatch.setattr(recording, "KEEP_SECONDS", 0.0)
        with pytest.raises(OSError, match=re.escape(str(path))):
            recorder.run(7)
        monkeypatch.undo()
        recorder.run(8)
    assert verified(path).num_steps == 15


@pytest.mark.parametrize("number", [3, 40, 45, 50, 60])
def test_a_write_that_fails_halfway_loses_nothing(tmp_path, monkeypatch, number):
    """Neither now nor when the writer goes on."""
    pwrite, calls = os.pwrite, []

    def failing(descriptor, data, offset):
        calls.append(offset)
        if len(calls) == number:
            pwrite(descriptor, data[: len(data) // 2], offset)
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return pwrite(descriptor, data, offset)

    path = tmp_path / "failing.h5"
    with recording.Recorder(path, cube(), {}) as recorder:
        recorder.run(10)
        monkeypatch.setattr(os, "pwrite", failing)
        monkeypatch.setattr(recording, "KEEP_SECONDS", 0.0)
        with pytest.raises(OSError, match=re.escape(str(path))):
            recorder.run(10)
        monkeypatch.undo()
        assert verified(path).num_steps in (0, 20)
        recorder.run(700)
    assert verified(path).num_steps == 720
    with h5py.File(path) as file:
        assert len(file["q"]) == 721


def test_ctrl_c_at_any_time(tmp_path, monkeypatch):
    """Leaves whole steps; those after it are recorded too, or refused."""
    monkeypatch.setattr(recording, "KEEP_SECONDS", 0.0)
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    path, simulator = tmp_path / "stopped.h5", cube()
    try:
        for delay in np.linspace(1e-4, 2e-2, 12):
            simulator.reset()
            with recording.Recorder(path, simulator, {}) as recorder:
                signal.setitimer(signal.ITIMER_REAL, delay)
                with suppress(KeyboardInterrupt):
                    while True:
                        recorder.run(10)
                with suppress(InvalidInputError):
                    recorder.run(3)
            held = verified(path)
            assert held.complete
            assert len(held.state_hash) == 16
    finally:
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("blocks", [1, 4])
def test_an_error_that_is_caught_leaves_no_hole(tmp_path, blocks):
    """The steps before it are recorded, and those after it."""
    calls = []

    def fail():
        calls.append(0)
        if len(calls) == 6:
            raise RuntimeError("caught")

    path, simulator = tmp_path / "caught.h5", cube()
    with recording.Recorder(path, simulator, {}, contacts_every=20 // blocks) as recorder:
        with pytest.raises(RuntimeError, match="caught"):
            recorder.run(20, controller=fail)
        recorder.run(30)
    held = verified(path)
    assert (held.num_steps, held.samples.row.tolist()[1]) == (35, 20 // blocks)


def test_a_step_that_is_not_solved_is_recorded(tmp_path):
    path = tmp_path / "unsolved.h5"
    world = scenes.worlds()["cube-stack"]().world
    changes = {"solver": "pgs", "tolerance": 1e-14}
    simulator = Simulator(world, **changes, on_unsolved="raise")
    with recording.Recorder(path, simulator, {}) as recorder:
        with pytest.raises(UnsolvedStepError):
            recorder.run(3)
        with suppress(UnsolvedStepError):
            recorder.run(3)
    held = recording.read(path)
    assert held.num_steps == 6
    assert recording.replay(held, Simulator(world, **changes)) is None


def test_steps_that_others_made_are_refused(tmp_path):
    path, simulator = tmp_path / "others.h5", cube()
    with recording.Recorder(path, simulator, {}) as recorder:
        recorder.run(4)
        for change in (simulator.step, lambda: simulator.state.q.__setitem__(2, 3.0), simulator.reset):
            change()
            with pytest.raises(InvalidInputError, match="no longer as after step 4 of .*others.h5"):
                recorder.run(1)
    assert verified(path).num_steps == 4
    with pytest.raises(InvalidInputError, match="closed"):
        recorder.run(1)


def test_a_recording_waits_for_who_reads_it(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "KEEP_SECONDS", 0.2)
    path = tmp_path / "read.h5"
    with recording.Recorder(path, cube(), {}) as recorder:
        with h5py.File(path):
            time.sleep(0.25)
            recorder.run(10)
            assert verified(path).num_steps == 0
        recorder.run(10)
        assert verified(path).num_steps == 20


def test_what_earlier_writers_left_unfinished_is_refused(recorded, tmp_path):
    """They had files marked as being written, where HDF5 waits for ever for what is damaged; h5clear takes it off."""
    path = tmp_path / "killed.h5"
    path.write_bytes(recorded.read_bytes())
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        file.swmr_mode = True
        left = path.read_bytes()
    path.write_bytes(left)
    with pytest.raises(InvalidInputError, match=r"killed.h5: .*h5clear"):
        recording.read(path)


def test_what_is_no_file_cannot_be_a_recording(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path, kind in ((pipe, "a pipe"), ("/dev/null", "a device")):
        result = invoke("run", "cube-stack", *SMALL, "--duration", 0.01, "--record", path)
        assert (result.exit_code, result.stderr.strip()) == (2, f"error: {path}: is {kind}, must be a file")


def num_steps(path):
    """Of a file that somebody may just have begun."""
    try:
        return recording.read(path).num_steps
    except InvalidInputError:
        return 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_run_that_is_stopped_closes_its_recording(tmp_path, number):
    path = tmp_path / "stopped.h5"
    command = [sys.executable, "-c", "from signorini.cli.main import main; main()", "run", "cube-stack"]
    command += ["--duration", "1000", "--record", str(path)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + 60.0
            while num_steps(path) == 0 and time.monotonic() < deadline:
                time.sleep(0.05)
            process.send_signal(number)
            process.wait(timeout=60.0)
        finally:
            process.kill()
    assert process.returncode not in (0, -number)  # it ended by itself
    held = recording.read(path)
    assert not held.complete
    assert held.samples.row[-1] >= held.num_steps - 10
    with h5py.File(path) as file:  # an ordinary file
        assert file.attrs["complete"] == 0
    assert "interrupted" in invoke("replay", path).output


def test_the_blocks_of_its_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (REPOSITORY / "docs" / "recordings.md").read_text()
    written, read = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert "signorini" not in read  # with h5py alone
    exec(written, {})
    exec(read, {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("500 steps, worst certificate ")
    assert [line[:9] for line in lines[1:3]] == ["at 0.01 s", "at 0.02 s"]
    assert len(lines) == 51


def test_every_data_set_is_documented(recorded):
    """The layout's tables and the file name the same."""
    text = (REPOSITORY / "docs" / "recordings.md").read_text()
    names = set()
    with h5py.File(recorded) as file:
        file.visititems(lambda name, item: names.add(name) if isinstance(item, h5py.Dataset) else None)
        words = {*names, *file.attrs}
    missing = [word for word in words if f"`{word}" not in text and f"`{word.split('/')[-1]}" not in text]
    assert not missing


def test_version_1_is_read(tmp_path):
    start = scenes.worlds()["cube-stack"](num_cubes=2)
    simulator = Simulator(start.world)
    before = simulator.save()
    states = simulator.run(30, keep_states=True).states
    with h5py.File(tmp_path / "old.h5", "w") as file:
        file.attrs["format"], file.attrs["version"], file.attrs["complete"] = "signorini recording", 1, 1
        file.attrs["source"], file.attrs["settings"] = '{"scene": "cube-stack"}', "{}"
        file.attrs["time_step"], file.attrs["state_hash"] = 1e-3, simulator.state_hash
        file["start"] = np.frombuffer(before, np.uint8)
        file["q"] = np.vstack([start.q, states[:, : start.q.size]])
        file["v"] = np.vstack([start.v, states[:, start.q.size :]])
        file["control"] = np.zeros((30, 0))
        for name in ("relative", "num_contacts", "seconds"):
            file[name] = np.zeros(30, np.int32 if name == "num_contacts" else float)
    held = recording.read(tmp_path / "old.h5")
    assert np.allclose(held.time, 1e-3 * np.arange(31))
    assert (held.looks, len(held.samples.row), len(held.samples.contacts)) == (None, 0, 0)
    assert recording.replay(held, Simulator(start.world)) is None


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
        (lambda p: edit(p, lambda f: f["contacts/gap"].resize(5, axis=0)), "damaged"),
        (lambda p: edit(p, lambda f: f["samples/row"].__setitem__(3, 0)), "damaged"),
    ],
)
def test_damaged_and_newer_recordings_are_refused(recorded, tmp_path, damage, message):
    path = tmp_path / "bad.h5"
    path.write_bytes(recorded.read_bytes())
    damage(path)
    with pytest.raises(InvalidInputError, match=message):
        recording.read(path)
    assert invoke("replay", path).exit_code == 2


def test_damaged_meshes_are_refused_when_they_are_to_be_drawn(recorded, tmp_path):
    path = tmp_path / "bad.h5"
    path.write_bytes(recorded.read_bytes())
    edit(path, lambda f: f["looks/body"].__setitem__(0, 9999))
    for arguments in (("view", path, "--html", tmp_path / "x.html"), ("picture", path, tmp_path / "x.png")):
        result = invoke(*arguments)
        assert result.exit_code == 2
        assert "looks: are damaged" in result.stderr


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


def test_units_are_printed():
    assert "steps of [ms]" in invoke("run", "cube-stack", "--duration", "0.001").stdout
    assert "[s]" in invoke("scenes").stdout


def test_scenes_are_listed():
    result = invoke("scenes")
    assert result.exit_code == 0
    for name in ("cube-stack", "humanoid", "talos-fall", "ur5", "spheres", "boxes"):
        assert name in result.output


def driven_sled(rate=1.0):
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


def test_an_interruption_before_the_end_is_written_costs_nothing(tmp_path, monkeypatch):
    path, came = tmp_path / "ends.h5", []

    @contextmanager
    def interrupted():
        if not came:
            came.append(1)
            raise KeyboardInterrupt
        yield

    recorder = recording.Recorder(path, cube(), {})
    recorder.run(10)
    monkeypatch.setattr("signorini._hdf5.signals_later", interrupted)
    with pytest.raises(KeyboardInterrupt):
        recorder.__exit__(None, None, None)
    held = verified(path)
    assert (held.num_steps, held.complete) == (10, False)


def test_handlers_are_the_same_after_writing_and_see_what_came_meanwhile():
    came = []
    before = signal.signal(signal.SIGALRM, lambda *_: came.append("late"))
    handlers = [signal.getsignal(number) for number in signal.Signals]
    try:
        with _hdf5.signals_later():
            signal.raise_signal(signal.SIGALRM)
            assert came == []
        assert came == ["late"]
        assert [signal.getsignal(number) for number in signal.Signals] == handlers
    finally:
        signal.signal(signal.SIGALRM, before)


def test_controls_are_one_row_a_step(tmp_path):
    start = driven_sled()
    path = tmp_path / "sled.h5"
    with recording.Recorder(path, Simulator(start.world), {}, 2) as recorder:
        for rows in (4, 6):
            with pytest.raises(InvalidInputError, match=rf"controls: has shape \({rows}, 1\), must be \(5, 1\)"):
                recorder.run(5, np.zeros((rows, 1)))
        recorder.run(5, np.ones((5, 1)))
    assert recording.read(path).control.tolist() == [[1.0]] * 5


def test_a_run_has_controls_or_a_controller():
    world, _, _ = driven_sled()
    simulator = Simulator(world)
    with pytest.raises(InvalidInputError, match="controls"):
        simulator.run(2, np.zeros((2, 1)), controller=lambda: None)
    assert simulator.run(0, controller=lambda: None).controls.shape == (0, 1)


def test_a_bad_source_leaves_what_was_there(tmp_path):
    path = tmp_path / "kept.h5"
    path.write_bytes(b"precious")
    simulator = Simulator(scenes.worlds()["cube-stack"](num_cubes=1).world)
    for source in ({"a": object()}, 5):
        with pytest.raises(InvalidInputError, match="source: is .*JSON"):
            recording.Recorder(path, simulator, source)
    assert path.read_bytes() == b"precious"


def changed(recorded, tmp_path, change):
    path = tmp_path / "changed.h5"
    path.write_bytes(recorded.read_bytes())
    edit(path, change)
    return path


def attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def replaced(name, change):
    def edited(file):
        values = change(file[name][()])
        del file[name]
        file[name] = values

    return edited


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (attribute("source", "[]"), r"source: is \[\], must be a JSON object"),
        (attribute("source", "{"), "source: is not JSON"),
        (attribute("source", 5), "source: is .*5.*, must be printable text"),
        (attribute("source", b"\xff"), "source: is .*, must be printable text"),
        (attribute("source", "[" * 3000), "source: is not JSON"),
        (attribute("settings", "null"), "settings: is None, must be a JSON object"),
        (attribute("settings", '{"time_step": "a"}'), "settings: time_step: is 'a'"),
        (attribute("settings", '{"solver": []}'), r"settings: solver: is \[\]"),
        (attribute("settings", '{"time_step": NaN}'), "settings: time_step: is nan"),
        (attribute("time_step", np.nan), "time_step: is .*nan.*, must be 0.001"),
        (attribute("time_step", 2e-3), "time_step: is .*0.002.*, must be 0.001"),
        (attribute("state_hash", np.arange(3)), "state_hash: is .*, must be printable text"),
        (attribute("version", np.inf), "version: is .*inf.*, must be an integer"),
        (attribute("version", 0), "version: is .*0.*, must be an integer"),
        (attribute("complete", "yes"), "complete: is 'yes', must be an integer"),
        (attribute("contacts_every", np.nan), "contacts_every: is .*nan.*, must be an integer"),
        (lambda f: f.attrs.__delitem__("source"), "source: is missing"),
        (lambda f: f["time"].__setitem__(7, np.nan), r"time\[7\]: is nan, must be finite"),
        (replaced("q", lambda q: q[:, :, None]), "q: has shape .*, must have 2 dimensions"),
        (replaced("q", lambda q: q.astype(complex)), "q: has entries of type complex128, must be numbers"),
        (replaced("q", lambda q: np.vstack([q, q])), "q has 402 rows, must have 201"),
        (replaced("relative", lambda r: np.array([b"a"] * len(r))), "relative: has entries .*, must be numbers"),
        (replaced("num_contacts", lambda n: n.astype(float)), "num_contacts: has entries .*, must be integers"),
        (replaced("start", lambda s: h5py.Empty(s.dtype)), "start: has shape None"),
        (replaced("samples/row", lambda r: r.astype(np.int64) - 1), "samples: has rows that do not grow"),
        (replaced("contacts/force", lambda f: f[:, :2]), "contacts/force: has shape .*, must have 3 columns"),
    ],
)
def test_every_claim_of_a_recording_is_checked(recorded, tmp_path, change, message):
    path = changed(recorded, tmp_path, change)
    with pytest.raises(InvalidInputError, match=rf"changed\.h5: .*{message}"):
        recording.read(path)
    assert invoke("replay", path, "--verify").exit_code == 2


def test_flags_that_no_writer_sets_are_damage(recorded, tmp_path):
    """Taken for those of an unfinished file, HDF5 would wait for somebody to mend it."""
    content = bytearray(recorded.read_bytes())
    content[11] = 61
    (tmp_path / "flags.h5").write_bytes(content)
    with pytest.raises(InvalidInputError, match="not a readable recording"):
        recording.read(tmp_path / "flags.h5")


def test_a_recording_claims_no_more_than_its_file_holds(recorded, tmp_path):
    def claim(file):
        del file["seconds"]
        file.create_dataset("seconds", (2**37,), float, chunks=(2**20,))

    with pytest.raises(InvalidInputError, match="seconds: claims 137438953472 entries"):
        recording.read(changed(recorded, tmp_path, claim))


@pytest.mark.parametrize(
    "source",
    [
        {}, {"scene": []}, {"scene": None}, {"scene": "cube-stack", "options": []}, {"file": 5}, {"file": "a\0b"},
        {"scene": "cube-stack", "options": {"num_cubes": None}}, {"file": "ROBOT", "ground": []},
        {"file": "ROBOT", "ground": "x"},
    ],
)  # fmt: skip
def test_a_source_that_nothing_can_be_made_of(recorded, tmp_path, source):
    robot = tmp_path / "robot.urdf"
    robot.write_text('<robot name="r"><link name="a"/></robot>')
    text = json.dumps(source).replace("ROBOT", str(robot))
    path = changed(recorded, tmp_path, attribute("source", text))
    assert invoke("replay", path).exit_code == 0
    result = invoke("replay", path, "--verify")
    assert result.exit_code == 2
    assert "error: " in result.stderr


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda f: f["q"].__setitem__((0, 2), f["q"][0, 2] + 1e-15), "at the start"),
        (lambda f: f["time"].__setitem__(0, 1e-4), "at the start"),
        (lambda f: f["time"].__setitem__(7, 0.0), "after step 6"),
        (lambda f: f["relative"].__setitem__(150, 1e-30), "after step 150"),
        (lambda f: f["penetration"].__setitem__(3, np.nan), "after step 3"),
        (lambda f: f["num_contacts"].__setitem__(199, 1), "after step 199"),
    ],
)
def test_verify_compares_all_that_a_step_says(recorded, tmp_path, change, where):
    result = invoke("replay", changed(recorded, tmp_path, change), "--verify")
    assert result.exit_code == 1
    assert f"state {where} differs" in result.stderr


@pytest.mark.parametrize("steps", [0, 10])
def test_a_hash_that_differs_is_said_to(tmp_path, steps):
    path = tmp_path / "stack.h5"
    simulator = Simulator(scenes.worlds()["cube-stack"]().world)
    with recording.Recorder(path, simulator, {"scene": "cube-stack"}) as recorder:
        recorder.run(steps)
    assert invoke("replay", path, "--verify").exit_code == 0
    edit(path, attribute("state_hash", "0123456789abcdef"))
    result = invoke("replay", path, "--verify")
    assert (result.exit_code, result.stderr.strip()) == (1, "error: hash of the last state differs")


def test_what_came_after_the_last_recorded_step_is_no_difference(tmp_path):
    def fail():
        raise RuntimeError("caught")

    world = scenes.worlds()["cube-stack"](num_cubes=1).world
    simulator = Simulator(world)
    for after in (lambda _: simulator.step(3), lambda _: simulator.reset(), lambda r: r.run(5, controller=fail)):
        with recording.Recorder(tmp_path / "r.h5", simulator, {}) as recorder:
            recorder.run(13)
            with suppress(RuntimeError):
                after(recorder)
        held = recording.read(tmp_path / "r.h5")
        assert (held.complete, held.num_steps, len(held.state_hash)) == (True, 13, 16)
        assert recording.replay(held, Simulator(world)) is None


def test_a_recording_without_a_hash_is_replayed(recorded, tmp_path):
    assert invoke("replay", changed(recorded, tmp_path, attribute("state_hash", "")), "--verify").exit_code == 0


def test_rounding_of_the_time_is_no_difference(tmp_path):
    """Tiny steps at a late time, recorded in a block of 10 000."""
    builder = WorldBuilder()
    builder.add_body("ball", joints=[Joint("fall", "free")], mass=1.0, inertia=np.eye(3))
    world = builder.build()
    simulator = Simulator(world, time_step=1e-6)
    simulator.state.time = 1e4
    with recording.Recorder(tmp_path / "late.h5", simulator, {}) as recorder:
        recorder.run(10_000)
    held = recording.read(tmp_path / "late.h5")
    assert recording.replay(held, Simulator(world, time_step=1e-6)) is None
    held.time[5000] += 0.2e-6
    assert recording.replay(held, Simulator(world, time_step=1e-6)) == 4999


def test_a_recording_by_another_version_is_viewed_not_replayed(recorded, tmp_path):
    def older(start):
        tag = b"signorini state 5"
        assert start.tobytes()[8:].startswith(tag)
        return np.frombuffer(start.tobytes()[:-8].replace(tag, b"signorini state 4"), np.uint8)

    path = changed(recorded, tmp_path, replaced("start", older))
    assert invoke("replay", path).exit_code == 0
    assert invoke("view", path, "--html", tmp_path / "page.html").exit_code == 0
    result = invoke("replay", path, "--verify")
    assert result.exit_code == 2
    assert "changed.h5: was recorded by another version of signorini" in result.stderr


def test_looks_that_do_not_fit(recorded, tmp_path):
    for name in ("body", "mesh", "center", "scale", "color", "collision", "flat", "vertices", "triangles", "names"):
        for change in (lambda v: v[:-1], lambda v: v[..., None], lambda v: 5, lambda v: v.astype(float) * np.nan):
            held = recording.read(changed(recorded, tmp_path, replaced(f"looks/{name}", change)))
            with pytest.raises(InvalidInputError, match="looks: are damaged"):
                _ = held.looks
    for geometry in (99, -1):
        path = changed(recorded, tmp_path, lambda f, to=geometry: f["contacts/geometries"].__setitem__((3, 0), to))
        held = recording.read(path)
        with pytest.raises(InvalidInputError, match="contacts/geometries: name geometries"):
            _ = held.looks
    held = recording.read(changed(recorded, tmp_path, replaced("q", lambda q: q[:, :-1])))
    with pytest.raises(InvalidInputError, match="looks: are damaged"):
        _ = held.looks
