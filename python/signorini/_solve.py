from __future__ import annotations

from functools import lru_cache
from typing import Any, Literal, TypeVar

import numpy.typing as npt

from signorini import _arrays, _core
from signorini._core import InvalidInputError, Workspace
from signorini._problem import ContactProblem, check_problem
from signorini._solution import Residual, Solution

SolverName = Literal["auto", "admm", "pgs", "interior-point", "newton", "lcp-pgs", "convex-newton", "bisection"]
LawName = Literal["ncp", "ccp"]
PenaltyRuleName = Literal["spectral", "linear", "residual-balancing", "constant"]

_E = TypeVar("_E")


def _choice(field: str, value: Any, choices: type[_E]) -> _E:
    names: dict[str, _E] = choices.__members__  # type: ignore[attr-defined]
    if not isinstance(value, str) or value not in names:
        allowed = ", ".join(repr(name) for name in names)
        raise InvalidInputError(f"{field}: is {value!r}, must be one of {allowed}")
    return names[value]


def solve(
    problem: ContactProblem,
    solver: SolverName = "auto",
    law: LawName = "ncp",
    tolerance: float = 1e-6,
    *,
    max_iterations: int | None = None,
    guess: npt.ArrayLike | Solution | None = None,
    aim: float | None = None,
    record_history: bool = False,
    workspace: Workspace | None = None,
    penalty_rule: PenaltyRuleName = "residual-balancing",
    penalty: float | None = None,
    proximal_weight: float = 1e-6,
    spectral_exponent: float = 0.25,
    spectral_increment: float = 0.05,
    linear_factor: float = 2.0,
    ratio: float = 10.0,
    scaling: bool = True,
    anderson_memory: int = 10,
    paper_tolerance: float | None = None,
    over_relaxation: float = 1.0,
    facets: int = 4,
    impedance: float = 0.9,
    least_relaxation: float = 0.7,
    relaxation_decay: float = 0.99,
) -> Solution:
    """Solves a contact problem and certifies the answer. Releases the GIL.

    solver: "auto" (chooses; start here), "admm", "pgs", "interior-point" or "newton"; or another engine's model of
        contact, to compare with: "lcp-pgs", "convex-newton" or "bisection" (docs/models.md). These are judged by the
        same certificate, hence seldom "solved"; how well they solve their own model is Solution.model_residual.
    law: "ncp", Signorini and Coulomb with maximum dissipation, or "ccp", its convex relaxation (MuJoCo's and Drake's
        model), which lifts sliding contacts.
    tolerance: on the certificate's relative residual (Residual.solves), in (0, 1).
    max_iterations: at least 1; None for the solver's own default. Of "auto": factorisations that an island may cost,
        about (docs/auto.md).
    guess: where to start: an impulse [N s], (n,), or the Solution of a similar problem.
    aim: what "auto" aims at from a guess while that is cheap, in (0, tolerance]; None: 1e-3 tolerance.
    record_history: fill Solution.history.
    workspace: memory to reuse from solve to solve; one for each thread. None: the thread's own for up to 300 rows, else
        new.

    ADMM (Carpentier et al. 2024, Algorithm 1) only:
    penalty_rule: how rho moves: "spectral" (46), "linear" (44), "residual-balancing" or "constant".
    penalty: starting rho [1/kg; 1 when scaled], > 0; None: chosen by the rule.
    proximal_weight: eta [1/kg; 1 when scaled], > 0.
    spectral_exponent, spectral_increment: starting p and its step in the spectral rule.
    linear_factor: tau of the linear rule, > 1.
    ratio: residual ratio that triggers a change of rho, > 1.
    scaling: solve with one scale factor a contact.
    anderson_memory: columns of Anderson acceleration; 0 turns it off.
    paper_tolerance: also stop when (43) holds at this absolute tolerance, as the paper does.
    The paper's method as written: penalty_rule="spectral", scaling=False, anderson_memory=0, paper_tolerance=1e-6.

    PGS and lcp-pgs only:
    over_relaxation: in (0, 2).

    lcp-pgs only (the model of ODE, PhysX and DART):
    facets: of the pyramid around the friction cone, even, in [4, 64].

    convex-newton only (the model of MuJoCo and Drake):
    impedance: MuJoCo's d, in [0.001, 1 - 1e-6]; every constraint has a compliance of (1 - d) / d of its mean diagonal.

    bisection only (the model of RaiSim):
    least_relaxation, relaxation_decay: the share of a new impulse that is taken, in (0, 1], and the factor by which its
        distance to that shrinks from 1 a sweep, in [0, 1].

    Raises InvalidInputError on bad arguments. A solve that fails raises nothing: look at Solution.status.
    """
    core = check_problem(problem)._core
    arguments = (
        solver, law, tolerance, max_iterations, aim, record_history, penalty_rule, penalty, proximal_weight,
        spectral_exponent, spectral_increment, linear_factor, ratio, scaling, anderson_memory, paper_tolerance,
        over_relaxation, facets, impedance, least_relaxation, relaxation_decay,
    )  # fmt: skip
    try:
        settings = _known_settings(*arguments)
    except (TypeError, ValueError):  # one has no hash; mostly it is refused
        settings = _settings(*arguments)

    if workspace is not None and not isinstance(workspace, Workspace):
        raise InvalidInputError(f"workspace: is a {type(workspace).__name__}, must be a signorini.Workspace")
    start = None
    if isinstance(guess, Solution):
        start = _core.Guess(_arrays.vector("guess", guess.impulse, problem.size), guess.penalty)
    elif guess is not None:
        start = _core.Guess(_arrays.vector("guess", guess, problem.size), 0.0)
    return Solution._from_core(_core.solve(core, settings, workspace, start), settings.record_history)


def _settings(*arguments: Any) -> _core.Settings:
    """Of solve(), checked but for their ranges."""
    (
        solver, law, tolerance, max_iterations, aim, record_history, penalty_rule, penalty, proximal_weight,
        spectral_exponent, spectral_increment, linear_factor, ratio, scaling, anderson_memory, paper_tolerance,
        over_relaxation, facets, impedance, least_relaxation, relaxation_decay,
    ) = arguments  # fmt: skip
    settings = _core.Settings()
    settings.solver = _choice("solver", solver, _core.SolverType)
    settings.law = _choice("law", law, _core.Law)
    settings.tolerance = _arrays.number("tolerance", tolerance)
    if max_iterations is not None:
        settings.max_iterations = _arrays.count("max_iterations", max_iterations, 1)
    if aim is not None:
        settings.aim = _positive("aim", aim)
    settings.record_history = bool(record_history)

    admm = settings.admm
    admm.penalty_rule = _choice("penalty_rule", penalty_rule, _core.PenaltyRule)
    if penalty is not None:
        admm.penalty = _positive("penalty", penalty)
    admm.proximal_weight = _arrays.number("proximal_weight", proximal_weight)
    admm.spectral_exponent = _arrays.number("spectral_exponent", spectral_exponent)
    admm.spectral_increment = _arrays.number("spectral_increment", spectral_increment)
    admm.linear_factor = _arrays.number("linear_factor", linear_factor)
    admm.ratio = _arrays.number("ratio", ratio)
    admm.scaling = bool(scaling)
    admm.anderson_memory = _arrays.count("anderson_memory", anderson_memory)
    if paper_tolerance is not None:
        admm.paper_tolerance = _positive("paper_tolerance", paper_tolerance)
    settings.pgs.over_relaxation = _arrays.number("over_relaxation", over_relaxation)
    settings.pyramid.facets = _arrays.count("facets", facets)
    settings.convex.impedance = _arrays.number("impedance", impedance)
    settings.bisection.least_relaxation = _arrays.number("least_relaxation", least_relaxation)
    settings.bisection.relaxation_decay = _arrays.number("relaxation_decay", relaxation_decay)
    return settings


# Checking and copying them takes longer than a small solve, and loops repeat them. Nobody writes to settings.
_known_settings = lru_cache(maxsize=64, typed=True)(_settings)


def residual(problem: ContactProblem, impulse: npt.ArrayLike, law: LawName = "ncp") -> Residual:
    """The certificate of an impulse [N s], (n,), whoever computed it.

    law: "ncp" or "ccp", as for solve.

    Raises InvalidInputError when the impulse has another size.
    """
    core = check_problem(problem)._core
    x = _arrays.vector("impulse", impulse, problem.size)
    return Residual._from_core(_core.residual(core, x, _choice("law", law, _core.Law)))


def _positive(field: str, value: Any) -> float:
    result = _arrays.number(field, value)
    if not result > 0.0:
        raise InvalidInputError(f"{field}: is {value!r}, must be > 0, or None")
    return result
