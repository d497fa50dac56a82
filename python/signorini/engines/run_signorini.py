"""Ours, in a process like the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import _worker
import numpy as np

import signorini
from signorini.engines import _exchange


class Engine:
    """step(), which certifies every step; extra() reads the certificates from the same run again, whose time does not
    count."""

    def __init__(self, folder: Path, model: dict[str, Any], setting: str, time_step: float) -> None:
        self.simulator = signorini.Simulator(_exchange.build(model), time_step=time_step, tolerance=1e-6)
        self.model = model

    def set_state(self, q: Any) -> None:
        self.simulator.state.q = self.start = q
        self.steps = 0

    def state(self) -> tuple[Any, Any]:
        return np.array(self.simulator.state.q), np.array(self.simulator.state.v)

    def step(self, count: int) -> None:
        self.simulator.step(count)
        self.steps += count

    def mass_matrix(self) -> Any:
        return self.simulator.mass_matrix

    def total_mass(self) -> float:
        return float(sum(link["mass"] for link in self.model["links"]))

    def report(self) -> dict[str, Any]:
        world = self.simulator.world
        bodies = world.bodies[1:]
        joints = world.joints
        of = [world.bodies[g.body].frame - 1 for g in world.geometries]
        found = {tuple(sorted((of[a], of[b]))) for a in range(len(of)) for b in range(a) if world._core.may_touch(a, b)}
        return {
            "time_step": self.simulator.settings.time_step,
            "gravity": world.gravity.tolist(),
            "links": [[b.mass, *_worker.principal(b.inertia)] if b.mass > 0.0 else None for b in bodies],
            "limits": sum(bool(np.isfinite([joint.lower, joint.upper]).any()) for joint in joints),
            "damping": max((joint.damping + joint.friction for joint in joints), default=0.0),
            "pairs": sorted(found),
        }

    def touching(self) -> list[Any]:
        contacts = self.simulator.contacts
        names = [link["name"] for link in self.model["links"]]
        number = {name: k for k, name in enumerate(names)}
        return [[number.get(c.body_a, -1), number.get(c.body_b, -1)] for c in contacts]

    def extra(self) -> dict[str, float]:
        again = signorini.Simulator(self.simulator.world, self.simulator.settings)
        again.state.q = self.start
        trace = again.run(self.steps)
        return {"worst_certificate": float(trace.relative.max()), "unsolved": self.simulator.report.unsolved}


if __name__ == "__main__":
    _worker.main(signorini.__version__, Engine)
