"""Clarabel (Goulart and Chen): an interior-point solver of convex cone programs with quadratic objectives."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

import signorini
from signorini._solve import LawName
from signorini.peers._common import Array, ConeProgram, PeerSolution, PeerUnavailableError
from signorini.peers._fixed_point import solve_by_cone_programs

NAME = "clarabel"


def version() -> str:
    """The version installed. Raises PeerUnavailableError without the package."""
    try:
        import clarabel
    except ImportError as error:
        raise PeerUnavailableError("clarabel is not installed: pip install 'signorini[peers]'") from error
    return str(clarabel.__version__)


def solve(
    problem: signorini.ContactProblem, law: LawName = "ncp", tolerance: float = 1e-6, max_iterations: int = 20000
) -> PeerSolution:
    """The CCP by one cone program, the NCP by a fixed point on the De Saxce shift.

    Settings: gap and feasibility tolerances a ten-thousandth of the one asked for (1e-13 at least; at a tenth its
    answers miss our certificate), direct LDL factorisation by its own code on one thread, at most 200 iterations a
    program. Nothing is warm-started: Clarabel cannot.
    """
    version()
    import clarabel

    def factory(program: ConeProgram):  # type: ignore[no-untyped-def]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = min(200, max_iterations)
        settings.max_threads = 1
        settings.direct_solve_method = "qdldl"
        settings.presolve_enable = False  # so that the right-hand side may change
        tight = max(1e-4 * tolerance, 1e-13)
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tight
        cones = []
        if program.num_zero:
            cones.append(clarabel.ZeroConeT(program.num_zero))
        if program.num_nonnegative:
            cones.append(clarabel.NonnegativeConeT(program.num_nonnegative))
        cones.extend(clarabel.SecondOrderConeT(3) for _ in range(program.num_second_order))
        upper = sp.triu(program.p, format="csc")
        solver = clarabel.DefaultSolver(upper, program.c, program.a, np.zeros(program.a.shape[0]), cones, settings)

        def once(c: Array) -> tuple[Array, int, bool]:
            solver.update(q=c)
            solution = solver.solve()
            return np.array(solution.x), int(solution.iterations), str(solution.status) == "Solved"

        return once

    return solve_by_cone_programs(NAME, problem, law, tolerance, max_iterations, factory)
