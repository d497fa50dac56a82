import json

import numpy as np
import pytest
from typer.testing import CliRunner

import signorini
from signorini import Equality, FrictionCone, HalfLine, Interval, fclib, peers
from signorini.cli.main import app
from signorini.experiments import Options, timings
from signorini.experiments.timings import Step, carried, measure, record_steps, solvers, write_problems

NUM_STEPS = 12


@pytest.fixture
def short(monkeypatch):
    """A dozen steps of the stack alone."""
    monkeypatch.setattr(timings, "STEPS", {"cube-stack": NUM_STEPS})
    monkeypatch.setattr(timings, "QUICK_STEPS", NUM_STEPS)


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mixed_problem(seed):
    """Two contacts, a limit, joint friction and an equality, coupled."""
    random = np.random.default_rng(seed)
    kinds = [FrictionCone(0.5), HalfLine(), Interval(-0.3, 0.2), FrictionCone(0.8), Equality()]
    rows = 9
    jacobian = random.standard_normal((rows, 12))
    return signorini.ContactProblem(jacobian @ jacobian.T, random.standard_normal(rows), constraints=kinds)


def test_a_contact_keeps_its_impulse_in_the_world():
    random = np.random.default_rng(0)
    friction = [FrictionCone(0.5)] * 3
    problem = signorini.ContactProblem(np.eye(11), np.zeros(11), constraints=[*friction, HalfLine(), Interval(-1, 1)])
    before = Step(problem, [7, 8, 9], np.array([rotation(a) for a in random.uniform(0, 6, 3)]), 1)
    now = Step(problem, [9, 5, 7], np.array([rotation(a) for a in random.uniform(0, 6, 3)]), 2)
    impulse = random.standard_normal(11)
    guess = carried(before, impulse, now)

    def world(step, x, k):
        return step.frames[k] @ x[3 * k : 3 * k + 3]

    np.testing.assert_allclose(world(now, guess, 0), world(before, impulse, 2), atol=1e-14)  # 9
    np.testing.assert_array_equal(guess[3:6], 0.0)  # 5 is new
    np.testing.assert_allclose(world(now, guess, 2), world(before, impulse, 0), atol=1e-14)  # 7
    np.testing.assert_array_equal(guess[9:], impulse[9:])


def test_another_number_of_limits_starts_at_zero():
    one = signorini.ContactProblem(np.eye(2), np.zeros(2), constraints=[HalfLine(), Interval(-1, 1)])
    two = signorini.ContactProblem(np.eye(3), np.zeros(3), constraints=[HalfLine(), HalfLine(), Interval(-1, 1)])
    none = np.zeros((0, 3, 3))
    guess = carried(Step(one, [], none, 1), np.array([0.5, -0.25]), Step(two, [], none, 2))
    np.testing.assert_array_equal(guess, [0.0, 0.0, -0.25])


def test_steps_are_the_simulators_own():
    steps = list(record_steps("cube-stack", NUM_STEPS, 4, num_cubes=3))
    assert [step.number for step in steps] == [4, 8, 12]
    for step in steps:
        assert len(step.ids) == len(set(step.ids)) == step.problem.num_contacts == 12
        solution = signorini.solve(step.problem, tolerance=1e-10)  # mass ratios cost digits
        total = sum(step.frames[k] @ solution.impulse[3 * k : 3 * k + 3] for k in range(4))  # the lowest interface
        weight = 9.81e-3 * np.geomspace(1.0, 1e4, 3).sum()
        np.testing.assert_allclose(np.abs(total), [0.0, 0.0, weight], atol=1e-5 * weight)


def test_everybody_starts_warm_where_it_ended():
    items = measure(record_steps("cube-stack", NUM_STEPS, num_cubes=3, mass_ratio=1.0), solvers(), 1)
    assert len(items) == NUM_STEPS
    for key, last in items[-1]["runs"].items():
        assert last["relative"] <= 1e-4, key
        if key.endswith("warm"):  # a stack at rest: the impulse of the step before still holds
            cold = items[-1]["runs"][key.replace("warm", "cold")]
            assert last["iterations"] <= cold["iterations"], key
    assert items[0]["runs"].keys() == items[-1]["runs"].keys()
    assert any(item["runs"]["PGS, warm"]["iterations"] == 0 for item in items)


@pytest.mark.parametrize("seed", range(5))
def test_scs_takes_every_constraint(seed):
    pytest.importorskip("scs")
    problem = mixed_problem(seed)
    ours = signorini.solve(problem, law="ccp", tolerance=1e-10)
    assert ours.solved
    cold = peers.scs.solve_ccp(problem, 1e-9, 20000)
    assert cold.solved
    assert cold.residual.relative <= 1e-6
    np.testing.assert_allclose(problem.velocity(cold.impulse), ours.velocity, atol=1e-5)
    warm = peers.scs.solve_ccp(problem, 1e-6, 20000, ours.impulse)
    assert warm.solved
    assert warm.iterations == 0  # y and s of the guess are those of a solution
    assert peers.scs.solve_ccp(problem, 1e-6, 20000).iterations > 0


def test_problems_are_written_and_solved(tmp_path, short):
    report = timings.run(Options(tmp_path, quick=True, with_peers=False), tmp_path / "problems")
    assert any(f"all {NUM_STEPS} problems written" in note for note in report.notes)
    files = sorted((tmp_path / "problems" / "cube-stack").glob("*.hdf5"))
    steps = list(record_steps("cube-stack", NUM_STEPS))
    assert len(files) == NUM_STEPS
    for file, step in zip(files, steps, strict=True):
        solution = signorini.solve(fclib.read(file), tolerance=1e-8)
        assert solution.solved
        assert signorini.residual(step.problem, solution.impulse).solves(1e-8)  # the same problem


def test_what_fclib_cannot_hold_is_said(tmp_path):
    random = np.random.default_rng(2)
    jacobian = random.standard_normal((5, 7))
    kinds = [FrictionCone(0.5), Interval(-1, 1), HalfLine()]
    dry = signorini.ContactProblem(jacobian @ jacobian.T, random.standard_normal(5), constraints=kinds)
    plain = signorini.ContactProblem(np.eye(4), -np.ones(4), constraints=[FrictionCone(0.5), HalfLine()])
    given = [Step(problem, [0], np.eye(3)[None], k) for k, problem in enumerate([dry, dry, plain, dry], 1)]
    without = []
    assert list(write_problems(iter(given), tmp_path, "some", without)) == given
    assert without == [1, 2, 4]
    files = sorted((tmp_path / "some").iterdir())
    assert [file.name for file in files] == [f"some-00000{k}.hdf5" for k in (1, 2, 3, 4)]
    assert timings._written("some", 4, without).endswith(": 1-2, 4")

    # The bodies with smooth joints: nothing but the contact and the limit pushes.
    rows = [0, 1, 2, 4]
    smooth = signorini.ContactProblem(
        (jacobian @ jacobian.T)[np.ix_(rows, rows)], dry.free_velocity[rows], constraints=[kinds[0], kinds[2]]
    )
    expected = signorini.solve(smooth, tolerance=1e-10)
    found = signorini.solve(fclib.read(files[0]), tolerance=1e-10)
    assert expected.solved
    assert found.solved
    np.testing.assert_allclose(found.velocity[[0, 1, 2, 5]], expected.velocity, atol=1e-8)


def test_timings(tmp_path, short):
    result = CliRunner().invoke(app, ["experiment", "timings", "--quick", "--output", str(tmp_path)])
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "timings.json").read_text())
    found = content["scenes"]["cube-stack"]["solvers"]
    for name in ("auto", "ADMM (paper)", "ADMM", "PGS", "PGS, CCP"):
        for start in ("cold", "warm"):
            one = found[f"{name}, {start}"]
            assert one["milliseconds"]["count"] == NUM_STEPS
            assert 0.0 < one["milliseconds"]["median"] <= one["milliseconds"]["p99"] <= one["milliseconds"]["max"]
    assert found["auto, cold"]["share_solved"] == found["auto, warm"]["share_solved"] == 1.0
    assert content["tables"]
    for verdict in content["verdicts"]:
        assert verdict["claim"] in result.output
