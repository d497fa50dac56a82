"""Several experiments one after the other, each in its own process, going on where an interrupted run was."""

from __future__ import annotations

import hashlib
import json
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from signorini.experiments._report import RunLog

TAIL = 12  # lines of the output of an experiment that failed


@dataclass
class Outcome:
    """What became of an experiment.

    content: of its NAME.json; None when it failed. earlier: measured by an earlier run. seconds: it took. error: why it
    failed, and the end of its output.
    """

    name: str
    content: dict[str, Any] | None = None
    earlier: bool = False
    seconds: float = 0.0
    error: str = ""

    @property
    def verdicts(self) -> list[dict[str, Any]]:
        """Each as in its file: claim, measured, reference, met."""
        return [] if self.content is None else list(self.content.get("verdicts", []))

    @property
    def met(self) -> bool:
        """It ran, and no verdict says no."""
        return self.content is not None and all(verdict["met"] is not False for verdict in self.verdicts)

    def count(self, met: bool | None) -> int:
        return sum(verdict["met"] is met for verdict in self.verdicts)


@dataclass
class Runs:
    """commands: name -> the command line that writes NAME.json into the folder `output`. setting: everything that would
    make an earlier result stale (build, version, quick, ...)."""

    commands: Mapping[str, Sequence[str]]
    output: Path
    setting: dict[str, Any]
    fresh: bool = False
    progress: Callable[[int, int, str], None] = field(default=lambda done, total, what: None)

    def run(self) -> list[Outcome]:
        """Runs what has no result of this setting yet; the output of each goes to NAME.log. One that fails does not
        keep the others from running."""
        log = RunLog(self.output / "all.runs.jsonl", self.setting, self.fresh)
        outcomes = []
        for done, name in enumerate(self.commands):
            self.progress(done, len(self.commands), name)
            outcomes.append(self._earlier(log, name) or self._measured(log, name))
        self.progress(len(self.commands), len(self.commands), "")
        return outcomes

    def _earlier(self, log: RunLog, name: str) -> Outcome | None:
        if name not in log:
            return None
        item = log.items[name]
        content, digest = _read(self.output / f"{name}.json")
        # Another run into this folder, of one experiment with options of its own, may have written over the result.
        if content is None or digest != item["digest"]:
            return None
        return Outcome(name, content, True, item["seconds"])

    def _measured(self, log: RunLog, name: str) -> Outcome:
        result = self.output / f"{name}.json"
        said = self.output / f"{name}.log"
        result.unlink(missing_ok=True)
        began = time.perf_counter()
        with said.open("w") as file:
            code = subprocess.run(
                list(self.commands[name]), stdout=file, stderr=subprocess.STDOUT, check=False
            ).returncode
        seconds = time.perf_counter() - began
        content, digest = _read(result)
        if code != 0 or content is None:
            why = f"exit status {code}" if code else f"wrote no {result.name} that can be read"
            tail = said.read_text(errors="replace").rstrip().splitlines()[-TAIL:]
            return Outcome(name, None, False, seconds, "\n".join([why, *tail]))
        log.add(name, {"seconds": seconds, "digest": digest})
        return Outcome(name, content, False, seconds)


def _read(path: Path) -> tuple[dict[str, Any] | None, str]:
    """The content of a result, None when there is none, and a hash of it."""
    try:
        raw = path.read_bytes()
        content = json.loads(raw)
    except (OSError, ValueError):
        return None, ""
    return (content if isinstance(content, dict) else None), hashlib.sha256(raw).hexdigest()
