"""Harder versions of a problem: other masses, compliance, friction. What a solver has to take without a knob."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

import signorini
from signorini.scenes._bodies import check_finite, check_positive


def _copy(
    problem: signorini.ContactProblem,
    *,
    mass_factor: float = 1.0,
    compliance: npt.NDArray[np.float64] | None = None,
    friction: npt.NDArray[np.float64] | None = None,
    suffix: str,
) -> signorini.ContactProblem:
    friction = problem.friction if friction is None else friction
    compliance = problem.compliance if compliance is None else compliance
    name = f"{problem.name}{suffix}"
    if problem.mass is not None and problem.jacobian is not None:
        return signorini.ContactProblem.from_mass(
            problem.mass * mass_factor,
            problem.jacobian,
            problem.free_velocity,
            friction,
            compliance,
            name=name,
            check=False,
        )
    return signorini.ContactProblem(
        problem.delassus / mass_factor, problem.free_velocity, friction, compliance, name=name, check=False
    )


def scaled_masses(problem: signorini.ContactProblem, factor: float) -> signorini.ContactProblem:
    """The same problem with every mass times factor > 0: G and R over factor, impulses times factor.

    Raises InvalidInputError for a factor that is not positive.
    """
    check_positive(factor=factor)
    return _copy(
        problem, mass_factor=factor, compliance=np.asarray(problem.compliance) / factor, suffix=f" masses x{factor:g}"
    )


def with_compliance(problem: signorini.ContactProblem, fraction: float) -> signorini.ContactProblem:
    """The same problem with R = fraction of the diagonal of G [1/kg], fraction >= 0.

    Raises InvalidInputError for a negative fraction.
    """
    check_finite(fraction=fraction)
    if fraction < 0.0:
        raise signorini.InvalidInputError(f"fraction: is {fraction}, must be at least 0")
    compliance = fraction * np.asarray(problem.delassus.diagonal())
    return _copy(problem, compliance=compliance, suffix=f" R={fraction:g}G")


def with_friction(problem: signorini.ContactProblem, friction: float) -> signorini.ContactProblem:
    """The same problem with this friction coefficient, >= 0, at every contact.

    Raises InvalidInputError for a negative one.
    """
    check_finite(friction=friction)
    return _copy(problem, friction=np.full(problem.num_contacts, float(friction)), suffix=f" mu={friction:g}")


#: The stresses every release is measured under (docs/benchmarks): name -> problem -> problem.
STRESSES: dict[str, Callable[[signorini.ContactProblem], signorini.ContactProblem]] = {
    "as is": lambda problem: problem,
    "masses x1e-3": lambda problem: scaled_masses(problem, 1e-3),
    "masses x1e6": lambda problem: scaled_masses(problem, 1e6),
    "R 1e-6 G": lambda problem: with_compliance(problem, 1e-6),
    "R 1e-2 G": lambda problem: with_compliance(problem, 1e-2),
    "friction 0": lambda problem: with_friction(problem, 0.0),
    "friction 1e-3": lambda problem: with_friction(problem, 1e-3),
    "friction 3": lambda problem: with_friction(problem, 3.0),
    "friction 10": lambda problem: with_friction(problem, 10.0),
}
