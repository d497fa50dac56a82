"""The hardest steps of a run, kept as FCLIB files: problems for the experiments, and for other solvers."""

from __future__ import annotations

import heapq
from pathlib import Path

import numpy as np

from signorini import fclib
from signorini._problem import ContactProblem, Equality, FrictionCone, HalfLine
from signorini._simulation import Simulator, Trace


class Hardest:
    """Keeps the problems of the `count` steps that cost the most factorisations.

    Simulate in blocks, with watch() before and add() after each. A step is repeated to get at its problem; that changes
    nothing, since save() and restore() go on bit for bit.
    """

    def __init__(self, simulator: Simulator, count: int = 10) -> None:
        self._simulator = simulator
        self._count = count
        self._kept: list[tuple[int, int, ContactProblem]] = []  # factorisations, -step, problem: a heap
        self._before = b""
        self._first = 0

    def watch(self) -> None:
        """Before a block of steps."""
        self._before = self._simulator.save()

    def add(self, trace: Trace) -> None:
        """After it."""
        wanted = []
        for k, cost in enumerate(np.asarray(trace.factorizations).tolist()):
            if len(self._kept) < self._count or cost > self._kept[0][0]:
                wanted.append((cost, k))
        wanted = sorted(sorted(wanted, key=lambda item: (-item[0], item[1]))[: self._count], key=lambda item: item[1])
        if wanted:
            after = self._simulator.save()
            self._simulator.restore(self._before)
            done = 0
            for cost, k in wanted:
                self._simulator.run(k + 1 - done, None if trace.controls is None else trace.controls[done : k + 1])
                done = k + 1
                entry = (cost, -(self._first + k), self._simulator.contact_problem())
                (heapq.heappush if len(self._kept) < self._count else heapq.heappushpop)(self._kept, entry)
            self._simulator.restore(after)
        self._first += len(trace.factorizations)

    def write(self, folder: Path, scene: str) -> tuple[list[Path], int]:
        """Files folder/SCENE-STEP.hdf5, hardest first, and how many of the steps have joint friction or drives' limits
        (intervals), which such a file cannot hold."""
        files, left_out = [], 0
        for cost, minus_step, problem in sorted(self._kept, key=lambda entry: (-entry[0], -entry[1])):
            contacts = as_contacts(problem)
            if contacts is None:
                left_out += 1
                continue
            path = folder / f"{Path(scene).stem}-{-minus_step:06d}.hdf5"
            title = path.stem.encode(errors="backslashreplace").decode()
            said = f"{cost} factorisations, starting from the step before"
            fclib.write(path, contacts, title=title, description=said)
            files.append(path)
        return files, left_out


def as_contacts(problem: ContactProblem, *, drop_intervals: bool = False) -> ContactProblem | None:
    """The same problem with friction cones and then equalities only, as FCLIB has it; None if it has intervals.

    A half line becomes the normal of a contact without friction, whose tangents nothing moves. drop_intervals: leave
    intervals out instead: joints without friction and drives without limits.
    """
    import scipy.sparse as sp

    cones: list[tuple[int, float, bool]] = []  # first row, friction, all three rows
    equalities: list[int] = []
    row = 0
    for constraint in problem.constraints:
        if isinstance(constraint, FrictionCone):
            cones.append((row, constraint.friction, True))
            row += 3
            continue
        if isinstance(constraint, HalfLine):
            cones.append((row, 0.0, False))
        elif isinstance(constraint, Equality):
            equalities.append(row)
        elif not drop_intervals:
            return None
        row += 1
    place = np.full(3 * len(cones) + len(equalities), -1)  # row of the given problem, for each new one
    for i, (first, _, whole) in enumerate(cones):
        place[3 * i + 2] = first + 2 if whole else first
        if whole:
            place[3 * i : 3 * i + 2] = first, first + 1
    place[3 * len(cones) :] = equalities
    there = np.flatnonzero(place >= 0)
    spread = sp.csc_array((np.ones(len(there)), (there, place[there])), shape=(len(place), problem.size))
    return ContactProblem(
        spread @ sp.csc_array(problem.delassus) @ spread.T,
        spread @ problem.free_velocity,
        compliance=spread @ problem.compliance,
        constraints=[FrictionCone(friction) for _, friction, _ in cones] + [Equality()] * len(equalities),
        name=problem.name,
        check=False,
    )
