"""Files that users name: their names are checked, and what is written takes its place whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from signorini import _arrays
from signorini._core import InvalidInputError


def checked(path: Any) -> Path:
    """The path, or InvalidInputError where no file can have that name."""
    if not isinstance(path, (str, os.PathLike)) or not isinstance(os.fspath(path), str):
        raise InvalidInputError(f"path: is {path!r}, must be a str or an os.PathLike of one")
    if "\0" in os.fspath(path):
        raise InvalidInputError(f"path: is {os.fspath(path)!r}, must be without null characters")
    return Path(path)


def special(path: Path) -> str | None:
    """What path is if neither a file nor a folder: to open that could wait forever. Raises OSError if nothing is."""
    mode = path.stat().st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return None
    return "a pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"


def text(field: str, value: Any) -> bytes:
    """In UTF-8, or InvalidInputError."""
    try:
        return _arrays.text(field, value).encode()
    except UnicodeEncodeError:
        raise InvalidInputError(f"{field}: is {value!r}, must be text that UTF-8 can hold") from None


def write(path: str | os.PathLike[str], content: bytes) -> None:
    """Of a file, all of it. Raises OSError."""
    with replacing(path) as target:
        target.write_bytes(content)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a file to write, beside path, whose place it takes at the end; after an error, what was there stays.

    The new file belongs to who writes it, and other hard links keep the old one. Devices, pipes and what lies in a
    folder that takes no new files are written to as they are; into what only its owner may replace (as in /tmp), the
    new content is copied at the end. Raises OSError.
    """
    given = checked(path)
    if given.exists() and not (given.is_file() or given.is_dir()):
        yield given
        return
    target = Path(os.path.realpath(given))  # a link stays one
    if target.is_dir() or not target.parent.is_dir():
        code = errno.EISDIR if target.is_dir() else errno.ENOENT
        raise OSError(code, os.strerror(code), str(path))
    there = target.exists()
    if there and not (os.access(target.parent, os.W_OK) and os.access(target, os.W_OK)):
        yield target
        return
    beside = target.with_name(f".signorini-{secrets.token_hex(8)}{target.suffix[:16]}")
    try:
        beside.touch(exist_ok=False)
        yield beside
        if there:
            shutil.copymode(target, beside)
        _take_place(beside, target)
    except BaseException as error:
        beside.unlink(missing_ok=True)
        # The name beside path is one that nobody knows; where a disk is full, the system says none.
        if isinstance(error, OSError) and error.errno and error.filename in (None, str(beside)):
            error.filename = str(path)
            del error.filename2
        raise


def _take_place(beside: Path, target: Path) -> None:
    try:
        beside.replace(target)
    except PermissionError:
        with beside.open("rb") as content, target.open("r+b") as there:  # Linux refuses "wb" in such folders
            shutil.copyfileobj(content, there)
            there.truncate()
        beside.unlink()
