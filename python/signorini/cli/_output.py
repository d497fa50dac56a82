"""What the commands share: errors in red, JSON to a file or to standard output, and files that may be written."""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from signorini import InvalidInputError, _files


def printer(*, stderr: bool = False, width: int | None = None) -> Console:
    """What prints all text as it is: file names may look like markup, or like emoji by name."""
    return Console(stderr=stderr, width=width, markup=False, emoji=False, highlight=False)


def report(errors: Console, error: Any) -> None:
    if isinstance(error, OSError) and error.strerror:
        error = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    errors.print(f"error: {error}", style="red", soft_wrap=True)


def refuse_idle(context: typer.Context, why: str, *options: str) -> None:
    """Raises InvalidInputError for an option that was given though nothing reads it; why: "without --view"."""
    for option in options:
        source = context.get_parameter_source(option[2:].replace("-", "_"))
        if source is not None and source.name == "COMMANDLINE":
            raise InvalidInputError(f"{option}: has no effect {why}")


def finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None  # JSON knows neither NaN nor infinity


def write_json(target: str, content: dict[str, Any], errors: Console) -> bool:
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    try:
        if target == "-":
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            _files.write(target, text.encode())
    except OSError as error:
        report(errors, error)
        return False
    return True


def check_outputs(outputs: Mapping[str, str | Path | None], inputs: Iterable[Path] = ()) -> None:
    """Before any work: whether each file, by its option, can be written, and is neither read, nor written by another
    option, nor HDF5 that something else would take the place of. Raises InvalidInputError."""
    inputs, written = list(inputs), dict[str, Path]()
    for option, name in outputs.items():
        if name is None or (option, name) == ("--json", "-"):
            continue
        file = Path(name)
        try:
            if any(_same(file, read) for read in inputs):
                raise InvalidInputError(f"{option}: {file}: is read, must be another file")
            for other, taken in written.items():
                if _same(file, taken):
                    raise InvalidInputError(f"{option}: {file}: is written by {other} too, must be another file")
            _check_output(option, file)
        except OSError as error:
            raise InvalidInputError(f"{option}: {file}: cannot be written ({error.strerror})") from None
        written[option] = file


def check_folder(option: str, folder: Path) -> None:
    """Makes the folder and tries whether files can be made in it. Raises InvalidInputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InvalidInputError(f"{option}: {folder}: cannot be written ({error.strerror})") from None


def _same(a: Path, b: Path) -> bool:
    return os.path.realpath(a) == os.path.realpath(b) or (a.exists() and b.exists() and a.samefile(b))


def _check_output(option: str, file: Path) -> None:
    if file.is_dir():
        raise InvalidInputError(f"{option}: {file}: is a folder, must be a file")
    if not file.parent.is_dir():
        raise InvalidInputError(f"{option}: {file.parent}: there is no such folder for {file.name}")
    if file.is_file():
        with file.open("r+b") as there:
            start = there.read(8)
        if start == b"\x89HDF\r\n\x1a\n":
            from signorini import recording

            if option != "--record" or not recording.is_recording(file):
                raise InvalidInputError(f"{option}: {file}: is an HDF5 file, must be another or none yet")
    elif not file.exists():
        target = Path(os.path.realpath(file))  # of a link to nothing, what it names
        target.touch()
        target.unlink()
