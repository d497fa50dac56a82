"""Where a motion really goes, and how far another one is from it: a run of ours with far smaller steps, and a judge of
what any simulator passed through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import signorini
from signorini.engines import _worker

TIME_STEP = 1e-3
TOLERANCES = (1e-10, 1e-8, 1e-6)  # of the reference, the first that will do
EARLY = 0.15  # [s]
KNOWN = 1e-3  # [m]: two fine runs this far apart no longer say where the motion goes
PARTED = 0.01  # [m]: two motions this far apart have parted
BLOCK = _worker.BLOCK
LOOK = BLOCK * TIME_STEP  # between two looks at the state [s]


@dataclass(frozen=True)
class Judge:
    """The rulers. reference: positions of the links (times, links, 3) of the fine run; horizon: until when it is known
    to a millimetre: after that two fine runs of ours have parted, and nobody's error means anything [s]. at_rest: it
    ought to stay where it is."""

    world: signorini.World
    reference: Any
    horizon: float
    at_rest: bool = False

    def errors(self, states: list[Any]) -> Any:
        """Largest distance of a link from the reference, at each look up to the horizon [m]; shorter where the states
        end before. states: (q, v) every LOOK."""
        count = min(len(states), round(self.horizon / LOOK) + 1)
        at = [places(self.world, np.array(q)) for q, _ in states[:count]]
        return np.linalg.norm(np.array(at) - self.reference[:count], axis=2).max(axis=1)

    def __call__(self, answer: dict[str, Any]) -> dict[str, float | None]:
        """Of one run: error against the reference early and at the horizon [m], None where it stopped before; when it
        parted from it [s], deepest overlap [m], creep: the fastest body over the second half, of a scene at rest [m/s],
        largest gain of energy and final change [J], loops' largest gap [m]."""
        states = [(np.array(q), np.array(v)) for q, v in answer["states"]]
        error = self.errors(states)
        early = round(EARLY / LOOK)
        parted = np.flatnonzero(error > PARTED)
        overlap = max((-d for q, _ in states for _, _, d in self.world.touching_pairs(q, 0.0)), default=0.0)
        energies = energy(self.world, states)
        half = (len(states) - 1) // 2
        moved = np.linalg.norm(places(self.world, states[-1][0]) - places(self.world, states[half][0]), axis=1).max()
        gaps = [np.abs(self.world.constraint_gaps(q)).max() for q, _ in states] if self.world.constraints else []
        return {
            "error_early": float(error[early]) if early < len(error) else None,
            "error_horizon": float(error[-1]) if len(error) == len(self.reference) else None,
            "parted": float(parted[0] * LOOK) if parted.size else None,
            "overlap": max(overlap, 0.0),
            "creep": float(moved / ((len(states) - 1 - half) * LOOK)) if self.at_rest and len(states) > 1 else None,
            "energy_gain": float((energies - energies[0]).max()),
            "energy_change": float(energies[-1] - energies[0]),
            "loop_gap": float(max(gaps)) if gaps else None,
        }


def places(world: signorini.World, q: Any) -> Any:
    """(links, 3): origins of all links in the world [m]."""
    return np.array([frame.translation for frame in world._core.frame_placements(q)[1:]])


def energy(world: signorini.World, states: list[tuple[Any, Any]]) -> Any:
    """Total energy of each state [J]."""
    simulator = signorini.Simulator(world)
    out = []
    for q, v in states:
        simulator.state.q, simulator.state.v = q, v
        out.append(simulator.energy.total)
    return np.array(out)


def reference(world: signorini.World, q: Any, duration: float, fine: int) -> tuple[Any, float, float]:
    """Positions of the links every LOOK, with steps fine times smaller than TIME_STEP; the time until which a run with
    steps twice as large stays within KNOWN of it [s], where it ends; the tolerance of both.

    The tolerance is the first of TOLERANCES with which that time is not short, else that of the longest.
    """
    best: tuple[Any, float, float] | None = None
    for tolerance in TOLERANCES:
        at = _together(world, q, duration, fine, tolerance)
        horizon = (len(at) - 1) * LOOK
        if best is None or horizon > best[1]:
            best = at, horizon, tolerance
        if horizon >= min(EARLY, duration) - 1e-9:
            break
    assert best is not None
    return best


def _together(world: signorini.World, q: Any, duration: float, fine: int, tolerance: float) -> Any:
    """The finer of two runs, as long as they are together."""
    runs = []
    for refinement in (fine, fine // 2):
        step = TIME_STEP / refinement
        runs.append((signorini.Simulator(world, time_step=step, tolerance=tolerance), refinement))
        runs[-1][0].state.q = q
    out = [places(world, q)]
    for _ in range(round(duration / LOOK)):
        at = []
        for simulator, refinement in runs:
            simulator.run(BLOCK * refinement)
            at.append(places(world, simulator.state.q))
        if np.linalg.norm(at[0] - at[1], axis=1).max() > KNOWN:
            break
        out.append(at[0])
    return np.array(out)


def millimetres(value: float | None) -> str:
    return "" if value is None else short(1e3 * value)


def short(value: float) -> str:
    """Two digits; of what has more before the point the rest as zeros."""
    return f"{float(f'{value:.2g}'):.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.2g}"
