"""Free rigid bodies and their contact points -> a contact problem in mass space.

Per body six velocities, the linear one of the centre of mass and the angular one, both in world axes [m/s, rad/s].
Per contact a frame (t1, t2, n) with n from body A to body B, and a velocity of B relative to A.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

import signorini
from signorini import _arrays

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

GRAVITY = 9.81  # m/s^2, along -z
WORLD = -1  # the body index of what does not move


def check_counts(lowest: int, **counts: Any) -> None:
    """Raises InvalidInputError for what is no integer or below lowest."""
    for name, value in counts.items():
        _arrays.count(name, value, lowest)


def check_positive(**values: Any) -> None:
    """Raises InvalidInputError for what is no number, not positive, or beyond all measure."""
    check_range(1e-15, 1e15, **values)


def check_finite(**values: Any) -> None:
    """Raises InvalidInputError for what is no number, or beyond all measure."""
    check_range(-1e15, 1e15, **values)


def check_range(lower: float, upper: float, **values: Any) -> None:
    """Raises InvalidInputError for what is no number or not within lower and upper."""
    for name, value in values.items():
        if not lower <= _arrays.number(name, value) <= upper:
            raise signorini.InvalidInputError(f"{name}: is {value}, must be in [{lower:g}, {upper:g}]")


@dataclass
class Bodies:
    """Free bodies at rest at their centres of mass.

    mass: (n,) [kg]. inertia: (n, 3, 3) about the centre, world axes [kg m^2]. position: (n, 3) [m].
    velocity: (n, 6) linear and angular, at the start of the step [m/s, rad/s].
    """

    mass: Array
    inertia: Array
    position: Array
    velocity: Array


@dataclass
class Contacts:
    """Contact points: body_a, body_b (nc,) with WORLD for the fixed one, point and normal (nc, 3), gap (nc,) [m]."""

    body_a: Indices
    body_b: Indices
    point: Array
    normal: Array
    gap: Array
    friction: Array
    frame: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))

    def __post_init__(self) -> None:
        if not len(self.frame):
            self.frame = frames(self.normal)


def frames(normal: Array) -> Array:
    """Right-handed frames (t1, t2, n) as the rows of (n, 3, 3), t1 as near the x axis as it can be."""
    axis = np.zeros_like(normal)
    steep = np.abs(normal[:, 0]) > 0.9
    axis[steep, 1] = 1.0
    axis[~steep, 0] = 1.0
    t1 = axis - (axis * normal).sum(1, keepdims=True) * normal
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    return np.stack([t1, np.cross(normal, t1), normal], axis=1)


def _cross_matrices(r: Array) -> Array:
    out = np.zeros((len(r), 3, 3))
    out[:, 0, 1], out[:, 0, 2] = -r[:, 2], r[:, 1]
    out[:, 1, 0], out[:, 1, 2] = r[:, 2], -r[:, 0]
    out[:, 2, 0], out[:, 2, 1] = -r[:, 1], r[:, 0]
    return out


def mass_matrix(bodies: Bodies) -> sp.csc_matrix:
    """Block diagonal M, 6n x 6n [kg, kg m^2]."""
    blocks = np.zeros((len(bodies.mass), 6, 6))
    blocks[:, range(3), range(3)] = bodies.mass[:, None]
    blocks[:, 3:, 3:] = bodies.inertia
    n = len(bodies.mass)
    full = sp.bsr_matrix((blocks, np.arange(n), np.arange(n + 1)), shape=(6 * n, 6 * n)).tocsc()
    full.eliminate_zeros()
    full.sort_indices()
    return full


def jacobian(bodies: Bodies, contacts: Contacts) -> sp.csc_matrix:
    """J, 3nc x 6n: the velocity of B relative to A in the contact frames."""
    nc, n = len(contacts.gap), len(bodies.mass)
    rows, cols, blocks = [], [], []
    for sign, index in ((-1.0, contacts.body_a), (1.0, contacts.body_b)):
        (k,) = np.nonzero(index != WORLD)
        arm = contacts.point[k] - bodies.position[index[k]]
        linear = sign * contacts.frame[k]
        rows.append(k)
        cols.append(index[k])
        blocks.append(np.concatenate([linear, -linear @ _cross_matrices(arm)], axis=2))
    row, col, block = np.concatenate(rows), np.concatenate(cols), np.concatenate(blocks)
    order = np.lexsort((col, row))
    row, col, block = row[order], col[order], block[order]
    pointer = np.searchsorted(row, np.arange(nc + 1))
    full = sp.bsr_matrix((block, col, pointer), shape=(3 * nc, 6 * n)).tocsc()
    full.eliminate_zeros()
    full.sort_indices()
    return full


def assemble(
    bodies: Bodies, contacts: Contacts, dt: float, name: str, baumgarte: float = 0.0
) -> signorini.ContactProblem:
    """One time step dt [s] under gravity: g = J v_f + gamma, v_f = v + dt gravity, gamma_N = gap/dt (>= 0), or
    baumgarte gap/dt in overlap."""
    free = bodies.velocity.copy()
    free[:, 2] -= dt * GRAVITY
    j = jacobian(bodies, contacts)
    g = j @ free.ravel()
    g[2::3] += np.where(contacts.gap >= 0.0, contacts.gap, baumgarte * contacts.gap) / dt
    return signorini.ContactProblem.from_mass(mass_matrix(bodies), j, g, contacts.friction, name=name, check=False)


def box_inertia(mass: Array, size: Array) -> Array:
    """Inertia tensors (n, 3, 3) of solid boxes, mass (n,) [kg], edge lengths (n, 3) [m]."""
    square = size**2
    out = np.zeros((len(mass), 3, 3))
    out[:, range(3), range(3)] = (mass / 12.0)[:, None] * (square.sum(1, keepdims=True) - square)
    return out
