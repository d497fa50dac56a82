"""Pinocchio 4.1's own contact solvers: the ADMM of the paper's authors, and projected Gauss-Seidel."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import signorini
from signorini._solve import LawName
from signorini.peers._common import PeerSolution, PeerUnavailableError, check_input, judged, system_matrix

NAME = "pinocchio"


def version() -> str:
    """The version installed. Raises PeerUnavailableError without the package or with one that has another interface."""
    try:
        import pinocchio
    except ImportError as error:
        raise PeerUnavailableError("pinocchio is not installed: pip install 'signorini[peers]'") from error
    if not hasattr(pinocchio, "ADMMConstraintSolver"):
        raise PeerUnavailableError(f"pinocchio {pinocchio.__version__} has no ADMMConstraintSolver, 4.1 does")
    return str(pinocchio.__version__)


def _constraints(problem: signorini.ContactProblem) -> tuple[Any, Any]:
    """Point contacts of a free body: the solvers only ask them for their sizes and friction."""
    import pinocchio as pin

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    models, data = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    for friction in problem.friction:
        contact = pin.PointContactConstraintModel(model, joint, pin.SE3.Identity())
        contact.setFriction(float(friction))
        models.append(pin.ConstraintModel(contact))
        data.append(models[len(models) - 1].createData())
    return models, data


def _tolerances(settings: Any, tolerance: float) -> None:
    settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = tolerance
    settings.relative_feasibility_tol = settings.relative_complementarity_tol = tolerance


def solve_admm(
    problem: signorini.ContactProblem, law: LawName = "ncp", tolerance: float = 1e-6, max_iterations: int = 20000
) -> PeerSolution:
    """Its ADMM: spectral rule, lanczos_size 20 (a full Lanczos, the default, can take seconds), its own tolerances at
    the one asked for, everything else at its default; on the dense or the sparse operator, by density.

    seconds is the call of solve alone, factorisations included; the operator and the solver are built before.
    """
    check_input(problem, law, tolerance, max_iterations)
    version()
    import pinocchio as pin

    matrix = system_matrix(problem)
    dense = problem.size <= 90 or matrix.nnz > 0.5 * problem.size**2
    models, data = _constraints(problem)
    settings = pin.ADMMSolverSettings()
    settings.admm_update_rule = pin.ADMMUpdateRule.SPECTRAL
    settings.lanczos_size = min(20, problem.size)
    settings.max_iterations = max_iterations
    settings.solve_ncp = law == "ncp"
    _tolerances(settings, tolerance)
    operator = pin.DelassusOperatorDense(matrix.toarray()) if dense else pin.DelassusOperatorSparse(matrix)
    solver = pin.ADMMConstraintSolver(problem.size)
    result = pin.ADMMSolverResult()
    start = time.perf_counter()
    try:
        solver.solve(operator, np.asarray(problem.free_velocity), models, data, settings, result)
    except Exception as error:
        return _failed("pinocchio-admm", problem, law, tolerance, error, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    return judged(
        "pinocchio-admm",
        problem,
        np.array(result.retrieveConstraintImpulses()),
        law,
        tolerance,
        claimed=bool(result.converged),
        iterations=int(result.iterations),
        seconds=seconds,
        limited=int(result.iterations) >= max_iterations,
        factorizations=int(result.delassus_decomposition_update_count),
        note="dense operator" if dense else "sparse operator",
    )


def solve_pgs(
    problem: signorini.ContactProblem, law: LawName = "ncp", tolerance: float = 1e-6, max_iterations: int = 20000
) -> PeerSolution:
    """Its projected Gauss-Seidel, on the dense operator (it takes no sparse one), over-relaxation 1 as is its default.

    Its absolute and relative tolerances are a hundredth of the one asked for: at 1e-6 it has claimed success with
    relative certificates above 1e-2. Where friction is 0 it claims success at once, with the impulse it started from.
    """
    check_input(problem, law, tolerance, max_iterations)
    if law != "ncp":
        raise signorini.InvalidInputError('law: Pinocchio 4.1 solves the "ncp" by PGS whatever it is told')
    version()
    import pinocchio as pin

    models, data = _constraints(problem)
    settings = pin.PGSSolverSettings()
    settings.max_iterations = max_iterations
    _tolerances(settings, 0.01 * tolerance)
    operator = pin.DelassusOperatorDense(system_matrix(problem).toarray())
    solver = pin.PGSConstraintSolver(problem.size)
    result = pin.PGSSolverResult()
    start = time.perf_counter()
    try:
        solver.solve(operator, np.asarray(problem.free_velocity), models, data, settings, result)
    except Exception as error:
        return _failed("pinocchio-pgs", problem, law, tolerance, error, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    return judged(
        "pinocchio-pgs",
        problem,
        np.array(result.retrieveConstraintImpulses()),
        law,
        tolerance,
        claimed=bool(result.converged),
        iterations=int(result.iterations),
        seconds=seconds,
        limited=int(result.iterations) >= max_iterations,
        note="dense operator",
    )


def _failed(
    peer: str, problem: signorini.ContactProblem, law: LawName, tolerance: float, error: Exception, seconds: float
) -> PeerSolution:
    return judged(
        peer,
        problem,
        np.zeros(problem.size),
        law,
        tolerance,
        claimed=False,
        iterations=0,
        seconds=seconds,
        limited=False,
        note=f"raised {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}",
    )
