"""Ours, in a process like the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import _worker
import numpy as np

import signorini
from signorini.engines import _exchange


class Engine:
    """run(), which certifies every step."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        self.simulator = signorini.Simulator(_exchange.build(model), time_step=time_step, tolerance=1e-6)
        self.model = model
        self.traces: list[signorini.Trace] = []

    def set_state(self, q: Any) -> None:
        self.simulator.state.q = q

    def state(self) -> tuple[Any, Any]:
        return np.array(self.simulator.state.q), np.array(self.simulator.state.v)

    def step(self, count: int) -> None:
        self.traces.append(self.simulator.run(count))

    def mass_matrix(self) -> Any:
        return self.simulator.mass_matrix

    def total_mass(self) -> float:
        return float(sum(link["mass"] for link in self.model["links"]))

    def extra(self) -> dict[str, float]:
        return {
            "worst_certificate": max(float(trace.relative.max()) for trace in self.traces),
            "unsolved": int(sum(np.count_nonzero(~trace.solved) for trace in self.traces)),
        }


if __name__ == "__main__":
    _worker.main(signorini.__version__, Engine)
