"""What README.md shows, run as a reader would: its Python blocks, then its commands, in one folder. And that what the
documents and comments point at exists."""

import re
import shlex

import pytest
from conftest import REPOSITORY
from typer.testing import CliRunner

from signorini.cli.main import app

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language):
    return [text for kind, text in BLOCK.findall((REPOSITORY / "README.md").read_text()) if kind == language]


def test_python_blocks_then_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    python = blocks("python")
    assert len(python) >= 2
    names = {}
    for number, block in enumerate(python):
        exec(compile(block, f"README.md, Python block {number + 1}", "exec"), names)
    assert names["solution"].solved

    commands = re.findall(r"^\$ signorini (.*)$", "\n".join(blocks("console")), re.MULTILINE)
    assert commands
    for command in commands:
        result = CliRunner().invoke(app, shlex.split(command))
        assert result.exit_code == 0, f"{command}: {result.output}"


def test_cpp_block_is_the_example():
    # Built and run by `make test` as a program; here, only that the two do not drift apart.
    example = (REPOSITORY / "examples" / "cpp" / "sliding_block.cpp").read_text()
    lines = [line.strip() for block in blocks("cpp") for line in block.splitlines() if line.strip()]
    assert lines
    missing = [line for line in lines if line not in example]
    assert not missing


@pytest.mark.parametrize(
    "page", [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))], ids=lambda page: page.name
)
def test_linked_files_exist(page):
    targets = re.findall(r"\]\(([^)#:]+)\)", page.read_text())
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing


def test_cited_equations_exist():
    # In docs/theory.md an equation's number ends its line; elsewhere it is cited as T12 or (T12).
    number = re.compile(r"\bT(\d+)\b")
    theory = (REPOSITORY / "docs" / "theory.md").read_text()
    defined = [int(n) for n in re.findall(r"\(T(\d+)\)$", theory, re.MULTILINE)]
    assert defined == list(range(1, len(defined) + 1))
    files = [p for folder in ("include", "src", "docs") for p in (REPOSITORY / folder).rglob("*.*")]
    cited = {(int(n), path.name) for path in files if path.suffix != ".png" for n in number.findall(path.read_text())}
    assert len(cited) > 30
    assert not sorted(c for c in cited if c[0] not in defined)
