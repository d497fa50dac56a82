"""The NCP by a solver of convex cone programs: the De Saxce shift is held, the program solved, the shift renewed."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import signorini
from signorini._solve import LawName
from signorini.peers._common import (
    Array,
    ConeProgram,
    PeerSolution,
    check_input,
    de_saxce_correction,
    judged,
    system_matrix,
)

MAX_OUTER_ITERATIONS = 200
PATIENCE = 30  # outer iterations without a certificate a tenth better: the fixed point is going round

#: ConeProgram -> (solve: c -> (x, iterations, claimed)), built once a problem.
Factory = Callable[[ConeProgram], Callable[[Array], tuple[Array, int, bool]]]


def solve_by_cone_programs(
    peer: str,
    problem: signorini.ContactProblem,
    law: LawName,
    tolerance: float,
    max_iterations: int,
    factory: Factory,
) -> PeerSolution:
    """One program for the CCP; for the NCP one after the other with s = Gamma(sigma) of the last answer.

    At most MAX_OUTER_ITERATIONS of them and max_iterations in all, until the certificate holds or PATIENCE runs out.
    The best impulse seen is returned.
    """
    check_input(problem, law, tolerance, max_iterations)
    matrix = system_matrix(problem)
    program = ConeProgram.of(problem, matrix)
    start = time.perf_counter()
    solve = factory(program)
    seconds = time.perf_counter() - start

    best = np.zeros(problem.size)
    least = np.inf
    claimed, iterations, outer = False, 0, 0
    milestone, since = np.inf, 0
    shift = np.zeros(problem.size)
    while outer < (MAX_OUTER_ITERATIONS if law == "ncp" else 1) and iterations < max_iterations:
        start = time.perf_counter()
        x, count, claimed = solve(program.linear(problem.free_velocity + shift))
        seconds += time.perf_counter() - start
        outer += 1
        iterations += count
        if not np.all(np.isfinite(x)):
            break
        impulse = program.impulse(x, np.asarray(problem.friction))
        certificate = signorini.residual(problem, impulse, law)
        solved = certificate.solves(tolerance)
        if solved or certificate.relative < least:
            best, least = impulse, certificate.relative
        since += 1
        if least < 0.9 * milestone:
            milestone, since = least, 0
        if solved or since >= PATIENCE:
            break
        shift = de_saxce_correction(problem, matrix, impulse)
    return judged(
        peer,
        problem,
        best,
        law,
        tolerance,
        claimed=claimed,
        iterations=iterations,
        seconds=seconds,
        limited=iterations >= max_iterations or (law == "ncp" and outer >= MAX_OUTER_ITERATIONS),
        outer_iterations=outer,
        note=f"{outer} cone programs" if law == "ncp" else "",
    )
