from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from signorini import _arrays, _core


def check_tolerance(tolerance: Any) -> None:
    if not 0.0 < _arrays.number("tolerance", tolerance) < 1.0:
        raise _core.InvalidInputError(f"tolerance: is {tolerance}, must be in (0, 1)")


@dataclass(frozen=True)
class Residual:
    """The certificate: how far an impulse is from solving a problem. NaN as soon as anything is.

    primal: distance of the impulse from K [N s]
    dual: distance of the corrected velocity from the dual cone [m/s]
    complementarity: |impulse . corrected velocity| [J]
    relative: the number that judges, free of units and scale (docs/theory.md, T12)
    against_free_velocity: the same residual over what the free velocity asks for, so what is left of what there was to
        solve; impulses that grow without bound, as in a problem without solution, make `relative` small but not this
    signorini: approach speed [m/s] or pull [N s] left over, friction cones only
    dissipation: defect of maximum dissipation [J], friction cones only

    Each is the maximum over the constraints.
    """

    primal: float
    dual: float
    complementarity: float
    relative: float
    against_free_velocity: float
    signorini: float
    dissipation: float

    def solves(self, tolerance: float) -> bool:
        """What "solved" means: relative within the tolerance, against_free_velocity within 1000 tolerances and 0.1.

        Raises InvalidInputError on a tolerance outside (0, 1).
        """
        check_tolerance(tolerance)
        return self.relative <= tolerance and self.against_free_velocity <= _core.Residual.largest_share(tolerance)

    def to_dict(self) -> dict[str, float]:
        """The fields by name."""
        return asdict(self)

    @classmethod
    def _from_core(cls, r: _core.Residual) -> Residual:
        # One by one: a loop over fields() would take longer than a small solve.
        return cls(r.primal, r.dual, r.complementarity, r.relative, r.against_free_velocity, r.signorini, r.dissipation)


HISTORY_TYPE = np.dtype(
    [("iteration", np.int64), ("factorizations", np.int64), ("penalty", np.float64)]
    + [(each.name, np.float64) for each in fields(Residual)]
)


def _no_history() -> npt.NDArray[np.void]:
    return np.zeros(0, HISTORY_TYPE)


@dataclass(frozen=True, repr=False, eq=False)
class Solution:
    """What a solver returns; complete also when it failed.

    status: "solved" (residual.solves(tolerance); said of nothing else), "max iterations", "stalled" (the impulse is
        then the best seen; so ends also a model other than the law when it is solved), "infeasible" ("auto" only: the
        impulse points along a ray which proves that there is no solution, or none below 1e12 times the free velocity:
        docs/theory.md, T49) or "invalid" (no finite impulse was found, it is zero)
    solver: the method that produced the answer
    impulse: [N s], (n,)
    velocity: s = (G + R) impulse + g [m/s], (n,), without the De Saxce correction
    residual: the certificate of `impulse`
    model_residual: relative residual of what the solver really solves; residual.relative but for "lcp-pgs",
        "convex-newton" and "bisection"
    iterations, factorizations: counts
    seconds: wall time of the solve
    penalty: ADMM's last rho, for a warm start; 0 for other methods
    history: structured array, one record an iterate, if asked for: iteration, factorizations, penalty and the fields
        of Residual. Newton's method, the interior point and "convex-newton" begin with their start, iteration 0; of
        "auto" there are the iterates of each method it tried in each island, one after the other, counted through
    """

    status: str
    solver: str
    impulse: npt.NDArray[np.float64]
    velocity: npt.NDArray[np.float64]
    residual: Residual
    iterations: int = 0
    factorizations: int = 0
    seconds: float = 0.0
    penalty: float = 0.0
    history: npt.NDArray[np.void] = field(default_factory=_no_history)
    model_residual: float = math.nan

    @property
    def solved(self) -> bool:
        """Whether the certificate holds at the tolerance asked for."""
        return self.status == "solved"

    def __repr__(self) -> str:
        return (
            f"Solution({self.status}, solver={self.solver}, relative={self.residual.relative:.1e}, "
            f"iterations={self.iterations}, factorizations={self.factorizations}, seconds={self.seconds:.2g})"
        )

    @classmethod
    def _from_core(cls, s: _core.Solution, recorded: bool) -> Solution:
        history = _no_history()
        if recorded:
            rows = s.history
            history = np.zeros(len(rows), HISTORY_TYPE)
            for i, name in enumerate(HISTORY_TYPE.names or ()):
                history[name] = rows[:, i]
        return cls(
            status=s.status.name,
            solver=s.solver.name,
            impulse=s.impulse,
            velocity=s.velocity,
            residual=Residual._from_core(s.residual),
            iterations=s.iterations,
            factorizations=s.factorizations,
            seconds=s.seconds,
            penalty=s.penalty,
            history=history,
            model_residual=s.model_residual,
        )
