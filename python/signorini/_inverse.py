"""The impulse behind a contact velocity: inverse dynamics of contacts alone, without a robot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from signorini import _arrays, _core
from signorini._core import InvalidInputError
from signorini._problem import Constraint, _sets_of
from signorini._solve import LawName, _choice


@dataclass(frozen=True, repr=False, eq=False)
class InverseSolution:
    """What inverse_contact returns; complete also when there is no solution.

    status: "solved"; "infeasible", no impulse allows this velocity; "max iterations"; "invalid", the impulse is too
        large for a number. Unless solved, the impulse is the start, or the last iterate where that is much
        nearer to one that allows it
    impulse: [N s], (n,)
    velocity: s = R impulse + c [m/s], (n,), without the De Saxce correction
    residual: how far the velocity is from one that the law allows with this impulse [m/s, rad/s]: the largest
        dist(-(s + Gamma(s)), N_K(impulse)) of the constraints
    relative: the same over the largest |c| or |R guess| of a constraint; compared with the tolerance
    worst: the constraint with the largest residual; -1 without constraints
    iterations: proximal steps
    """

    status: str
    impulse: npt.NDArray[np.float64]
    velocity: npt.NDArray[np.float64]
    residual: float
    relative: float
    worst: int
    iterations: int

    @property
    def solved(self) -> bool:
        """Whether the motion is possible, to the tolerance asked for."""
        return self.status == "solved"

    def __repr__(self) -> str:
        return f"InverseSolution({self.status}, residual={self.residual:.1e} m/s, iterations={self.iterations})"


def inverse_contact(
    contact_velocity: npt.ArrayLike,
    compliance: npt.ArrayLike | None = None,
    friction: npt.ArrayLike | None = None,
    impulse_guess: npt.ArrayLike | None = None,
    law: LawName = "ncp",
    *,
    constraints: Iterable[Constraint] | None = None,
    proximal_weight: float = 1e-8,
    tolerance: float = 1e-6,
    max_iterations: int = 100,
) -> InverseSolution:
    """Which impulse x makes contacts move at c: x in K, -(s + Gamma(s)) in the normal cone of K at x, s = R x + c.

    Where R = 0 there are many answers, or none: a contact that slides at c may carry any normal impulse. The answer is
    the one next to impulse_guess. (Carpentier et al. 2024, section IV and eq. 47; docs/theory.md, section 13.)

    contact_velocity: c = J v + corrections [m/s], (n,); per contact (T1, T2, N), normal last, positive when separating.
    compliance: diagonal of R [1/kg] >= 0, (n,), equal for the two tangents of a contact; None for rigid contact.
    friction: coefficients [1] >= 0, (nc,) with n = 3 nc, for contacts only. One number serves all.
    impulse_guess: [N s], (n,), in K or not; None for 0.
    law: "ncp", Signorini and Coulomb with maximum dissipation, or "ccp", its convex relaxation, for which a rigid
        contact cannot slide without lifting.
    constraints: instead of friction, a sequence of FrictionCone, HalfLine, Interval, Equality in row order.
    proximal_weight: rho [1/kg], in (0, 1e6]; stands in where R = 0.
    tolerance: on `relative`, in (0, 1). max_iterations: at least 1.

    Raises InvalidInputError, a ValueError, naming the field, its value and what is allowed. No solution is a status.
    """
    c, r, sets = _checked(contact_velocity, compliance, friction, constraints)
    guess = np.zeros(c.size) if impulse_guess is None else _arrays.vector("impulse_guess", impulse_guess, c.size)
    settings = _core.InverseSettings()
    settings.law = _choice("law", law, _core.Law)
    settings.proximal_weight = _arrays.number("proximal_weight", proximal_weight)
    settings.tolerance = _arrays.number("tolerance", tolerance)
    settings.max_iterations = _arrays.count("max_iterations", max_iterations, 1)
    out = _core.solve_inverse(c, r, sets, settings, guess, 0.0)
    return InverseSolution(
        out.status.name, out.impulse, out.velocity, out.residual, out.relative, out.worst, out.iterations
    )


def inverse_residual(
    impulse: npt.ArrayLike,
    contact_velocity: npt.ArrayLike,
    compliance: npt.ArrayLike | None = None,
    friction: npt.ArrayLike | None = None,
    law: LawName = "ncp",
    *,
    constraints: Iterable[Constraint] | None = None,
) -> float:
    """How far a velocity is from one that the law allows with an impulse, whoever computed it [m/s, rad/s]: the largest
    dist(-(s + Gamma(s)), N_K(impulse)) of the constraints, s = R impulse + c.

    impulse: [N s], (n,), in K, to 1e-9 of its size, or InvalidInputError. The other arguments are those of
    inverse_contact.
    """
    c, r, sets = _checked(contact_velocity, compliance, friction, constraints)
    x = _arrays.vector("impulse", impulse, c.size)
    away = np.abs(sets.project(x) - x).max(initial=0.0)
    if not away <= 1e-9 * np.abs(x).max(initial=0.0):
        raise InvalidInputError(f"impulse: is {away:g} N s outside of its constraints' sets, must be in them")
    return float(_core.inverse_residual(c, r, sets, _choice("law", law, _core.Law), x))


def _checked(
    contact_velocity: npt.ArrayLike,
    compliance: npt.ArrayLike | None,
    friction: npt.ArrayLike | None,
    constraints: Iterable[Constraint] | None,
) -> tuple[_arrays.Array, _arrays.Array, _core.ConstraintSets]:
    c = _arrays.vector("contact_velocity", contact_velocity)
    sets, _, _ = _sets_of("contact_velocity", c.size, friction, constraints)
    r = np.zeros(c.size) if compliance is None else _arrays.vector("compliance", compliance, c.size)
    return c, r, sets
