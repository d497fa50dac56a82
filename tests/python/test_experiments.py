import json

import numpy as np
import pytest
from test_solve import rod_between_walls
from typer.testing import CliRunner

import signorini
from signorini import fclib, scenes
from signorini.cli.main import app
from signorini.experiments import (
    DataMissingError,
    Options,
    _plots,
    convergence,
    data_directory,
    inverse,
    inverse_checks,
    profiles,
    robustness,
    scaling,
)
from signorini.experiments import scenes as scene_speeds
from signorini.experiments._data import problem_files
from signorini.experiments._report import Report, RunLog, Verdict, summary
from signorini.experiments._runs import REPEATS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three small problems a family."""
    data = tmp_path_factory.mktemp("data")
    make = {
        "boxes_stack": lambda k: scenes.cube_stack(k + 1, 10.0),
        "capsules": lambda k: scenes.pile(10 + k, k),
        "chain": lambda k: scenes.chain(5, k),
    }
    for family, made in make.items():
        (data / family).mkdir()
        for k in range(3):
            fclib.write(data / family / f"{family}-{k}.hdf5", made(k))
    return data


def run(*arguments):
    return CliRunner().invoke(app, ["experiment", *(str(argument) for argument in arguments)])


def load(path):
    def no_constants(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(path.read_text(), parse_constant=no_constants)


@pytest.mark.parametrize("name", ["profiles", "updates", "robustness", "peers"])
def test_an_experiment_writes_its_numbers(folder, tmp_path, name):
    output = tmp_path / "deep" / name
    without = ["--no-peers"] if name == "profiles" else []
    result = run(name, "--output", output, "--data", folder, *without)
    assert result.exit_code == 0, result.output
    content = load(output / f"{name}.json")
    assert content["environment"]["signorini"] == signorini.__version__
    assert content["environment"]["build"]
    assert content["verdicts"]
    for verdict in content["verdicts"]:
        assert verdict["claim"] in result.output
    assert (output / f"{name}.png").exists() == _plots.available()


def test_inverse(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    pytest.importorskip("pinocchio")
    try:
        scenes.robots_folder()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(inverse_checks, "QUICK_STATES", 2)
    monkeypatch.setattr(inverse, "TALOS_PUSH", 5.0)
    result = run("inverse", "--output", tmp_path, "--quick")
    assert result.exit_code == 0, result.output
    content = load(tmp_path / "inverse.json")
    assert all(verdict["met"] is not False or "time" in verdict["claim"] for verdict in content["verdicts"])
    assert (tmp_path / "inverse.png").exists() == _plots.available()


def test_convergence(tmp_path):
    result = run("convergence", "--output", tmp_path, "--quick")
    assert result.exit_code == 0, result.output
    content = load(tmp_path / "convergence.json")
    for problem in content["problems"].values():
        for curve in problem["methods"].values():
            assert len(curve["dual"]) == len(curve["complementarity"]) == len(curve["iteration"])
            if curve["iterations_to_target"] is not None and curve["dual"]:
                assert max(curve["dual"][-1], curve["complementarity"][-1]) <= content["target"]


def test_talos_lies_there():
    """Its contacts carry its weight."""
    try:
        scenes.robots_folder()
    except FileNotFoundError as error:
        pytest.skip(str(error))
    problem = convergence.talos()
    assert problem.num_contacts > 20
    start = scenes.worlds()["talos-fall"]()
    weight = 9.81 * sum(body.mass for body in start.world.bodies)
    solution = signorini.solve(problem, tolerance=1e-9)
    normal = solution.impulse[: 3 * problem.num_contacts].reshape(-1, 3)[:, 2]
    assert solution.solved
    assert normal.sum() > 0.8 * weight * 1e-3  # links that press on each other add to it


def test_scaling(tmp_path, monkeypatch):
    monkeypatch.setattr(scaling, "QUICK_SIZES", (20, 40))
    report = scaling.run(Options(tmp_path, quick=True))
    for shape in report.numbers["shapes"].values():
        assert [point["contacts"] for point in shape["points"]] == [20, 40]
        assert all(0.0 < point["peak_gib"] < 2.0 for point in shape["points"])


def test_profiles_are_distributions(folder, tmp_path):
    report = profiles.run(Options(tmp_path, folder, with_peers=False))
    for family in report.numbers["families"].values():
        fastest = 0.0
        for solver in family["solvers"].values():
            tau, share = solver["profile"]["tau"], solver["profile"]["share"]
            assert tau == sorted(tau)
            assert all(value >= 1.0 for value in tau)
            assert share == sorted(share)
            assert (share[-1] if share else 0.0) == pytest.approx(solver["share_solved"])
            assert solver["share_relative"] <= solver["share_solved"]
            fastest += solver["share_fastest"]
        assert fastest >= 1.0 - 1e-12  # some solver is the fastest of each problem


def planted(*times):
    """Problems with these times of auto, admm, admm (paper); None: not solved."""

    def one(seconds):
        good, bad = {"relative": 1e-7}, {"relative": 1.0}
        some = {"against_free_velocity": 0.0, "primal": 1.0, "dual": 1.0, "complementarity": 1.0}
        return {**some, **(good if seconds is not None else bad), "seconds": seconds or 1.0}

    names = ("auto", "admm", "admm (paper)")
    return [{"runs": dict(zip(names, map(one, row), strict=True))} for row in times], list(names)


def test_the_share_of_problems_near_the_best():
    many = [(1.0, 2.0, 3.0)] * 19
    found = profiles._near(*planted(*many, (1.6, 1.0, 3.0)))
    assert found["share_near"] == found["share_best"] == 0.95
    assert found["share_near_others"] == 1.0  # ADMM is ours too
    assert profiles._claim("all", found).met is True
    found = profiles._near(*planted(*many[1:], (1.5, 1.0, 1.0), (1.6, 1.0, 1.0), (1.6, None, 1.0)))
    assert found["share_near"] == 19 / 21
    assert found["share_near_others"] == 19 / 21
    assert profiles._claim("all", found).met is False
    found = profiles._near(*planted(*many, *many, (None, None, None)))
    assert found["share_solved"] == 38 / 39
    assert found["share_near"] == found["share_near_others"] == 38 / 39  # what nobody solves is not near anything
    assert profiles._claim("all", found).met is False  # 97 %, but not solving all


def test_table_2_stands_beside_the_papers(folder, tmp_path):
    report = profiles.run(Options(tmp_path, folder, with_peers=False))
    columns, rows = report.tables["Table II: the problems"]
    assert [row[0] for row in rows] == ["boxes_stack", "chain", "capsules"]
    stacks = dict(zip(columns[:2], rows[0], strict=False))
    assert stacks["problems"] == "3"
    assert rows[0][3] == "4-12"  # 4 contacts a cube
    assert rows[0][5] == "6-18"  # 6 degrees of freedom
    assert [rows[0][k] for k in (2, 4, 6, 8)] == ["255", "0-200", "6-300", "0.7"]
    assert report.verdicts[0].claim.startswith("all problems: ours best or within 1.5 times")


def test_an_interrupted_run_goes_on(folder, tmp_path, monkeypatch):
    robustness.run(Options(tmp_path, folder), ("as is",))
    first = load(tmp_path / "robustness.json")
    log = tmp_path / "robustness.runs.jsonl"
    lines = log.read_text().splitlines()
    assert len(lines) == 1 + 9
    log.write_text("\n".join(lines[:-1]) + "\n" + lines[-1][:20])  # cut off while it was writing
    counted = []
    solve = signorini.solve
    monkeypatch.setattr(signorini, "solve", lambda *args, **named: counted.append(1) or solve(*args, **named))
    robustness.run(Options(tmp_path, folder), ("as is",))
    assert 1 <= len(counted) <= 2 * REPEATS  # the one that was cut off, measured up to so often, warmed up before each
    assert load(tmp_path / "robustness.json")["stresses"].keys() == first["stresses"].keys()
    counted.clear()
    robustness.run(Options(tmp_path, folder, fresh=True), ("as is",))
    assert len(counted) >= 9


def test_robustness_in_processes_says_so(folder, tmp_path):
    report = robustness.run(Options(tmp_path, folder, workers=2, families=("chain",)), ("as is", "friction 0"))
    assert set(report.numbers["stresses"]) == {"as is", "friction 0"}
    assert set(report.numbers["stresses"]["as is"]) == {"chain"}
    assert any("not to be quoted" in note for note in report.notes)
    columns, rows = report.tables["Solved; factorisations, median and most"]
    assert columns == ["variant", "solved", "chain"]
    runs = report.numbers["stresses"]["friction 0"]["chain"]
    count = runs["factorizations"]
    assert rows[1] == ["friction 0", f"{runs['solved']} of 3", f"{count['median']:.0f}, {count['max']:.0f}"]


def test_robustness_proves_of_each_file_its_own(tmp_path):
    """Files of one name in two families: one has no solution, which auto alone does not say."""
    data = tmp_path / "data"
    jams = rod_between_walls(1.0, closing=0.02, beside=1.0)
    for family, problem in (("chain", jams), ("stack", scenes.cube_stack(2, 10.0))):
        (data / family).mkdir(parents=True)
        fclib.write(data / family / "same.hdf5", problem)
    fclib.write(data / "stack" / "RockPile_tob1.hdf5", scenes.cube_stack(1, 10.0))  # solved, and does not count
    report = robustness.run(Options(tmp_path, data), ("as is",))
    assert signorini.solve(jams, tolerance=1e-8).status != "infeasible"
    found = report.numbers["stresses"]["as is"]
    assert [found[family]["solved"] for family in ("chain", "stack")] == [0, 2]
    assert [found[family]["proven_without_solution"] for family in ("chain", "stack")] == [1, 0]
    _, rows = report.tables["Solved; factorisations, median and most"]
    assert rows[0][:2] == ["as is", "1 of 2; 1 proven to have no solution"]
    (verdict,) = (one for one in report.verdicts if one.claim == "as is: solved to 1e-8")
    assert verdict.measured == "1 of 2 (RockPile_tob1 aside), 1 proven to have no solution, 0 open"
    assert verdict.met


def test_scenes(tmp_path, monkeypatch):
    monkeypatch.setattr(scene_speeds, "RUNS", (("cube-stack", {"num_cubes": 2}, 0.2), ("spheres", {"size": 1000}, 0.2)))
    report = scene_speeds.run(Options(tmp_path, quick=True))
    columns, ((title, bodies, contacts, *_),) = report.tables["Scenes"]  # no large one
    assert columns[:3] == ["scene", "bodies", "contacts, mean and most"]
    assert (title, bodies, contacts) == ("cube-stack num_cubes=2, 0.01 s", "2", "8, 8")
    (verdict,) = report.verdicts
    assert verdict.met
    assert verdict.measured == "0 of 10 not solved"
    assert "| cube-stack num_cubes=2, 0.01 s | 2 | 8, 8 |" in (tmp_path / "scenes.md").read_text()


def test_missing_data_is_said(tmp_path, folder, monkeypatch):
    absent = tmp_path / "absent"
    result = run("profiles", "--output", tmp_path, "--data", absent, "--no-peers")
    assert result.exit_code == 2
    assert str(absent) in result.stderr.replace("\n", "")
    monkeypatch.setenv("SIGNORINI_DATA", str(absent))
    with pytest.raises(DataMissingError, match="SIGNORINI_DATA"):
        data_directory()
    monkeypatch.setenv("SIGNORINI_DATA", str(folder))
    assert data_directory() == folder
    with pytest.raises(DataMissingError, match="rovers"):
        problem_files(folder, ["rovers"])


def test_bad_names_are_said(folder, tmp_path):
    result = run("robustness", "--output", tmp_path, "--data", folder, "--stress", "gravity")
    assert result.exit_code == 2
    assert "gravity" in result.stderr
    result = run("robustness", "--output", tmp_path, "--data", folder, "--solver", "magic")
    assert result.exit_code == 2
    assert "magic" in result.stderr


def test_every(folder):
    assert [len(paths) for paths in problem_files(folder, ["chain", "capsules"], 2, ("capsules",)).values()] == [2, 3]


def test_run_log_starts_anew_with_another_setting(tmp_path):
    path = tmp_path / "runs.jsonl"
    log = RunLog(path, {"build": "a"})
    log.add("x", {"value": np.float64(np.nan), "count": np.int64(3)})
    assert RunLog(path, {"build": "a"}).items == {"x": {"key": "x", "value": None, "count": 3}}
    assert "x" in RunLog(path, {"build": "a"})
    assert "x" not in RunLog(path, {"build": "b"})


def test_summary_and_verdict(tmp_path):
    numbers = summary([1.0, 2.0, 3.0, float("nan"), float("inf")])
    assert numbers["count"] == 3
    assert numbers["mean"] == numbers["median"] == 2.0
    assert summary([]) == {"count": 0}
    assert str(Verdict("all solved", "3 of 4", "4 of 4", False)) == "[NOT MET] all solved: 3 of 4 (against 4 of 4)"
    report = Report("some", {"value": float("inf")}, [])
    assert load(report.write(Options(tmp_path), {}))["value"] is None
