"""What an experiment hands back: its numbers, verdicts against a figure, and where and with what they were measured."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini import _core, _files
from signorini.experiments._markdown import Markdown


@dataclass
class Options:
    """What the command line gives every experiment.

    output: folder, made when it is missing. data: of the problem files (None: see data_directory). quick: a sample, to
    see that all works. every: take every so many problems of a family (None: all, or what quick takes). with_peers: run
    what is installed of signorini.peers. fresh: measure again what an interrupted run left. workers: processes, for
    runs whose times do not matter. families: only these. progress: called with (done, total, what).
    """

    output: Path
    data: Path | None = None
    quick: bool = False
    every: int | None = None
    with_peers: bool = True
    fresh: bool = False
    workers: int = 1
    families: tuple[str, ...] = ()
    progress: Callable[[int, int, str], None] = lambda done, total, what: None

    def step(self, quick: int) -> int:
        """Every how many problems are taken."""
        return self.every if self.every is not None else quick if self.quick else 1


@dataclass
class Verdict:
    """One claim, what was measured and what it is held against; met is None where nothing is claimed."""

    claim: str
    measured: str
    reference: str = ""
    met: bool | None = None

    def __str__(self) -> str:
        mark = {True: "met", False: "NOT MET", None: "-"}[self.met]
        against = f" (against {self.reference})" if self.reference else ""
        return f"[{mark}] {self.claim}: {self.measured}{against}"


@dataclass
class Report:
    """The whole of an experiment. tables: title -> (columns, rows), for people."""

    name: str
    numbers: dict[str, Any]
    verdicts: list[Verdict]
    tables: dict[str, tuple[list[str], list[list[str]]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

    def write(self, options: Options, versions: dict[str, str]) -> Path:
        """NAME.json in the output folder, and NAME.md: verdicts, tables and notes, to paste."""
        path = options.output / f"{self.name}.json"
        content = {
            "experiment": self.name,
            "quick": options.quick,
            "every": options.every,
            "environment": environment(versions),
            "verdicts": [asdict(verdict) for verdict in self.verdicts],
            "notes": self.notes,
            "tables": self.tables,
            **self.numbers,
        }
        _files.write(path, (json.dumps(_plain(content), indent=1, allow_nan=False) + "\n").encode())
        page = Markdown()
        page.heading(1, self.name + (", a sample" if options.quick else ""))
        page.listing([str(verdict) for verdict in self.verdicts])
        for title, (columns, rows) in self.tables.items():
            page.heading(2, title)
            page.table(columns, rows)
        page.listing(self.notes)
        _files.write(path.with_suffix(".md"), page.text().encode())
        self.files[:0] = [path, path.with_suffix(".md")]
        return path


def _plain(value: Any) -> Any:
    """For JSON: numpy's numbers as Python's, what is not finite as null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def environment(versions: dict[str, str]) -> dict[str, Any]:
    """Versions and the processor: times mean nothing without them."""
    return {
        "signorini": signorini.__version__,
        "build": build_id(),
        "peers": versions,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": platform.system(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
    }


def build_id() -> str:
    """A short hash of the compiled extension: results of another build are not mixed with these."""
    return hashlib.sha256(Path(_core.__file__).read_bytes()).hexdigest()[:12]


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def summary(values: Iterable[float]) -> dict[str, float]:
    """Mean, standard deviation, quartiles, 99th percentile and extremes of the finite values, and their number."""
    v = np.array([value for value in values if value is not None and math.isfinite(value)], dtype=np.float64)
    if v.size == 0:
        return {"count": 0}
    low, middle, high, tail = np.percentile(v, [25, 50, 75, 99])
    return {
        "count": int(v.size),
        "mean": float(v.mean()),
        "std": float(v.std()),
        "min": float(v.min()),
        "q25": float(low),
        "median": float(middle),
        "q75": float(high),
        "p99": float(tail),
        "max": float(v.max()),
    }


class RunLog:
    """What has been measured so far, a line of JSON an item, so that an interrupted run goes on where it was.

    setting: everything that would make a line stale (build, versions, tolerances); with another the file starts anew.
    """

    def __init__(self, path: Path, setting: dict[str, Any], fresh: bool = False) -> None:
        self._path = path
        self.items: dict[str, dict[str, Any]] = {}
        header = json.loads(json.dumps(_plain(setting)))
        lines = path.read_text().splitlines() if path.exists() and not fresh else []
        try:
            same = bool(lines) and json.loads(lines[0]) == header
            if same:
                for line in lines[1:]:
                    item = json.loads(line)
                    self.items[item["key"]] = item
        except (json.JSONDecodeError, KeyError):
            pass  # cut off in the middle of a line: what came before it stands
        # Written anew: without the line that was cut off, if any.
        text = [json.dumps(header)] + [json.dumps(item) for item in self.items.values()]
        _files.write(path, ("\n".join(text) + "\n").encode())

    def __contains__(self, key: str) -> bool:
        return key in self.items

    def add(self, key: str, item: dict[str, Any]) -> None:
        """Keeps an item at once."""
        self.items[key] = json.loads(json.dumps(_plain({"key": key, **item})))
        with self._path.open("a") as file:
            file.write(json.dumps(self.items[key]) + "\n")
