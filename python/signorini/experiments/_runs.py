"""Solvers under one shape, run in turns on one core, each with its certificate beside its time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import signorini
from signorini import _core, peers

PAPER_SETTINGS: dict[str, Any] = {
    "penalty_rule": "spectral",
    "spectral_increment": 0.05,
    "scaling": False,
    "anderson_memory": 0,
}
REPEATS = 5
_LONG = 0.5  # s; what takes longer is not repeated
SHORT = 0.01  # s; what takes less runs once unmeasured before, or it pays for the caches that the one before left cold


@dataclass(frozen=True)
class Runner:
    """A solver with its settings: run(problem) -> anything with status, residual, iterations, seconds."""

    name: str
    run: Callable[[signorini.ContactProblem], Any]


def ours(name: str, solver: str = "auto", tolerance: float = 1e-6, **settings: Any) -> Runner:
    """signorini.solve with these settings, cold: each run makes its memory and its analysis of the pattern anew."""

    def run(problem: signorini.ContactProblem) -> signorini.Solution:
        workspace = signorini.Workspace()
        return signorini.solve(problem, solver, tolerance=tolerance, workspace=workspace, **settings)  # type: ignore[arg-type]

    return Runner(name, run)


def peer(entry: peers.Peer, tolerance: float, **settings: Any) -> Runner:
    """A peer at this tolerance."""

    def run(problem: signorini.ContactProblem) -> peers.PeerSolution:
        return entry.solve(problem, tolerance=tolerance, **settings)

    return Runner(entry.name, run)


def measure(problem: signorini.ContactProblem, runners: Sequence[Runner], repeats: int = REPEATS) -> dict[str, Any]:
    """Every runner on one problem, in turns, `repeats` times when it is quick: the least time, which other work
    disturbs least, the spread of all, and the certificate of the first answer that is timed."""
    order = np.random.default_rng(0)
    out: dict[str, dict[str, Any]] = {}
    times: dict[str, list[float]] = {runner.name: [] for runner in runners}
    for turn in range(repeats):
        for k in order.permutation(len(runners)):  # nobody always comes after the same one
            runner = runners[k]
            if turn and times[runner.name][0] > _LONG:
                continue
            solution = runner.run(problem)
            if solution.seconds < SHORT:
                solution = runner.run(problem)
            times[runner.name].append(float(solution.seconds))
            if turn == 0:
                out[runner.name] = record(solution)
    for name, seconds in times.items():
        out[name]["seconds"] = min(seconds)
        out[name]["seconds_spread"] = max(seconds) - min(seconds)
        out[name]["repeats"] = len(seconds)
    return out


def record(solution: Any) -> dict[str, Any]:
    """The numbers of one answer."""
    residual = solution.residual
    return {
        "status": str(solution.status),
        "relative": float(residual.relative),
        "against_free_velocity": float(residual.against_free_velocity),
        "primal": float(residual.primal),
        "dual": float(residual.dual),
        "complementarity": float(residual.complementarity),
        "iterations": int(solution.iterations),
        "factorizations": None if solution.factorizations is None else int(solution.factorizations),
        "seconds": float(solution.seconds),
        "claimed": bool(getattr(solution, "claimed", solution.status == "solved")),
        "method": str(getattr(solution, "solver", getattr(solution, "peer", ""))),
    }


def solves(run: dict[str, Any], tolerance: float) -> bool:
    """True when the certificate holds (Residual.solves); a number that was not finite is None here."""
    relative, share = run["relative"], run["against_free_velocity"]
    if relative is None or share is None:
        return False
    return bool(relative <= tolerance and share <= _core.Residual.largest_share(tolerance))


def solves_absolutely(run: dict[str, Any], tolerance: float) -> bool:
    """True when the three residuals in SI units hold, the paper's test (43) asked of the true problem."""
    return all(run[key] is not None and run[key] <= tolerance for key in ("primal", "dual", "complementarity"))
