"""Plots without a screen; matplotlib is optional (`pip install 'signorini[plots]'`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

COLORS = {
    "ours": "#c0392b",
    "paper": "#2471a3",
    "admm": "#7fb3d5",
    "pgs": "#7d8a91",
    "other": "#28b463",
}


def available() -> bool:
    """Whether matplotlib can be imported."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True


def figure(rows: int, columns: int, width: float = 4.2, height: float = 3.2) -> tuple[Any, Any]:
    """A figure of its own, no global state: (figure, axes (rows, columns))."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width * columns, height * rows), layout="constrained")
    FigureCanvasAgg(made)
    axes = made.subplots(rows, columns, squeeze=False)
    for axis in axes.ravel():
        axis.grid(True, which="major", alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    return made, axes


def save(made: Any, path: Path) -> Path:
    """As PNG."""
    made.savefig(path, dpi=160)
    return path
