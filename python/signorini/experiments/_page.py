"""The report of several experiments as one page: HTML with the plots in it, and Markdown beside the plots."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from signorini import _files
from signorini.experiments import _paper
from signorini.experiments._all import Outcome
from signorini.experiments._markdown import Markdown
from signorini.experiments._report import Verdict

MARK = {True: "met", False: "NOT MET", None: "-"}
_COLOR = {True: "good", False: "bad", None: ""}


class _Writer(Protocol):
    def heading(self, level: int, text: str) -> None: ...
    def paragraph(self, text: str) -> None: ...
    def listing(self, items: Sequence[str]) -> None: ...
    def verdicts(self, verdicts: Sequence[dict[str, Any]]) -> None: ...
    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None: ...
    def plot(self, path: Path) -> None: ...
    def code(self, text: str) -> None: ...


@dataclass
class Page:
    """outcomes: of the experiments, in order. about: name -> a sentence. skipped: by name. setting: how it was run."""

    outcomes: Sequence[Outcome]
    about: Mapping[str, str]
    skipped: Sequence[str]
    setting: str
    environment: Mapping[str, Any]
    output: Path

    def write(self) -> list[Path]:
        """report.html and report.md in the output folder."""
        page, text = _Html(), _Markdown()
        for writer in (page, text):
            self._into(writer)
        files = [self.output / "report.html", self.output / "report.md"]
        _files.write(files[0], page.text().encode())
        _files.write(files[1], text.text().encode())
        return files

    def _into(self, out: _Writer) -> None:
        out.heading(1, "signorini: report of the experiments")
        out.paragraph(
            f"Setting: {self.setting}. Times depend on the machine and on what else it does; compare ratios. The "
            'paper is Carpentier, Le Lidec, Montaut 2024, "From Compliant to Rigid Contact Simulation"; its times are '
            "of an Apple M1 Max."
        )
        out.table(["", ""], [[key, value] for key, value in self._machine()])
        out.heading(2, "Summary")
        out.table(
            ["experiment", "verdicts met", "not met", "no claim", "time [s]", "measured"],
            [
                [
                    outcome.name,
                    *(str(outcome.count(met)) for met in (True, False, None)),
                    f"{outcome.seconds:.0f}",
                    _measured(outcome),
                ]
                for outcome in self.outcomes
            ],
        )
        if self.skipped:
            out.paragraph("Skipped on request: " + ", ".join(self.skipped) + ".")
        for outcome in self.outcomes:
            self._experiment(out, outcome)

    def _experiment(self, out: _Writer, outcome: Outcome) -> None:
        name = outcome.name
        out.heading(2, name)
        if self.about.get(name):
            out.paragraph(self.about[name])
        if _paper.said(name):
            out.paragraph(_paper.said(name))
        if outcome.content is None:
            out.paragraph("FAILED:")
            out.code(outcome.error)
            return
        for plot in (self.output / f"{name}.png", *sorted(self.output.glob(f"{name}-*.png"))):
            if plot.exists():
                out.plot(plot)
        out.verdicts(outcome.verdicts)
        for title, (columns, rows) in outcome.content.get("tables", {}).items():
            out.heading(3, title)
            out.table(columns, rows)
        notes = [note for note in outcome.content.get("notes", []) if note != _paper.said(name)]
        if notes:
            out.heading(3, "Notes")
            out.listing(notes)

    def _machine(self) -> list[tuple[str, str]]:
        versions: dict[str, str] = {}
        for outcome in self.outcomes:
            if outcome.content is not None:
                versions.update(outcome.content.get("environment", {}).get("peers", {}) or {})
        rows = [(key, str(value)) for key, value in self.environment.items() if key not in ("peers", "date")]
        return [*rows, *((name, str(version)) for name, version in sorted(versions.items()))]


def _measured(outcome: Outcome) -> str:
    if outcome.content is None:
        return "FAILED"
    when = str(outcome.content.get("environment", {}).get("date", ""))
    return f"{when} (an earlier run)" if outcome.earlier else when


class _Markdown(Markdown):
    def verdicts(self, verdicts: Sequence[dict[str, Any]]) -> None:
        self.listing([str(Verdict(**verdict)) for verdict in verdicts])


class _Html:
    def __init__(self) -> None:
        self._parts: list[str] = []

    def text(self) -> str:
        return _FRAME.replace("BODY", "\n".join(self._parts))

    def heading(self, level: int, text: str) -> None:
        self._parts.append(f"<h{level}>{html.escape(text)}</h{level}>")

    def paragraph(self, text: str) -> None:
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def listing(self, items: Sequence[str]) -> None:
        self._parts.append("<ul>" + "".join(f"<li>{html.escape(item)}</li>" for item in items) + "</ul>")

    def verdicts(self, verdicts: Sequence[dict[str, Any]]) -> None:
        rows = "".join(
            f'<li class="{_COLOR[verdict["met"]]}">{html.escape(str(Verdict(**verdict)))}</li>' for verdict in verdicts
        )
        self._parts.append(f'<ul class="verdicts">{rows}</ul>')

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        self._parts.append(f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>')

    def plot(self, path: Path) -> None:
        data = base64.b64encode(path.read_bytes()).decode()
        self._parts.append(f'<img alt="{html.escape(path.stem)}" src="data:image/png;base64,{data}">')

    def code(self, text: str) -> None:
        self._parts.append(f"<pre>{html.escape(text)}</pre>")


_FRAME = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>signorini: report of the experiments</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; max-width: 75em; margin: 2em auto; padding: 0 1em; color: #222 }
h2 { border-bottom: 1px solid #ccc; margin-top: 2.5em } h3 { font-size: 1em; margin-bottom: .3em }
img { max-width: 100% } pre { background: #f4f4f4; padding: .8em; overflow-x: auto } .wide { overflow-x: auto }
table { border-collapse: collapse; font-size: 13px } th, td { padding: .15em .7em; text-align: right }
th, td { white-space: nowrap } th:first-child, td:first-child { text-align: left }
tr:nth-child(even) { background: #f6f6f6 } th { border-bottom: 1px solid #999 }
.verdicts { list-style: none; padding: 0 } .good { color: #1d7a3c } .bad { color: #b3261e; font-weight: 600 }
</style></head><body>
BODY
</body></html>
"""
