import base64
import json
import re
import sys

import pytest
from typer.testing import CliRunner

import signorini
from signorini.cli import experiment
from signorini.cli.main import app
from signorini.experiments._all import Outcome, Runs
from signorini.experiments._page import Page
from signorini.experiments._report import Verdict

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
FAKE = """
import json, pathlib, sys
folder, name, met, fail = pathlib.Path(sys.argv[1]), *sys.argv[2:]
with open(folder / "calls", "a") as calls:
    calls.write(name + "\\n")
print("line before the end")
if fail == "crash":
    raise RuntimeError("no such luck")
if fail == "silent":
    sys.exit(0)
met = {"yes": True, "no": False, "none": None}[met]
verdicts = [{"claim": f"{name} <holds> | *so*", "measured": "1 < 2", "reference": "[x]", "met": met}]
content = {"experiment": name, "verdicts": verdicts, "notes": [f"note of {name}"],
           "tables": {f"table of {name}": [["a|b", "c"], [["1", f"cell of {name}"]]]},
           "environment": {"peers": {"engine": "4.2"}}}
(folder / f"{name}.json").write_text(json.dumps(content))
sys.exit(3 if fail == "late" else 0)
"""


def command(folder, name, met="yes", fail=""):
    return [sys.executable, "-c", FAKE, str(folder), name, met, fail]


def calls(folder):
    path = folder / "calls"
    said = path.read_text().split() if path.exists() else []
    path.unlink(missing_ok=True)
    return said


def test_what_has_a_result_is_not_run_again(tmp_path):
    commands = {name: command(tmp_path, name) for name in ("one", "two", "three")}
    setting = {"build": "a", "quick": True}
    first = Runs(dict(list(commands.items())[:2]), tmp_path, setting).run()  # as if interrupted after two
    assert calls(tmp_path) == ["one", "two"]
    seen = []
    again = Runs(commands, tmp_path, setting, progress=lambda done, total, what: seen.append((done, total, what))).run()
    assert calls(tmp_path) == ["three"]
    assert [outcome.earlier for outcome in again] == [True, True, False]
    assert again[0].content == first[0].content
    assert seen == [(0, 3, "one"), (1, 3, "two"), (2, 3, "three"), (3, 3, "")]

    (tmp_path / "two.json").unlink()
    (tmp_path / "three.json").write_text('{"verdicts": []}')  # another run wrote over it
    Runs(commands, tmp_path, setting).run()
    assert calls(tmp_path) == ["two", "three"]

    Runs(commands, tmp_path, {**setting, "quick": False}).run()
    assert calls(tmp_path) == ["one", "two", "three"]
    Runs(commands, tmp_path, {**setting, "quick": False}, fresh=True).run()
    assert calls(tmp_path) == ["one", "two", "three"]


def test_one_that_fails_does_not_stop_the_others(tmp_path):
    commands = {
        "good": command(tmp_path, "good"),
        "crash": command(tmp_path, "crash", fail="crash"),
        "silent": command(tmp_path, "silent", fail="silent"),
        "late": command(tmp_path, "late", fail="late"),
        "bad": command(tmp_path, "bad", "no"),
        "open": command(tmp_path, "open", "none"),
    }
    outcomes = {outcome.name: outcome for outcome in Runs(commands, tmp_path, {}).run()}
    assert calls(tmp_path) == list(commands)
    assert {name: outcome.met for name, outcome in outcomes.items()} == {
        "good": True, "crash": False, "silent": False, "late": False, "bad": False, "open": True,
    }  # fmt: skip
    assert outcomes["crash"].error.startswith("exit status 1")
    assert outcomes["crash"].error.endswith("RuntimeError: no such luck")
    assert outcomes["late"].error.startswith("exit status 3")
    assert "silent.json" in outcomes["silent"].error
    Runs(commands, tmp_path, {}).run()
    assert calls(tmp_path) == [
        "crash",
        "silent",
        "late",
    ]  # what failed is tried again, a verdict that is not met is a result


def test_a_stale_result_is_not_taken_for_that_of_a_crash(tmp_path):
    Runs({"one": command(tmp_path, "one")}, tmp_path, {"build": "a"}).run()
    (outcome,) = Runs({"one": command(tmp_path, "one", fail="silent")}, tmp_path, {"build": "b"}).run()
    assert outcome.content is None


def test_the_page_has_everything(tmp_path):
    commands = {
        "timings": command(tmp_path, "timings"),
        "second": command(tmp_path, "second", "no"),
        "crash": command(tmp_path, "crash", fail="crash"),
    }
    outcomes = Runs(commands, tmp_path, {}).run()
    (tmp_path / "second.png").write_bytes(PNG)
    (tmp_path / "second-more.png").write_bytes(PNG)
    page = Page(outcomes, {"second": "What it is."}, ["third"], "a sample", {"processor": "fast one"}, tmp_path)
    html_file, markdown_file = page.write()
    text, markdown = html_file.read_text(), markdown_file.read_text()
    for outcome in outcomes:
        for verdict in outcome.verdicts:
            said = str(Verdict(**verdict))
            escaped = said.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
            assert escaped in text
            assert said in re.sub(r"\\(.)", r"\1", markdown)
    for content in (text, markdown):
        for wanted in ("cell of second", "note of timings", "table of second", "What it is.", "third", "fast one"):
            assert wanted in content
        assert "no such luck" in content
        assert "Fig. 5" in content  # the paper's, beside ours
        assert "4.2" in content
    assert text.count("data:image/png;base64,") == 2
    assert "src=" not in text.replace('src="data:', "")  # nothing is fetched
    assert "https:" not in text
    assert "![second](second.png)" in markdown
    rows = [line for line in markdown.splitlines() if line.startswith("| a")]
    assert rows == ["| a\\|b | c |"] * 2
    assert "<holds>" not in text


@pytest.fixture
def fakes(tmp_path, monkeypatch):
    """Three experiments in place of the real ones; returns a dictionary to change what becomes of them."""
    fate = {"first": ("yes", ""), "second": ("none", "")}
    known = experiment._experiments()
    monkeypatch.setattr(experiment, "_experiments", lambda: dict(zip(fate, list(known.values())[2:], strict=False)))
    monkeypatch.setattr(experiment, "_command", lambda name, *rest: command(tmp_path, name, *fate[name]))
    return fate


def run(*arguments):
    return CliRunner().invoke(app, ["experiment", "all", *(str(argument) for argument in arguments)])


def test_the_exit_status(tmp_path, fakes):
    result = run("--output", tmp_path, "--data", tmp_path)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "report.md").exists()
    fakes["second"] = ("no", "")
    result = run("--output", tmp_path, "--data", tmp_path, "--fresh")
    assert result.exit_code == 1
    assert "[NOT MET] second" in result.output
    assert run("--output", tmp_path, "--data", tmp_path, "--fresh", "--skip", "second").exit_code == 0
    fakes["first"] = ("yes", "crash")
    result = run("--output", tmp_path, "--data", tmp_path, "--fresh")
    assert result.exit_code == 1
    assert "no such luck" in result.output
    calls(tmp_path)


def test_bad_input(tmp_path, fakes, monkeypatch):
    result = run("--output", tmp_path, "--skip", "magic")
    assert result.exit_code == 2
    assert "magic" in result.stderr
    assert "first, second" in result.stderr
    (tmp_path / "file").write_text("")
    assert run("--output", tmp_path / "file").exit_code == 2
    monkeypatch.undo()
    absent = tmp_path / "absent"
    result = run("--output", tmp_path, "--data", absent)
    assert result.exit_code == 2
    assert str(absent) in result.stderr.replace("\n", "")
    assert "--skip profiles" in result.stderr
    assert calls(tmp_path) == []


def test_every_command_is_among_them(tmp_path):
    known = experiment._experiments()
    for name in ("profiles", "updates", "convergence", "robustness", "peers", "scaling", "stepping", "inverse"):
        assert name in known
    assert {"walking", "timings"} <= known.keys()
    assert "all" not in known
    line = experiment._command("profiles", known["profiles"], tmp_path, tmp_path, {"--quick": True, "--no-peers": True})
    assert line[-4:] == ["--data", str(tmp_path), "--quick", "--no-peers"]
    line = experiment._command("stepping", known["stepping"], tmp_path, tmp_path, {"--quick": True, "--fresh": True})
    assert line[-3:] == ["--output", str(tmp_path), "--quick"]  # it has no --fresh, no --data
    given = {"--quick": True, "--install": True}
    line = experiment._command("simulators", known["simulators"], tmp_path, tmp_path, given)
    assert line[-4:] == ["--output", str(tmp_path), "--quick", "--install"]
    assert "--install" not in experiment._command("stepping", known["stepping"], tmp_path, tmp_path, given)


def test_a_real_one(tmp_path, monkeypatch):
    known = experiment._experiments()
    monkeypatch.setattr(experiment, "_experiments", lambda: {"convergence": known["convergence"]})
    result = run("--output", tmp_path, "--quick")
    content = json.loads((tmp_path / "convergence.json").read_text())
    assert result.exit_code == int(any(verdict["met"] is False for verdict in content["verdicts"]))
    markdown = re.sub(r"\\(.)", r"\1", (tmp_path / "report.md").read_text())
    for verdict in content["verdicts"]:
        assert str(Verdict(**verdict)) in markdown
    for title in content["tables"]:
        assert title in markdown
    assert signorini.__version__ in markdown
    assert Outcome("convergence", content).count(True) == sum(verdict["met"] is True for verdict in content["verdicts"])
