"""SCS (O'Donoghue): the operator-splitting cone solver that the paper compares with (on the CCP)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

import signorini
from signorini._solve import LawName
from signorini.peers._common import Array, ConeProgram, PeerSolution, PeerUnavailableError
from signorini.peers._fixed_point import solve_by_cone_programs

NAME = "scs"


def version() -> str:
    """The version installed. Raises PeerUnavailableError without the package."""
    try:
        import scs
    except ImportError as error:
        raise PeerUnavailableError("scs is not installed: pip install signorini[peers]") from error
    return str(scs.__version__)


def solve(
    problem: signorini.ContactProblem, law: LawName = "ncp", tolerance: float = 1e-6, max_iterations: int = 20000
) -> PeerSolution:
    """The CCP by one cone program, the NCP by a fixed point on the De Saxce shift.

    Settings: its defaults (Anderson acceleration, adaptive scale, direct sparse LDL), absolute and relative tolerances
    a tenth of the one asked for; each outer iteration starts where the last one ended.
    """
    version()
    import scs

    def factory(program: ConeProgram):  # type: ignore[no-untyped-def]
        cone = {"z": program.num_zero, "l": program.num_nonnegative, "q": [3] * program.num_second_order}
        tight = max(0.1 * tolerance, 1e-13)
        data = {
            "P": sp.triu(program.p, format="csc"),
            "A": program.a,
            "b": np.zeros(program.a.shape[0]),
            "c": program.c,
        }
        solver = scs.SCS(data, cone, eps_abs=tight, eps_rel=tight, max_iters=max_iterations, verbose=False)
        first = True

        def once(c: Array) -> tuple[Array, int, bool]:
            nonlocal first
            if not first:
                solver.update(c=c)
            solution = solver.solve(warm_start=not first)
            first = False
            return np.array(solution["x"]), int(solution["info"]["iter"]), solution["info"]["status"] == "solved"

        return once

    return solve_by_cone_programs(NAME, problem, law, tolerance, max_iterations, factory)
