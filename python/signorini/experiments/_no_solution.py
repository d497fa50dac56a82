"""Proof that a small contact problem has no solution, by branch and bound over the states of its contacts.

A contact is open, sticks, or slips with its velocity within a sector. What a state asks of impulse l and velocity
A l + b is linear but for cones and arcs; with these replaced by polyhedra around them, a linear program gives the least
velocity tau by which all states of a node are missed together. A node of more than BOUND is excluded; else the contact
farthest from the law is split, its sector halved. Letters as in docs/theory.md, section 5: A, b, l scaled, max |b| = 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.optimize import linprog
from scipy.sparse.csgraph import connected_components

import signorini

Array = npt.NDArray[np.float64]
BOUND = 1e-6  # of the free velocity
LARGEST = 1e8  # over the free velocity: a larger impulse counts as none, since numbers are only rounded
MOST_CONTACTS, MOST_NODES = 4, 600
SIDES = 8  # of the polygon around a disc of friction
NARROWEST = 1e-3  # rad


@dataclass(frozen=True)
class State:
    """What is known of a contact: "any", "open", "stick" or "slip", then with the sector of its velocity [rad]."""

    kind: str = "any"
    low: float = 0.0
    high: float = 0.0

    def split(self, against: float) -> tuple[State, ...]:
        """The cases it falls into; against: direction opposite to the impulse, which the first sector is around."""
        if self.kind == "slip":
            middle = 0.5 * (self.low + self.high)
            return State("slip", self.low, middle), State("slip", middle, self.high)
        third = 2.0 * np.pi / 3.0
        edges = [against + (k - 0.5) * third for k in range(4)]
        return State("open"), State("stick"), *(State("slip", *edges[k : k + 2]) for k in range(3))


def has_none(problem: signorini.ContactProblem, most_nodes: int = MOST_NODES) -> bool:
    """Whether it is proven that nothing solves the NCP. problem: friction cones only. False: nothing is claimed, as
    where a linear program fails."""
    delassus = np.asarray(problem.delassus.todense(), dtype=np.float64)
    scale = 1.0 / np.sqrt(np.asarray(problem.scale))
    b = scale * np.asarray(problem.free_velocity)
    b /= max(np.linalg.norm(b.reshape(-1, 3), axis=1).max(initial=0.0), 1e-300)
    a = scale[:, None] * (0.5 * (delassus + delassus.T) + np.diag(problem.compliance)) * scale
    friction = np.asarray(problem.friction)
    known: dict[tuple[int, State], Any] = {}
    nodes = [[State()] * len(friction)]
    for _ in range(most_nodes):
        if not nodes:
            return True
        states = nodes.pop()
        for i, state in enumerate(states):
            if (i, state) not in known:
                known[i, state] = _rows(a, b, friction[i], i, state)
        try:
            impulse = _nearest([known[i, state] for i, state in enumerate(states)])
        except ArithmeticError:
            return False
        if impulse is None:
            continue
        worst = _farthest(a, b, friction, impulse, states)
        if worst is None:
            return False
        against = np.arctan2(-impulse[3 * worst + 1], -impulse[3 * worst])
        nodes += [[*states[:worst], case, *states[worst + 1 :]] for case in reversed(states[worst].split(against))]
    return not nodes


def _rows(a: Array, b: Array, friction: float, i: int, state: State) -> tuple[Array, Array]:
    """Rows (of l, tau) and right-hand sides, row . (l, tau) <= right: what the state asks of contact i."""
    l_t1, l_t2, l_n = np.eye(len(b))[3 * i : 3 * i + 3]
    impulses, velocities = [-l_n], []  # <= 0; <= tau, as (row, offset)
    v = [(a[3 * i + k], b[3 * i + k]) for k in range(3)]

    def turned(angle: float) -> tuple[Array, tuple[Array, float]]:
        """The parts of impulse and velocity along a tangential direction."""
        c, s = np.cos(angle), np.sin(angle)
        return c * l_t1 + s * l_t2, (c * v[0][0] + s * v[1][0], c * v[0][1] + s * v[1][1])

    def not_above(row: tuple[Array, float], sign: float = 1.0) -> None:
        velocities.append((sign * row[0], sign * row[1]))

    not_above(v[2], -1.0)
    if state.kind == "open":
        impulses += [sign * row for row in (l_t1, l_t2, l_n) for sign in (1.0, -1.0)]
    elif state.kind == "slip":
        middle, half = 0.5 * (state.low + state.high), 0.5 * (state.high - state.low)
        not_above(v[2])
        impulses += [-turned(angle)[0] - friction * l_n for angle in (state.low, middle, state.high)]
        impulses.append(turned(middle)[0] + friction * np.cos(half) * l_n)  # the arc is beyond its chord
        for edge in (state.low - 0.5 * np.pi, state.high + 0.5 * np.pi):  # outwards
            along, speed = turned(edge)
            not_above(speed)
            impulses.append(-along)
    else:
        impulses += [turned(2.0 * np.pi * k / SIDES)[0] - friction * l_n for k in range(SIDES)]
        if state.kind == "stick":
            for row in v:
                not_above(row)
                not_above(row, -1.0)
    rows = [np.append(row, 0.0) for row in impulses] + [np.append(row, -1.0) for row, _ in velocities]
    return np.array(rows), np.array([0.0] * len(impulses) + [-offset for _, offset in velocities])


def _nearest(asked: list[tuple[Array, Array]]) -> Array | None:
    """The impulse that misses what is asked by the least; None if all up to LARGEST miss it by more than BOUND.
    Raises ArithmeticError where the linear program fails."""
    rows, right = np.vstack([one for one, _ in asked]), np.concatenate([one for _, one in asked])
    cost = np.zeros(rows.shape[1])
    cost[-1] = 1.0
    bounds = [(None, None)] * (len(cost) - 1) + [(0.0, None)]
    options = {"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}
    found = linprog(cost, rows, right, bounds=bounds, options=options)
    if found.status != 0:
        raise ArithmeticError(f"linear program: {found.message}")
    # By its multipliers, which hold whatever the program's own tolerances are.
    multipliers = np.minimum(found.ineqlin.marginals, 0.0)
    left = cost - rows.T @ multipliers
    if left[-1] >= -1e-12 and multipliers @ right - LARGEST * np.abs(left[:-1]).sum() > BOUND:
        return None
    return np.asarray(found.x[:-1], dtype=np.float64)


def _farthest(a: Array, b: Array, friction: Array, impulse: Array, states: list[State]) -> int | None:
    """The contact to split: farthest from complementarity; None when none can be."""
    velocity = (a @ impulse + b).reshape(-1, 3)
    velocity[:, 2] += friction * np.hypot(velocity[:, 0], velocity[:, 1])
    x = impulse.reshape(-1, 3)
    off = np.maximum(np.abs((x * velocity).sum(axis=1)), np.hypot(x[:, 0], x[:, 1]) - friction * x[:, 2])
    for i, state in enumerate(states):
        if state.kind in ("open", "stick") or (state.kind == "slip" and state.high - state.low < NARROWEST):
            off[i] = -1.0
    worst = int(np.argmax(off))
    return worst if off[worst] > 1e-9 else None


def islands(problem: signorini.ContactProblem) -> list[signorini.ContactProblem]:
    """The problem's independent parts, small ones first."""
    delassus = sp.coo_array(problem.delassus)
    delassus.eliminate_zeros()
    count = problem.num_contacts
    graph = sp.coo_array((np.ones(delassus.nnz), (delassus.row // 3, delassus.col // 3)), shape=(count, count))
    _, labels = connected_components(sp.csr_matrix(graph), directed=False)
    matrix = sp.csr_matrix(problem.delassus)
    parts = []
    for label in np.argsort(np.bincount(labels), kind="stable"):
        (members,) = np.nonzero(labels == label)
        rows = (3 * members[:, None] + np.arange(3)).ravel()
        parts.append(
            signorini.ContactProblem(
                matrix[rows][:, rows],
                np.asarray(problem.free_velocity)[rows],
                np.asarray(problem.friction)[members],
                np.asarray(problem.compliance)[rows],
            )
        )
    return parts


def proven(problem: signorini.ContactProblem, tolerance: float) -> bool:
    """Whether an island of at most MOST_CONTACTS contacts that `auto` does not solve is proven to have no solution."""
    for part in islands(problem):
        if part.num_contacts > MOST_CONTACTS:
            return False
        if not signorini.solve(part, tolerance=tolerance).solved and has_none(part):
            return True
    return False
