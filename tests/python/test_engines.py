import json

import numpy as np
import pytest
from typer.testing import CliRunner

import signorini
from signorini import engines, scenes
from signorini.cli.main import app
from signorini.engines import _exchange
from signorini.experiments import Options, _plots, _starts, _trials, simulators

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
    monkeypatch.setattr(_trials, "STACK", 4)
    result = CliRunner().invoke(app, ["experiment", "simulators", "--output", str(tmp_path), "--quick"])
    assert result.exit_code == 0, result.output
    assert "not installed" in result.output
    content = json.loads((tmp_path / "simulators.json").read_text())
    found = content["scenes"]["cube-stack"]["engines"]
    assert found["Nowhere"] == {"error": "not installed"}
    assert found["ours"]["unsolved"] == 0
    assert found["ours"]["overlap"] < 1e-9  # at rest: nothing moves
    assert found["ours"]["error_horizon"] < 1e-9
    assert found["ours"]["creep"] < 1e-9
    assert found["ours"]["differs"] == []
    assert set(content["passes"]["Nowhere"].values()) == {None}
    assert set(content["passes"]["ours"].values()) == {True}  # on every trial at once
    for name, trial in content["trials"].items():
        assert trial["ours"]["differs"] == [], name
        assert trial["ours"]["unsolved"] == 0, name
    claims = {verdict["claim"]: verdict for verdict in content["verdicts"]}
    assert claims["trials: who passes every column in one setting"]["measured"] == "ours"
    assert (tmp_path / "simulators-trials.png").exists() == _plots.available()
    page = (tmp_path / "simulators.md").read_text()  # every table, to paste
    for title, (columns, rows) in content["tables"].items():
        assert f"## {title}\n\n| {' | '.join(columns)} |\n| --- |" in page
        assert f"\n| {' | '.join(rows[0])} |\n" in page


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
    short = simulators.Judge(world, places, horizon, at_rest=True)({"states": states[:20]})
    assert short["error_early"] == pytest.approx(expected / 2, rel=1e-6)
    assert short["error_horizon"] is None  # it stopped before
    once = simulators.Judge(world, places, horizon, at_rest=True)({"states": states[:1]})
    assert once["error_early"] is once["error_horizon"] is once["creep"] is None


def test_an_unknown_engine_is_said(tmp_path):
    with pytest.raises(signorini.InvalidInputError, match="havok"):
        simulators.run(Options(tmp_path, quick=True), only=("havok",))


def test_an_unknown_scene_is_said(tmp_path):
    with pytest.raises(signorini.InvalidInputError, match="moon"):
        simulators.run(Options(tmp_path, quick=True), only_scenes=("moon",))


def states(places, period=_trials.PERIOD):
    """An answer of one free body, upright, that was at these places."""
    q = [[*place, 0.0, 0.0, 0.0, 1.0] for place in places]
    return {"states": [[one, [0.0] * 6] for one in q], "steps": 10 * (len(places) - 1)}


def read(name, places):
    (trial,) = (trial for trial in _trials.TRIALS if trial.name == name)
    return trial.judge(states(places), 10 * (len(places) - 1))


def test_the_trials_read_what_was_planted():
    t = np.arange(101) * 0.01
    creeping = np.stack([3e-6 * t + 1e-3 * (t > 0.2), 4e-6 * t, 0.1 + 0 * t], axis=1)
    assert read("slope of 20 deg", creeping)["creep"] == pytest.approx(5e-6)

    acceleration = 0.1 * 0.5 * 9.81
    for name, along in (("slide at 0 deg", [1.0, 0.0]), ("slide at 45 deg", [0.5**0.5, 0.5**0.5])):
        across = np.array([-along[1], along[0]])
        way = 0.5 * 1.2 * acceleration * t**2 + 0.05 * t  # too fast; 0.05 m/s from the start
        places = np.column_stack(
            [np.outer(way, along) + np.outer(0.5 * 0.03 * acceleration * t**2, across), 0.1 + 0 * t]
        )
        places[70, 2] += 2e-5
        found = read(name, places)
        assert found["slide_error"] == pytest.approx(0.2)
        assert found["sideways"] == pytest.approx(0.03)
        assert found["hop"] == pytest.approx(2e-5)

    for e, error in ((0.8, 0.0), (0.0, -1.0), (0.4, -0.75)):
        t = np.arange(61) * 0.01
        fall = (2 * 0.5 / 9.81) ** 0.5
        after = np.maximum(t - fall, 0.0)
        rise = np.maximum(e * 9.81 * fall * after - 0.5 * 9.81 * after**2, 0.0)
        height = np.where(t < fall, 0.5 - 0.5 * 9.81 * t**2, rise)
        found = read("bounce", np.column_stack([0 * t, 0 * t, 0.1 + height]))
        assert found["bounce_error"] == pytest.approx(error, abs=1e-3)


def test_a_stack_that_falls_or_is_stopped():
    (trial,) = (trial for trial in _trials.TRIALS if trial.name.startswith("stack"))
    still = np.tile([0.0, 0.0, 0.1], (11, 1))
    fallen = still.copy()
    fallen[4:, 0] = 0.5
    assert trial.judge(states(still), 100) == {"moved": 0.0, "stood": pytest.approx(0.1)}
    assert trial.judge(states(fallen), 100) == {"moved": 0.5, "stood": pytest.approx(0.04)}
    assert trial.judge(states(still), 5000) == {"moved": None, "stood": pytest.approx(0.1)}  # nobody knows
    assert trial.judge(states(fallen), 5000)["moved"] == 0.5  # it will not stand up again


def test_what_passes():
    good = {"creep": 1e-7, "slide_error": -0.005, "sideways": 0.0, "hop": 1e-6, "moved": 1e-3, "bounce_error": 0.005}
    found = {trial.name: {**good, "failed": False} for trial in _trials.TRIALS}
    assert set(_trials.passes(found).values()) == {True}
    assert len(_trials.passes(found)) == 7

    def without(trial, **changes):
        return _trials.passes({**found, trial: {**found[trial], **changes}})

    assert without("slide at 45 deg", sideways=0.02)["slide at 45 deg"] is False
    assert without("slide at 0 deg", hop=1e-4)["hop"] is False
    assert without("stack 1:1e4", moved=None)["stack"] is None
    assert without("stack 1:1e4", moved=None, failed=True)["stack"] is False
    assert without("bounce", error="ValueError: no coefficient of restitution")["bounce"] is False
    assert set(_trials.passes({name: {"error": "not installed"} for name in found}).values()) == {None}


def test_a_push_is_a_part_of_gravity():
    """A box with the push in its gravity moves as one that is pushed."""
    (trial,) = (trial for trial in _trials.TRIALS if trial.name == "slide at 45 deg")
    model, q = trial.model()
    one = signorini.Simulator(_exchange.build(model), time_step=1e-3)
    one.state.q = q
    other = signorini.Simulator(_trials.block().world, time_step=1e-3)
    other.state.q = q
    other.set_external_wrench("block", np.array([*model["gravity"][:2], 0.0]))  # 1 kg
    one.run(100)
    other.run(100)
    assert one.state.q[0] == pytest.approx(0.1 * 0.5 * 9.81 * 1e-6 * 100 * 101 / 2 / 2**0.5, rel=1e-6)
    np.testing.assert_allclose(one.state.q, other.state.q, atol=1e-10)


def an_answer(world, q):
    """What an engine says that has just this model."""
    model = _exchange.plain(world, 0.8)
    simulator = signorini.Simulator(_exchange.build(model))
    simulator.state.q = q
    inertias = [np.linalg.eigvalsh(link["inertia"]) for link in model["links"]]
    links = [[link["mass"], *i] if link["mass"] else None for link, i in zip(model["links"], inertias, strict=True)]
    report = {"time_step": 1e-3, "gravity": [0, 0, -9.81], "links": links, "limits": 0, "damping": 0.0, "pairs": None}
    mass_matrix = simulator.mass_matrix.tolist()
    total = sum(link["mass"] for link in model["links"])
    state = [q.tolist(), [0.0] * world.num_v]
    answer = {"report": report, "states": [state], "mass_matrix": mass_matrix, "total_mass": total, "touched": []}
    return model, answer


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, None),
        ({"time_step": 2e-3}, "steps of 0.002 s"),
        ({"gravity": [0, 0, -9.8]}, "gravity"),
        ({"limits": 1}, "limits on 1 joints"),
        ({"damping": 0.1}, "damping or dry friction of 0.1"),
    ],
)
def test_another_model_is_said(change, said):
    world = robot()
    q = some_q(world)
    model, answer = an_answer(world, q)
    answer["report"] |= change
    found = simulators.differences(_exchange.build(model), model, q, answer)
    if said is None:
        assert found == []
    else:
        assert len(found) == 1
        assert said in found[0]


def test_another_mass_start_or_pair_is_said():
    world = robot()
    q = some_q(world)
    model, answer = an_answer(world, q)
    built = _exchange.build(model)
    answer["report"]["links"][0][0] *= 1.001
    assert "mass or inertia of trunk" in simulators.differences(built, model, q, answer)[0]
    model, answer = an_answer(world, q)
    answer["report"]["links"][3][2] *= 1.01
    assert "mass or inertia of slide" in simulators.differences(built, model, q, answer)[0]
    model, answer = an_answer(world, q)
    answer["states"][0][0][0] += 1e-4
    assert "starts 1.0e-01 mm off" in simulators.differences(built, model, q, answer)[0]
    model, answer = an_answer(world, q)
    answer["touched"] = [[0, 3], [-1, 3]]
    assert simulators.differences(built, model, q, answer) == ["trunk and slide touched"]  # they exclude each other
    model, answer = an_answer(world, q)
    answer["report"]["pairs"] = [[-1, 0], [0, 3]]
    said = ["the world and slide may not touch", "trunk and slide may touch"]
    assert simulators.differences(built, model, q, answer) == said


def test_every_engine_that_is_here_has_our_model(tmp_path):
    """Of a robot with massless links and turned frames; those that are not installed are not asked."""
    world = robot()
    model = _exchange.plain(world, 0.8)
    q = some_q(world)
    q[2] += 1.0
    _exchange.write(model, q, tmp_path)
    built = _exchange.build(model)
    asked = 0
    for engine in engines.ENGINES:
        python = engines.interpreter(engine)
        if python is None:
            continue
        answer = engines.run(python, engine, engine.settings[0], tmp_path, time_step=1e-3, steps=10)
        assert "error" not in answer, engine.name
        assert simulators.differences(built, model, q, answer) == [], engine.name
        asked += 1
    assert asked >= 1


def test_an_old_version_is_old():
    mujoco = BY_NAME["mujoco"]
    assert mujoco.is_old("3.2.7")
    assert mujoco.is_old("4.0.0")
    assert not mujoco.is_old("4.0.1")
    assert not mujoco.is_old("4.1.0")
    assert not BY_NAME["dart"].is_old("6.1")


def test_mujocos_settings_are_named_as_they_are():
    pytest.importorskip("mujoco")
    from signorini.engines import _mujoco_settings

    assert BY_NAME["mujoco"].settings == _mujoco_settings.SETTINGS
    with pytest.raises(ValueError, match="slow"):
        _mujoco_settings.apply(None, "slow", 1e-3)


def lowest(world, q):
    """Height of the lowest point of robot(): a corner of the box, an end of the capsule, or the ball's bottom [m]."""
    corners = [[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
    shapes = [(corners, 0.0), ([[0, 0, -0.1], [0, 0, 0.1]], 0.05), ([[0, 0, 0]], 0.1)]
    frames, heights = world._core.frame_placements(q), []
    for geometry, (points, radius) in zip(world.geometries[1:], shapes, strict=True):
        on, at = frames[geometry.body], geometry.placement
        in_link = np.array(points) @ at.rotation.T + at.translation
        heights.append((in_link @ on.rotation.T + on.translation)[:, 2].min() - radius)
    return min(heights)


def test_starts_are_near_apart_and_closed():
    world = _exchange.build(_exchange.plain(robot(), 0.8))
    q = some_q(world)
    q[2] += 3.0
    found = _starts.draw(world, q, 5)
    assert np.ptp([lowest(world, one) for one in found]) > 1e-3
    for one in found:
        assert 0.0 <= lowest(world, one) - lowest(world, q) <= _starts.RAISED
        assert not world.touching_pairs(one, 0.0)
        assert 0.0 < 2.0 * np.arccos(abs(q[3:7] @ one[3:7])) <= _starts.TILTED + 1e-9
        assert 0.0 < np.abs(one - q)[7:].max() <= _starts.TURNED
    np.testing.assert_array_equal(_starts.draw(world, q, 5), found)


def test_no_start_where_all_touches_is_said():
    start = scenes.worlds()["cube-stack"](num_cubes=2)
    q = np.array(start.q)
    q[7:10] = q[:3]  # one in the other
    with pytest.raises(signorini.InvalidInputError, match="q: something touches in all of 300"):
        _starts.draw(start.world, q, 2)


def test_starts_of_a_loop_leave_it_closed():
    builder = signorini.WorldBuilder()
    builder.add_ground()
    for name in ("one", "other"):
        builder.add_body(
            name, position=(0, 0, 1.0), joints=[signorini.Joint(name, "free")], mass=1.0, inertia=np.eye(3)
        )
        builder.add_geometry(name, signorini.Sphere(0.1), position=(0.0, 0.5 if name == "one" else -0.5, 0.0))
    builder.add_body(
        "arm", parent="one", position=(0.3, 0, 0), joints=[signorini.Joint("arm")], mass=1.0, inertia=np.eye(3)
    )
    builder.add_connect("arm", "one", (0.1, 0, 0), (0.4, 0, 0))
    world = builder.build()
    for one in _starts.draw(world, world.initial_q, 3):
        assert np.abs(world.constraint_gaps(one)).max() < 1e-12


def test_what_is_said_of_several_starts():
    """Of four: nobody knows the early error in one, the other fails in one, and two differ by rounding."""
    mine = [{"early": e, "end": 0.01 * (k + 1)} for k, e in enumerate([0.1, 0.2, 0.3, None])]
    theirs = [{"early": e, "end": end} for e, end in [(0.2, 0.05), (0.2 - 1e-9, 0.01), (0.1, np.inf), (None, 0.04)]]
    found = _starts.summary(theirs, mine)
    assert found["count"] == 4
    assert found["through"] == 3
    assert found["early"] == {"median": 0.2 - 1e-9, "worst": 0.2, "nearer": 2, "of": 3}
    assert found["end"] == {"median": pytest.approx(0.045), "worst": 0.05, "nearer": 3, "of": 4}
    assert _starts.table({"ours": found, "other": found})[1][1] == [
        "other", "3 of 4", "200", "200", "2 of 3", "45", "50", "3 of 4",
    ]  # fmt: skip


def test_who_gets_through_few_starts_is_not_near():
    """Neither fares better for the starts that it does not get through."""
    fails = {"early": 1e-3, "end": np.inf}
    near, far = ({"early": 1e-3, "end": end} for end in (1e-6, 1.0))
    found = _starts.summary([near, fails, fails], [far, far, fails])
    assert found["through"] == 1
    assert found["end"] == {"median": np.inf, "worst": 1e-6, "nearer": 1, "of": 3}
    assert _starts.summary([fails], [fails])["end"] == {"median": np.inf, "worst": None, "nearer": 0, "of": 1}
    assert _starts.table({"ours": found})[1][0][-3:] == ["inf", "0.001", ""]


def test_errors_from_several_starts_are_those_of_each():
    """Boxes that fall: each is ahead of its reference by that of a first-order step, which halves with the step."""
    start = scenes.worlds()["cube-stack"](num_cubes=1)
    model = _exchange.plain(start.world, 0.8)
    world = _exchange.build(model)
    all_q = [np.array(start.q) + np.array([0, 0, height, 0, 0, 0, 0]) for height in (1.0, 2.0, 1e-3)]
    starts = _starts.prepare(world, all_q, 0.2, 10)
    python = engines.interpreter(BY_NAME["signorini"])
    for refinement in (1, 2):
        found = _starts.errors(starts, model, (BY_NAME["signorini"], "default"), python, 10.0, refinement)
        for one in found[:2]:
            assert one["early"] == pytest.approx(9.81 * 0.15 * (1e-3 / refinement - 1e-4) / 2, rel=1e-6)
            assert one["end"] == pytest.approx(9.81 * 0.2 * (1e-3 / refinement - 1e-4) / 2, rel=1e-6)
        assert found[2]["end"] < 1e-5  # lies there


def planted(ratio, mine, theirs):
    """A scene with what one setting of MuJoCo is like beside ours."""
    ours = {"steps_per_second": 100.0 * ratio, "error_horizon": 1.0, "unsolved": 0, "differs": []}
    other = {"steps_per_second": 100.0, "error_horizon": 2.0, "differs": []}
    early = {"median": 1e-3, "worst": 1e-3}
    found = {
        label: {"count": 3, "early": early, "end": {"median": end, "worst": end}}
        for label, end in (("ours", mine), ("MuJoCo elliptic", theirs))
    }
    return {"engines": {"ours": ours, "MuJoCo elliptic": other}, "starts": {"summary": found}}


@pytest.mark.parametrize(("ratio", "mine", "met"), [(1.1, 3e-3, True), (1.1, 5e-3, False), (0.9, 3e-3, False)])
def test_the_goal_takes_speed_and_the_median(ratio, mine, met):
    scene = planted(ratio, mine, 4e-3)
    claims = {verdict.claim: verdict for verdict in simulators._verdicts("ur5", scene, 10)}
    verdict = claims["ur5: steps/s of MuJoCo elliptic or more, at no larger error"]
    assert verdict.met is met
    assert f"{1e3 * mine:g} mm off, it 4 (median of 3 starts" in verdict.measured
    good = planted(2.0, 1e-3, 4e-3)
    assert simulators._goal({"ur5": scene, "cassie": good}) == []  # not all of the three
    goal, both = simulators._goal({"ur5": scene, "cassie": good, "humanoid": good})
    assert goal.met is met
    assert goal.measured.startswith("3 of 3" if met else "2 of 3; not: ur5")
    assert both.measured == "none"


@pytest.mark.parametrize(
    ("mine", "theirs", "met"),
    [(1e-3, np.inf, True), (np.inf, 1e-3, False), (np.inf, np.inf, False), (None, 1e-3, False), (None, None, False)],
)
def test_who_does_not_get_to_the_end_is_not_as_near(mine, theirs, met):
    scene = planted(1.1, mine, theirs)
    claims = {verdict.claim: verdict for verdict in simulators._verdicts("ur5", scene, 10)}
    assert claims["ur5: steps/s of MuJoCo elliptic or more, at no larger error"].met is met
    goal, _ = simulators._goal({"ur5": scene, "cassie": scene, "humanoid": scene})
    assert goal.met is met
    del scene["starts"]
    scene["engines"]["ours"]["error_horizon"], scene["engines"]["MuJoCo elliptic"]["error_horizon"] = mine, theirs
    claims = {verdict.claim: verdict for verdict in simulators._verdicts("ur5", scene, 10)}
    assert claims["ur5: steps/s of MuJoCo elliptic or more, at no larger error"].met is met


def test_one_start_that_fails_does_not_take_the_others(tmp_path):
    start = scenes.worlds()["cube-stack"](num_cubes=1)
    model = _exchange.plain(start.world, 0.8)
    _exchange.write(model, start.q, tmp_path)
    engine = BY_NAME["signorini"]
    python = engines.interpreter(engine)
    some = [(None, 20), ([0.0, 0.0, 1.0], 20), (None, 20)]  # no configuration of a free body
    one, bad, other = engines.run_all(python, engine, engine.settings[0], tmp_path, some, time_step=1e-3)
    assert one["states"] == other["states"]
    assert one["steps"] == 20
    assert "states" not in bad
    assert "q" in bad["error"]

    judge = simulators.Judge(_exchange.build(model), np.zeros((3, 1, 3)), 0.02)
    starts = [_starts.Start(np.array(start.q), judge), _starts.Start(np.array([0.0, 0.0, 1.0]), judge)]
    found = _starts.errors(starts, model, (engine, engine.settings[0]), python, 10.0)
    assert [np.isfinite(error["end"]) for error in found] == [True, False]
    assert [error["early"] for error in found] == [None, None]  # nobody knows


def test_starts_in_one_process_are_alone(tmp_path):
    """Whoever ran before in the same process leaves nothing behind, in every engine that is here."""
    start = scenes.worlds()["cube-stack"](num_cubes=2, mass_ratio=1.0)
    model = _exchange.plain(start.world, 0.8)
    _exchange.write(model, start.q, tmp_path)
    turned = np.array(start.q)
    turned[3:7] = [0.0, 0.1, 0.0, 0.99**0.5]
    turned[[2, 9]] += 0.05
    for engine in engines.ENGINES:
        python = engines.interpreter(engine)
        if python is None:
            continue
        some = [(None, 60), (turned, 60), (turned, 60)]
        one, two, again = engines.run_all(python, engine, engine.settings[0], tmp_path, some, time_step=1e-3)
        alone = engines.run_all(python, engine, engine.settings[0], tmp_path, some[1:2], time_step=1e-3)[0]
        assert one["states"] != two["states"], engine.name
        assert two["states"] == again["states"] == alone["states"], engine.name
