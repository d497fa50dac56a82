import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from reference import planted_problem
from typer.testing import CliRunner

import signorini
from signorini import ContactProblem, fclib
from signorini.cli import check as check_command
from signorini.cli import solve as solve_command
from signorini.cli.main import app, main


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def folder(tmp_path):
    for seed in (0, 1):
        mass, j, g, mu, _ = planted_problem(seed)
        fclib.write(tmp_path / f"planted-{seed}.hdf5", ContactProblem.from_mass(mass, j, g, mu))
    return tmp_path


def no_constants(name):
    raise AssertionError(f"{name} is not JSON")


def load(text):
    return json.loads(text, parse_constant=no_constants)


def test_version():
    result = run("--version")
    assert result.exit_code == 0
    assert result.output.strip() == f"signorini {signorini.__version__}"


def test_as_a_program(folder):
    command = [sys.executable, "-m", "signorini", "solve", str(folder), "--json", "-"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert len(load(result.stdout)["results"]) == 2  # nothing but JSON on standard output


def test_table(folder):
    result = run("solve", folder / "planted-0.hdf5", folder / "planted-1.hdf5")
    assert result.exit_code == 0
    for word in ("planted-0", "planted-1", "solved", "relative", "2 of 2 solved"):
        assert word in result.stdout


@pytest.mark.parametrize("solver", ["auto", "admm", "pgs", "interior-point"])
def test_json_holds_the_certificate(folder, solver):
    result = run("solve", folder, "--solver", solver, "--tolerance", "1e-7", "--json", "-")
    assert result.exit_code == 0, result.output
    content = load(result.stdout)
    assert set(content) == {"version", "results"}
    assert content["version"] == signorini.__version__
    assert [r["name"] for r in content["results"]] == ["planted-0", "planted-1"]
    for r in content["results"]:
        fields = "name num_contacts solver status iterations factorizations seconds residual model_residual asymmetry"
        assert set(r) == set(fields.split())
        names = {"primal", "dual", "complementarity", "relative", "against_free_velocity"}
        assert set(r["residual"]) == names
        assert r["status"] == "solved"
        assert r["num_contacts"] == 5
        problem = fclib.read(folder / f"{r['name']}.hdf5")
        same = signorini.solve(problem, solver, tolerance=1e-7)
        assert r["residual"]["relative"] == same.residual.relative <= 1e-7
        assert r["iterations"] == same.iterations


def test_json_file_comes_with_the_table(folder, tmp_path):
    target = tmp_path / "out" / "results.json"
    target.parent.mkdir()
    result = run("solve", folder, "--json", target)
    assert result.exit_code == 0
    assert "2 of 2 solved" in result.stdout
    assert len(load(target.read_text())["results"]) == 2


def test_options_reach_the_solver(folder):
    file = folder / "planted-0.hdf5"

    def relative(*options):
        return load(run("solve", file, "--json", "-", *options).stdout)["results"][0]

    assert relative("--max-iterations", 2, "--solver", "pgs")["iterations"] == 2
    assert relative("--operator", "mass")["status"] == "solved"
    problem = fclib.read(file)
    ccp = signorini.solve(problem, "interior-point", "ccp")
    assert relative("--law", "ccp", "--solver", "interior-point")["residual"]["relative"] == ccp.residual.relative
    linear = signorini.solve(problem, "admm", penalty_rule="linear")
    assert relative("--solver", "admm", "--penalty-rule", "linear")["iterations"] == linear.iterations


def test_unsolved_is_exit_status_1(folder):
    result = run("solve", folder, "--solver", "pgs", "--max-iterations", 1, "--tolerance", "1e-12")
    assert result.exit_code == 1
    assert "max iterations" in result.stdout
    assert "0 of 2 solved" in result.stdout


def test_what_has_no_solution_is_said(tmp_path):
    # No impulse moves the second contact, which closes.
    problem = ContactProblem(np.diag([1.0, 1, 1, 0, 0, 0]), [0.0, 0, -1, 0, 0, -1], [0.5, 0.5])
    fclib.write(tmp_path / "closing.hdf5", problem)
    result = run("solve", tmp_path, "--solver", "admm", "--tolerance", "0.01", "--json", tmp_path / "out.json")
    assert result.exit_code == 1
    assert "0 of 1 solved" in result.stdout
    residual = load((tmp_path / "out.json").read_text())["results"][0]["residual"]
    assert residual["against_free_velocity"] > 0.1  # Residual.solves
    assert ("without solution" in result.stdout) == (residual["relative"] <= 0.01)


def test_bad_file_is_exit_status_2_and_the_others_are_solved(folder):
    (folder / "bad.hdf5").write_text("version https://git-lfs.github.com/spec/v1\n")
    result = run("solve", folder, "--json", "-")
    assert result.exit_code == 2
    assert "bad.hdf5" in result.stderr
    assert "git-lfs" in result.stderr
    assert [r["status"] for r in load(result.stdout)["results"]] == ["solved", "solved"]


@pytest.mark.parametrize(
    "options",
    [
        ["--tolerance", "3"],
        ["--tolerance", "nan"],
        ["--tolerance", "small"],
        ["--max-iterations", "0"],
        ["--solver", "lemke"],
        ["--law", "lcp"],
        ["--penalty-rule", "magic"],
        ["--operator", "sparse"],
        ["--unknown"],
    ],
)
def test_bad_option_is_exit_status_2(folder, options):
    result = run("solve", folder, *options)
    assert result.exit_code == 2
    assert options[0].strip("-").replace("-", "_") in result.stderr.replace("-", "_")
    assert result.stdout == ""


def test_missing_file_empty_folder_and_no_argument(tmp_path):
    assert run("solve", tmp_path / "none.hdf5").exit_code == 2
    assert run("solve", tmp_path).exit_code == 2
    assert run("solve").exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["solve", ""], "FILES"),
        (["solve", "a.hdf5", "", "b.hdf5"], "FILES"),
        (["solve", "a.hdf5", "--json", ""], "--json"),
        (["run", ""], "SCENE|FILE"),
        (["run", "cube-stack", "--hardest="], "--hardest"),
        (["check", "robot.urdf", "--package-dir", "", "--package-dir", "a"], "--package-dir"),
        (["replay", ""], "RECORDING"),
        (["view", "a.h5", "--html", ""], "--html"),
        (["video", "a.h5", ""], "FILE.mp4"),
        (["experiment", "scenes", "--output", ""], "--output"),
        (["experiment", "profiles", "--data", ""], "--data"),
        (["experiment", "all", "--skip", ""], "--skip"),
    ],
)
def test_an_empty_argument_is_not_the_working_directory(folder, monkeypatch, arguments, named):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    result = run(*arguments)
    assert result.exit_code == 2
    assert f"'{named}'" in result.stderr
    assert "empty" in result.stderr
    assert sorted(folder.iterdir()) == before


def test_json_target_that_cannot_be_written(folder):
    result = run("solve", folder, "--json", folder / "no" / "such" / "folder.json")
    assert result.exit_code == 2
    assert "folder.json" in result.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
@pytest.mark.parametrize("options", [["--json", "-"], []])
def test_output_on_a_full_disk(folder, options):
    command = [sys.executable, "-c", "from signorini.cli.main import main; main()", "solve", str(folder), *options]
    with open("/dev/full", "w") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert result.returncode == 2
    assert "No space left" in result.stderr
    assert "Traceback" not in result.stderr


def test_numbers_that_are_not_finite_become_null(folder, monkeypatch):
    from dataclasses import replace

    real = signorini.solve

    def not_finite(*arguments, **options):
        s = real(*arguments, **options)
        nothing = replace(s.residual, primal=np.nan, dual=np.inf, complementarity=-np.inf, relative=np.nan)
        return replace(s, status="invalid", residual=nothing)

    monkeypatch.setattr(signorini, "solve", not_finite)
    result = run("solve", folder, "--json", "-")
    assert result.exit_code == 1
    assert load(result.stdout)["results"][0]["residual"]["relative"] is None
    table = run("solve", folder)
    assert table.exit_code == 1
    assert "nan" in table.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cube-stack", "--ground"], "--ground: is for files"),
        (["cube-stack", "--floating"], "is for files"),
        (["cube-stack", "--contacts-every", "5"], "--contacts-every: has no effect without --record"),
        (["cube-stack", "--port", "8080"], "--port: has no effect without --view"),
        (["cube-stack", "--no-open"], "--no-open: has no effect without --view"),
        (["cube-stack", "--no-shadows", "--picture", "a.png"], "--no-shadows: has no effect without --view"),
        (["cube-stack", "--size", "64x64"], "--size: has no effect without --picture or --video"),
        (["cube-stack", "--picture-time", "0", "--video", "a.mp4"], "--picture-time: has no effect without --picture"),
        (["cube-stack", "--record", "a.h5", "--contacts-every", "0"], "contacts_every: is 0, must be in [1, 2^31)"),
        (["cube-stack", "--record", "a.h5", "--contacts-every", "2147483648"], "contacts_every: is 2147483648"),
        (["cube-stack", "--json", "nowhere/a.json"], "--json: nowhere: there is no such folder"),
        (["cube-stack", "--record", "nowhere/a.h5"], "--record: nowhere: there is no such folder"),
        (["."], "is no file"),
    ],
)
def test_a_run_refuses_what_would_have_no_effect(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("run", *arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


PROGRAM = [sys.executable, "-c", "from signorini.cli.main import main; main()"]


def status_when_nobody_reads(command, also_errors):
    """Exit status and what is said where the reader has gone before anything is written."""
    read, write = os.pipe()
    os.close(read)
    try:
        result = subprocess.run(command, stdout=write, stderr=write if also_errors else subprocess.PIPE)
    finally:
        os.close(write)
    return result.returncode, result.stderr or b""


@pytest.mark.parametrize(
    ("options", "status", "also_errors"),
    [
        (["--json", "-"], 0, False),
        ([], 0, False),
        ([], 0, True),
        (["--solver", "pgs", "--max-iterations", "1"], 1, False),
        (["missing.hdf5"], 2, True),
        (["--unknown"], 2, True),
    ],
)
def test_the_status_is_that_of_the_work_though_nobody_reads(folder, options, status, also_errors):
    found, said = status_when_nobody_reads([*PROGRAM, "solve", folder, *options], also_errors)
    assert found == status
    assert b"Exception" not in said
    assert b"Traceback" not in said


@pytest.mark.parametrize("output", [">&-", "1</dev/null", ">&- 2>&-", "1</dev/null 2</dev/null"])
@pytest.mark.parametrize("options", [[], ["--json", "-"]])
def test_a_closed_output_is_one_that_nobody_reads(folder, options, output):
    command = shlex.join([*PROGRAM, "solve", str(folder), *options])
    result = subprocess.run(["bash", "-c", f"{command} {output}"], capture_output=True)
    assert (result.returncode, result.stderr.strip()) == (0, b"")
    result = subprocess.run(["bash", "-c", f"{command} missing.hdf5 {output}"], capture_output=True)
    assert result.returncode == 2


def test_outputs_that_are_no_files_of_the_system(capsys, monkeypatch):
    """As in notebooks."""
    monkeypatch.setattr(sys, "argv", ["signorini", "--version"])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code
    assert capsys.readouterr().out.strip() == f"signorini {signorini.__version__}"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
def test_a_full_disk_hides_no_other_error():
    work = "def app(): print('x' * 10); raise RuntimeError('the first')"
    code = f"from signorini.cli import main as m\n{work}\nm.app = app\nm.main()"
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            [sys.executable, "-c", code], stdout=full, stderr=subprocess.PIPE, text=True, env=buffered
        )
    assert "RuntimeError: the first" in result.stderr
    assert result.returncode != 0


@pytest.mark.parametrize(("stem", "encoding"), [("kub-ü", "ascii"), ("raw-\udcff", "utf-8")])
def test_names_that_the_output_cannot_say(folder, stem, encoding):
    file = (folder / "planted-0.hdf5").rename(folder / f"{stem}.hdf5")
    options = [], ["--json", "-"], ["--solver", "pgs", "--max-iterations", "1"], [folder / f"{stem}-none.hdf5"]
    for more, status in zip(options, (0, 0, 1, 2), strict=True):
        command = [*PROGRAM, "solve", file, *more]
        result = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONIOENCODING": encoding})
        assert result.returncode == status, result.stderr
        assert b"Traceback" not in result.stderr
        assert stem[:4].encode() in result.stdout


@pytest.mark.parametrize(
    ("option", "said", "inside", "outside"),
    [
        ("--tolerance", "in (0, 1)", ["1e-300", "0.999999"], ["0", "1"]),
        ("--max-iterations", "At least 1;", ["1", "2147483647"], ["0", "2147483648"]),
        ("--facets", "even, 4 to 64", ["4", "64"], ["2", "5", "66"]),
        ("--impedance", "in [0.001, 1 - 1e-6]", ["0.001", "0.999999"], ["0.0009", "0.9999999"]),
    ],
)
def test_the_range_that_help_says_is_the_one_that_holds(tmp_path, monkeypatch, option, said, inside, outside):
    monkeypatch.setenv("COLUMNS", "200")
    empty = ContactProblem(np.zeros((0, 0)), [], [])
    fclib.write(tmp_path / "empty.hdf5", empty)
    assert said in run("solve", "--help").stdout
    for value, status in [*((value, 0) for value in inside), *((value, 2) for value in outside)]:
        assert run("solve", tmp_path, option, value).exit_code == status, value


@pytest.fixture(scope="module")
def recording_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "r.h5"
    assert run("run", "cube-stack", "--duration", "0.01", "--record", path).exit_code == 0
    return path


@pytest.fixture
def outputs(folder, recording_file, monkeypatch):
    """A folder with an input for every command, and files that are not inputs."""
    monkeypatch.chdir(folder)
    shutil.copy(recording_file, "r.h5")
    shutil.copy(recording_file, "r.png")
    shutil.copy(recording_file, "other.h5")
    Path("robot.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    Path("link.json").symlink_to("planted-1.hdf5")
    os.link("planted-1.hdf5", "hard.json")
    Path("file").write_text("a file")
    Path("fcl").mkdir()
    shutil.copy("planted-0.hdf5", "fcl/a.hdf5")
    return folder


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("solve --json planted-0.hdf5 planted-1.hdf5 planted-0.hdf5", "--json: planted-0.hdf5: is read, must be"),
        ("solve --json planted-0.hdf5 planted-1.hdf5", "--json: planted-0.hdf5: is an HDF5 file, must be another"),
        ("solve --json link.json planted-1.hdf5", "--json: link.json: is read"),
        ("solve --json hard.json planted-1.hdf5", "--json: hard.json: is read"),
        ("solve --json fcl/../fcl/a.hdf5 fcl", "--json: fcl/../fcl/a.hdf5: is read"),
        ("solve --json missing.hdf5 missing.hdf5", "--json: missing.hdf5: is read"),
        ("solve --json fcl planted-1.hdf5", "--json: fcl: is a folder, must be a file"),
        ("solve --json file/a planted-1.hdf5", "--json: file: there is no such folder for a"),
        ("solve --json /proc/x planted-1.hdf5", "--json: /proc/x: cannot be written"),
        ("check robot.urdf --json robot.urdf", "--json: robot.urdf: is read"),
        ("check robot.urdf --json nowhere/a.json", "--json: nowhere: there is no such folder for a.json"),
        ("run robot.urdf --json robot.urdf", "--json: robot.urdf: is read"),
        ("run robot.urdf --record robot.urdf", "--record: robot.urdf: is read"),
        ("run cube-stack --record .", "--record: .: is a folder, must be a file"),
        ("run cube-stack --record /proc/x", "--record: /proc/x: cannot be written"),
        ("run cube-stack --record a --json a", "--json: a: is written by --record too, must be another"),
        ("run cube-stack --json other.h5", "--json: other.h5: is an HDF5 file"),
        ("run cube-stack --record planted-0.hdf5", "--record: planted-0.hdf5: is an HDF5 file, must be another"),
        ("run cube-stack --picture r.png", "--picture: r.png: is an HDF5 file"),
        ("run cube-stack --video nowhere/a.mp4", "--video: nowhere: there is no such folder for a.mp4"),
        ("run cube-stack --hardest /proc/x", "--hardest: /proc/x: cannot be written"),
        ("run cube-stack --hardest file", "--hardest"),
        ("view r.h5 --html r.h5", "--html: r.h5: is read"),
        ("view r.h5 --html other.h5", "--html: other.h5: is an HDF5 file"),
        ("view r.h5 --html /nodir/a.html", "--html: /nodir: there is no such folder for a.html"),
        ("view r.h5 --fps 10", "--fps: has no effect without --html"),
        ("view r.h5 --html a.html --port 8080", "--port: has no effect with --html"),
        ("view r.h5 --html a.html --no-open", "--no-open: has no effect with --html"),
        ("picture r.png r.png", "FILE.png: r.png: is read"),
        ("video r.h5 fcl.mp4/a.mp4", "there is no such folder"),
        ("experiment scenes --quick --output /proc/x", "--output: /proc/x: cannot be written"),
        ("experiment all --output /proc/x", "--output: /proc/x: cannot be written"),
        ("experiment timings --output fcl --write-problems /proc/x", "--write-problems: /proc/x: cannot be written"),
    ],
)  # fmt: skip
def test_outputs_are_looked_at_before_any_work(outputs, monkeypatch, arguments, message):
    def work(*_, **__):
        raise AssertionError("work began")

    for name in ("Simulator", "load"):
        monkeypatch.setattr(signorini, name, work)
    monkeypatch.setattr(solve_command, "_result", work)
    monkeypatch.setattr(check_command, "assemble", work)
    monkeypatch.setenv("SIGNORINI_DATA", "nowhere")  # the same error where the problem files are and where not
    before = contents(outputs)
    result = run(*arguments.split())
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert contents(outputs) == before


def test_other_files_are_overwritten(outputs):
    Path("old.json").write_text("old")
    assert run("solve", "planted-0.hdf5", "--json", "old.json").exit_code == 0
    assert len(load(Path("old.json").read_text())["results"]) == 1
    assert run("run", "cube-stack", "--duration", "0.01", "--record", "other.h5").exit_code == 0
    assert run("solve", "planted-0.hdf5", "--json", "/dev/null").exit_code == 0
    command = shlex.join([*PROGRAM, "solve", "planted-0.hdf5"])
    result = subprocess.run(["bash", "-c", f"{command} --json >(cat >&2)"], capture_output=True, text=True, check=True)
    assert '"status": "solved"' in result.stderr


def test_names_are_shown_as_they_are(folder, monkeypatch):
    """Neither as emoji nor as markup, in tables, titles and errors of every command."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "200")
    name = "a:smile:b[bold]c"
    shutil.copy("planted-0.hdf5", f"{name}.hdf5")
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    Path(f"{name}.urdf").write_text(f'<robot name="r"><link name="{name}">{inertial}</link></robot>')
    for command, status in (
        (["solve", f"{name}.hdf5"], 0),
        (["solve", f"{name}.hdf5", "--solver", "pgs", "--max-iterations", "1"], 1),
        (["solve", f"{name}-none.hdf5"], 2),
        (["check", f"{name}.urdf"], 0),
        (["check", f"{name}-none.urdf"], 2),
        (["run", f"{name}.urdf", "--duration", "0.01", "--floating"], 0),
        (["run", f"{name}-none"], 2),
        (["run", f"{name}.urdf", "--record", f"{name}/a"], 2),
        (["replay", f"{name}.h5"], 2),
        (["experiment", "profiles", "--output", ".", "--data", name], 2),
        (["experiment", "all", "--output", ".", "--skip", name], 2),
        (["solve", "--law", name, "a"], 2),
        ([name], 2),
    ):
        result = run(*command)
        assert result.exit_code == status, result.output
        assert name in result.output.replace("\n", ""), command
