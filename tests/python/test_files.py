"""Files that users name, written whole or not at all."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from signorini import ContactProblem, _files, fclib

AS_NOBODY = """
import os, sys
from signorini import _files
os.setgroups([]), os.setgid(65534), os.setuid(65534)
_files.write(sys.argv[1], b"new")
"""
only_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user")


def as_nobody(path):
    return subprocess.run([sys.executable, "-c", AS_NOBODY, path], capture_output=True, text=True)


@pytest.fixture
def folder():
    """That other users can enter."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


def test_links_and_modes(tmp_path):
    path, hard, soft = (tmp_path / name for name in ("file", "hard", "soft"))
    path.write_bytes(b"old")
    path.chmod(0o640)
    os.link(path, hard)
    soft.symlink_to("file")
    _files.write(soft, b"new")
    assert (path.read_bytes(), hard.read_bytes(), soft.is_symlink()) == (b"new", b"old", True)
    assert path.stat().st_mode & 0o777 == 0o640
    assert {p.name for p in tmp_path.iterdir()} == {"file", "hard", "soft"}


def test_what_only_its_owner_may_replace_is_written_to(tmp_path, monkeypatch):
    def refuse(self, target):
        raise PermissionError(1, "Operation not permitted", str(self), None, str(target))

    monkeypatch.setattr(Path, "replace", refuse)
    path = tmp_path / "theirs"
    path.write_bytes(b"longer than what comes")
    _files.write(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


@only_root
def test_a_file_of_another_user_in_a_sticky_folder(folder):
    path = folder / "theirs"
    path.write_bytes(b"longer than what comes")
    path.chmod(0o666)
    folder.chmod(0o1777)
    result = as_nobody(path)
    assert result.returncode == 0, result.stderr
    assert path.read_bytes() == b"new"
    assert (path.stat().st_uid, list(folder.iterdir())) == (0, [path])


@only_root
def test_a_folder_that_takes_no_files_is_said_by_the_name_that_was_given(folder):
    result = as_nobody(folder / "mine")
    assert result.stderr.strip().endswith(f"PermissionError: [Errno 13] Permission denied: '{folder / 'mine'}'")
    assert not list(folder.iterdir())


def test_errors_have_the_name_that_was_given(tmp_path, monkeypatch):
    def refuse(self, target):
        raise OSError(5, "Input/output error", str(self), None, str(target))

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OSError, match=f"error: '{tmp_path / 'mine'}'$"):
        _files.write(tmp_path / "mine", b"new")
    with pytest.raises(OSError, match=f"error: '{tmp_path / 'mine'}'$"):
        fclib.write(tmp_path / "mine", ContactProblem(np.zeros((0, 0)), [], []))
    with pytest.raises(OSError, match=f"device: '{tmp_path / 'mine'}'$"), _files.replacing(tmp_path / "mine"):
        raise OSError(28, "No space left on device")  # what write() says
    with pytest.raises(OSError, match="^of its own$"), _files.replacing(tmp_path / "mine"):
        raise OSError("of its own")
    with pytest.raises(OSError, match="'/another'"), _files.replacing(tmp_path / "mine"):
        Path("/another").read_bytes()
    assert not list(tmp_path.iterdir())
