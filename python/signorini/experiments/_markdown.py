"""Markdown of what experiments say."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path


class Markdown:
    """A page that grows."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def text(self) -> str:
        return "\n".join(self._lines).rstrip() + "\n"

    def heading(self, level: int, text: str) -> None:
        self._lines += ["#" * level + " " + _plain(text), ""]

    def paragraph(self, text: str) -> None:
        self._lines += [_plain(text), ""]

    def listing(self, items: Sequence[str]) -> None:
        self._lines += [*("- " + _plain(item) for item in items), ""]

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        for row in (columns, ["---"] * len(columns), *rows):
            self._lines.append("| " + " | ".join(_plain(cell).replace("|", "\\|") for cell in row) + " |")
        self._lines.append("")

    def plot(self, path: Path) -> None:
        self._lines += [f"![{path.stem}]({path.name})", ""]

    def code(self, text: str) -> None:
        self._lines += ["```text", text.replace("```", "'''"), "```", ""]


def _plain(text: str) -> str:
    """On one line; without what Markdown would take for HTML, a link (no [ but before ...]( is one) or emphasis (no _
    inside a word)."""
    for mark in "<*`":
        text = text.replace(mark, "\\" + mark)
    text = re.sub(r"\[(?=[^\]]*\][(\[:])", r"\\[", text)
    return " ".join(re.sub(r"(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])", r"\\_", text).split())
