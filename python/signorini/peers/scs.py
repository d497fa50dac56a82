"""SCS (O'Donoghue): the operator-splitting cone solver that the paper compares with (on the CCP)."""

from __future__ import annotations

import time

import numpy as np
import scipy.sparse as sp

import signorini
from signorini._problem import FrictionCone, HalfLine, Interval, check_problem
from signorini._solve import LawName
from signorini.peers._common import Array, ConeProgram, PeerSolution, PeerUnavailableError, check_limits, judged
from signorini.peers._fixed_point import solve_by_cone_programs

NAME = "scs"


def version() -> str:
    """The version installed. Raises PeerUnavailableError without the package."""
    try:
        import scs
    except ImportError as error:
        raise PeerUnavailableError("scs is not installed: pip install 'signorini[peers]'") from error
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


def solve_ccp(
    problem: signorini.ContactProblem, tolerance: float, max_iterations: int, guess: Array | None = None
) -> PeerSolution:
    """The CCP of a problem with any constraints, joint limits, joint friction and equalities too, in one cone program.

    guess: an impulse [N s], (n,), where x, y and s of SCS start: y from the velocity at that impulse. Settings: its
    defaults, and the tolerance asked for, absolute (in units in which G + R has a unit diagonal and g a unit size) and
    relative.
    """
    check_problem(problem)
    check_limits(tolerance, max_iterations)
    version()
    import scs

    matrix = sp.csc_matrix(problem.delassus) + sp.diags(np.asarray(problem.compliance))
    scale = 1.0 / np.sqrt(np.where(problem.scale > 0.0, problem.scale, 1.0))
    unit = float(np.abs(scale * problem.free_velocity).max(initial=0.0)) or 1.0
    p = (sp.diags(scale) @ matrix @ sp.diags(scale)).tocsc()
    c = scale * problem.free_velocity / unit
    cone, columns, values, bound, opposite = _cones(problem, scale, unit)
    a = sp.csc_matrix((values, (np.arange(len(columns)), columns)), shape=(len(columns), problem.size))
    data = {"P": sp.triu(p, format="csc"), "A": a, "b": bound, "c": c}
    start = {}
    if guess is not None:
        x = guess / scale / unit
        # A'y = -(P x + c); of the two sides of an interval the one that the velocity is against.
        y = -((p @ x + c)[columns]) / values
        y[opposite] = np.maximum(y[opposite], 0.0)
        start = {"x": x, "y": y, "s": bound - a @ x}
    began = time.perf_counter()
    solver = scs.SCS(data, cone, eps_abs=tolerance, eps_rel=tolerance, max_iters=max_iterations, verbose=False)
    found = solver.solve(warm_start=guess is not None, **start)
    seconds = time.perf_counter() - began
    impulse = problem.project(unit * scale * np.nan_to_num(np.array(found["x"])))
    info = found["info"]
    return judged(
        NAME,
        problem,
        impulse,
        "ccp",
        tolerance,
        claimed=info["status"] == "solved",
        iterations=int(info["iter"]),
        seconds=seconds,
        limited=int(info["iter"]) >= max_iterations,
    )


def _cones(
    problem: signorini.ContactProblem, scale: Array, unit: float
) -> tuple[dict[str, object], list[int], Array, Array, list[int]]:
    """SCS's cones, one entry of A a row (its column and value), b, and the rows that are sides of intervals."""
    zero: list[tuple[int, float, float]] = []  # column, value, bound
    sides: list[tuple[int, float, float]] = []
    nonnegative: list[tuple[int, float, float]] = []
    second_order: list[tuple[int, float, float]] = []
    row = 0
    for constraint in problem.constraints:
        if isinstance(constraint, FrictionCone):
            if constraint.friction > 0.0:
                steep = max(constraint.friction, 1.0)
                second_order.append((row + 2, -constraint.friction / steep, 0.0))
                second_order += [(row, -1.0 / steep, 0.0), (row + 1, -1.0 / steep, 0.0)]
            else:
                zero += [(row, -1.0, 0.0), (row + 1, -1.0, 0.0)]
                nonnegative.append((row + 2, -1.0, 0.0))
            row += 3
            continue
        if isinstance(constraint, HalfLine):
            nonnegative.append((row, -1.0, 0.0))
        elif isinstance(constraint, Interval):
            upper, lower = (float(bound / scale[row] / unit) for bound in (constraint.upper, constraint.lower))
            if np.isfinite(upper):
                sides.append((row, 1.0, upper))
            if np.isfinite(lower):
                sides.append((row, -1.0, -lower))
        row += 1  # an equality's impulse is free: no row
    rows = zero + sides + nonnegative + second_order
    cone: dict[str, object] = {"z": len(zero), "l": len(sides) + len(nonnegative), "q": [3] * (len(second_order) // 3)}
    opposite = list(range(len(zero), len(zero) + len(sides)))
    columns, values, bound = (list(each) for each in zip(*rows, strict=True)) if rows else ([], [], [])
    return cone, columns, np.array(values), np.array(bound), opposite
