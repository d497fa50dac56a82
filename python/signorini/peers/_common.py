"""What every peer shares: the shape of an answer, and the problem as a cone program."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

import signorini
from signorini import _arrays
from signorini._problem import check_problem
from signorini._solution import check_tolerance
from signorini._solve import LawName

Array = npt.NDArray[np.float64]


class PeerUnavailableError(RuntimeError):
    """The peer's package is not installed; the message says which."""


@dataclass(frozen=True)
class PeerSolution:
    """A peer's answer, judged by our certificate.

    status: "solved" when residual.solves(tolerance asked for), and only then; "max iterations", "stalled" (the
    peer gave up or claims success wrongly), "timeout" or "crashed". claimed: what the peer itself says. impulse: (3nc,)
    [N s], order T1, T2, N; zero when there is none. iterations: the peer's own, summed over outer iterations.
    factorizations: where the peer counts them. seconds: of the peer's set-up and solve, conversions excluded.
    """

    peer: str
    status: str
    claimed: bool
    impulse: Array = field(repr=False)
    residual: signorini.Residual
    iterations: int
    seconds: float
    outer_iterations: int = 1
    factorizations: int | None = None
    note: str = ""

    @property
    def solved(self) -> bool:
        """True when our certificate holds at the tolerance asked for."""
        return self.status == "solved"


def judged(
    peer: str,
    problem: signorini.ContactProblem,
    impulse: Array,
    law: LawName,
    tolerance: float,
    *,
    claimed: bool,
    iterations: int,
    seconds: float,
    limited: bool,
    outer_iterations: int = 1,
    factorizations: int | None = None,
    note: str = "",
) -> PeerSolution:
    """The answer with its certificate. limited: the peer stopped at a limit of iterations."""
    if not np.all(np.isfinite(impulse)):
        impulse = np.zeros(problem.size)
        note = note or "returned an impulse that is not finite"
    residual = signorini.residual(problem, impulse, law)
    status = "solved" if residual.solves(tolerance) else "max iterations" if limited else "stalled"
    return PeerSolution(
        peer, status, claimed, impulse, residual, iterations, seconds, outer_iterations, factorizations, note
    )


def check_input(problem: signorini.ContactProblem, law: LawName, tolerance: float, max_iterations: int) -> None:
    """Raises InvalidInputError for what peers do not take, some of them by a crash: constraints other than friction
    cones, or none; another law than "ncp" or "ccp"; limits that check_limits refuses."""
    check_problem(problem)
    if 3 * problem.num_contacts != problem.size:
        raise signorini.InvalidInputError(
            "problem: has constraints other than friction cones, which the peers do not take"
        )
    if problem.size == 0:
        raise signorini.InvalidInputError("problem: has no contacts, must have at least 1 for a peer")
    if law not in ("ncp", "ccp"):
        raise signorini.InvalidInputError(f'law: is "{law}", must be "ncp" or "ccp"')
    check_limits(tolerance, max_iterations)


def check_limits(tolerance: float, max_iterations: int) -> None:
    """Raises InvalidInputError for a tolerance outside (0, 1) and for less than one iteration, as solve() does."""
    check_tolerance(tolerance)
    _arrays.count("max_iterations", max_iterations, 1)


def system_matrix(problem: signorini.ContactProblem) -> sp.csc_matrix:
    """G + R, symmetric, with sorted indices [1/kg]."""
    matrix = (sp.csc_matrix(problem.delassus) + sp.diags(np.asarray(problem.compliance))).tocsc()
    matrix = ((matrix + matrix.T) * 0.5).tocsc()
    matrix.sort_indices()
    return matrix


def de_saxce_correction(problem: signorini.ContactProblem, matrix: sp.csc_matrix, impulse: Array) -> Array:
    """Gamma(sigma) at an impulse: (0, 0, friction |sigma_T|) a contact [m/s]."""
    velocity = matrix @ impulse + problem.free_velocity
    correction = np.zeros(problem.size)
    correction[2::3] = problem.friction * np.hypot(velocity[0::3], velocity[1::3])
    return correction


@dataclass(frozen=True)
class ConeProgram:
    """min 1/2 x'Px + c'x subject to A x + s = 0, s in zero x nonnegative x second-order cones of size 3.

    x is the impulse in scaled units, impulse = unit scale x, so that P has diagonal blocks of unit size and c has unit
    size: the absolute tolerances of a cone solver mean something then. A contact without friction has no second-order
    cone: its tangential rows are zero and its normal row is nonnegative.
    """

    p: sp.csc_matrix
    c: Array
    a: sp.csc_matrix
    num_zero: int
    num_nonnegative: int
    num_second_order: int
    scale: Array
    unit: float

    @staticmethod
    def of(problem: signorini.ContactProblem, matrix: sp.csc_matrix) -> ConeProgram:
        """matrix: G + R, from system_matrix."""
        friction = np.asarray(problem.friction)
        trace = matrix.diagonal().reshape(-1, 3).mean(axis=1)
        scale = np.repeat(1.0 / np.sqrt(np.where(trace > 0.0, trace, 1.0)), 3)
        linear = scale * problem.free_velocity
        unit = float(np.abs(linear).max(initial=0.0)) or 1.0
        p = (sp.diags(scale) @ matrix @ sp.diags(scale)).tocsc()

        (slick,) = np.nonzero(friction == 0.0)
        (rough,) = np.nonzero(friction > 0.0)
        blocks = [3 * np.repeat(slick, 2) + np.tile([0, 1], len(slick)), 3 * slick + 2]
        blocks.append((3 * rough[:, None] + np.array([2, 0, 1])).ravel())
        columns = np.concatenate(blocks)
        values = -np.ones(len(columns))
        # (mu x_N, x_T) in the cone; divided by mu where mu > 1
        steep = np.maximum(friction[rough], 1.0)
        values[3 * len(slick) :] = -np.stack([friction[rough] / steep, 1.0 / steep, 1.0 / steep], axis=1).ravel()
        a = sp.csc_matrix((values, (np.arange(len(columns)), columns)), shape=(len(columns), problem.size))
        return ConeProgram(p, linear / unit, a, 2 * len(slick), len(slick), len(rough), scale, unit)

    def linear(self, free_velocity: Array) -> Array:
        """c for another right-hand side g + Gamma [m/s]."""
        out: Array = self.scale * free_velocity / self.unit
        return out

    def impulse(self, x: Array, friction: Array) -> Array:
        """[N s], put on the cone exactly where the solver stopped a rounding outside it."""
        impulse: Array = np.array(self.unit * self.scale * x, dtype=np.float64).reshape(-1, 3)
        normal = np.maximum(impulse[:, 2], 0.0)
        tangential = np.linalg.norm(impulse[:, :2], axis=1)
        limit = friction * normal
        factor = np.where(tangential > limit, limit / np.where(tangential > 0.0, tangential, 1.0), 1.0)
        impulse[:, :2] *= factor[:, None]
        impulse[:, 2] = normal
        return impulse.reshape(-1)
