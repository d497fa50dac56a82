"""What README.md shows, run as a reader would: its Python blocks, then its commands, in one folder."""

import re
import shlex

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


def test_linked_files_exist():
    targets = re.findall(r"\]\(([^)#:]+)\)", (REPOSITORY / "README.md").read_text())
    assert targets
    missing = [target for target in targets if not (REPOSITORY / target).exists()]
    assert not missing
