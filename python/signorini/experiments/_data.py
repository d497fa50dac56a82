"""Where the problem files are, and which of them an experiment takes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

_DEFAULT = Path("..") / "shared" / "data" / "contact_problems"


class DataMissingError(FileNotFoundError):
    """The folder of problem files, or a family of it, is not there; the message says where it was looked for."""


def data_directory(given: Path | None = None) -> Path:
    """The folder that holds one folder of FCLIB files a family.

    It is the one given, else what the environment variable SIGNORINI_DATA names, else ../shared/data/contact_problems
    beside the working directory or the repository. Raises DataMissingError.
    """
    if given is not None:
        candidates = [given]
    elif os.environ.get("SIGNORINI_DATA"):
        candidates = [Path(os.environ["SIGNORINI_DATA"])]
    else:
        candidates = [base / _DEFAULT for base in (Path.cwd(), Path(__file__).resolve().parents[3])]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    tried = " or ".join(str(candidate) for candidate in candidates)
    raise DataMissingError(
        f"no folder of contact problems at {tried}: name one with --data or SIGNORINI_DATA; it holds a folder of FCLIB "
        "files a family (boxes_stack, capsules, chain, ...)"
    )


def problem_files(
    data: Path, families: Iterable[str], every: int = 1, small: Sequence[str] = ()
) -> dict[str, list[Path]]:
    """The *.hdf5 files of each family in order of name, every `every`-th of them; all of those families named in small.

    Raises DataMissingError naming a family that is absent or empty.
    """
    out: dict[str, list[Path]] = {}
    for family in families:
        found = sorted((data / family).glob("*.hdf5"))
        if not found:
            raise DataMissingError(f"{data / family}: no *.hdf5 files there")
        out[family] = found if family in small else found[::every]
    return out


def all_families(data: Path) -> list[str]:
    """Every folder of data that has problem files. Raises DataMissingError when there is none."""
    names = sorted(folder.name for folder in data.iterdir() if folder.is_dir() and any(folder.glob("*.hdf5")))
    if not names:
        raise DataMissingError(f"{data}: no folders with *.hdf5 files there")
    return names
