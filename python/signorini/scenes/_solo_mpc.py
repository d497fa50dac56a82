"""Model-predictive control of contact forces: a legged robot as one rigid body, planned by a quadratic program.

After the convex MPC of Di Carlo, Wensing, Katz, Bledt and Kim (IROS 2018), linearised about a reference of any slope
and about forces that carry the weight; docs/walking.md has the equations (W1) to (W4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
NUM_STATES = 12  # phi, e, w, v


def skew(a: Array) -> Array:
    """Matrices of the cross product, (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*a.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = a[..., 0], a[..., 1], a[..., 2]
    return out - np.swapaxes(out, -1, -2)


def rotation_vector(rotation: Array) -> Array:
    """Axis times angle of a rotation of less than half a turn, (3, 3) -> (3,)."""
    sine = 0.5 * np.array([rotation[2, 1], rotation[0, 2], rotation[1, 0]])
    sine -= 0.5 * np.array([rotation[1, 2], rotation[2, 0], rotation[0, 1]])
    length = math.sqrt(sine @ sine)
    angle = math.atan2(length, 0.5 * (float(np.trace(rotation)) - 1.0))
    return sine * (angle / length if length > 1e-12 else 1.0)


@dataclass(frozen=True)
class Body:
    """The robot as one rigid body: mass [kg]; inertia (3, 3): about its centre of mass, world axes [kg m^2]; gravity
    (3,) [m/s^2]."""

    mass: float
    inertia: Array
    gravity: Array

    def dynamics(self, levers: Array, reference_velocity: Array, dt: float) -> tuple[Array, Array, Array]:
        """(W1) over dt under constant forces, exactly: x+ = A x + B_k f + c (W2).

        levers: (steps, feet, 3) [m]; reference_velocity: (3,) of the centre of mass. A: (12, 12); B: (steps, 12,
        3 feet); c: (12,).
        """
        inverse = np.linalg.inv(self.inertia)
        rate = np.zeros((NUM_STATES, NUM_STATES))
        rate[0:3, 6:9] = rate[3:6, 9:12] = np.eye(3)
        rate[6:9, 3:6] = inverse @ skew(-self.mass * self.gravity)
        steps, feet, _ = levers.shape
        push = np.zeros((steps, NUM_STATES, feet, 3))
        push[:, 6:9] = (inverse @ skew(levers)).transpose(0, 2, 1, 3)
        push[:, 9:12] = (np.eye(3) / self.mass)[:, None, :]
        drift = np.zeros(NUM_STATES)
        drift[3:6], drift[9:12] = -reference_velocity, self.gravity
        square = rate @ rate
        held = np.eye(NUM_STATES) + dt / 2 * rate + dt**2 / 6 * square + dt**3 / 24 * square @ rate
        return (
            np.eye(NUM_STATES) + dt * rate @ held,
            dt * held @ push.reshape(steps, NUM_STATES, 3 * feet),
            dt * held @ drift,
        )


@dataclass(frozen=True)
class Limits:
    """Of one force (W3). friction: |f_t1|, |f_t2| <= friction f_n. lowest, highest: f_n [N]."""

    friction: float
    lowest: float
    highest: float

    def rows(self, normal: Array) -> tuple[Array, Array, Array]:
        """(5, 3) matrix and bounds of one force; normal: (3,) of the ground."""
        t1 = np.cross([0.0, 1.0, 0.0], normal)
        t1 /= np.linalg.norm(t1)
        t2 = np.cross(normal, t1)
        cone = self.friction * normal
        rows = np.stack([cone - t1, cone + t1, cone - t2, cone + t2, normal])
        return rows, np.array([0, 0, 0, 0, self.lowest]), np.array([1e20, 1e20, 1e20, 1e20, self.highest])


@dataclass(frozen=True)
class Plan:
    """forces: (steps, feet, 3) [N], zero in the air. solved: as the QP solver says; residual: largest violation of the
    QP's optimality conditions."""

    forces: Array
    solved: bool
    residual: float


@dataclass(frozen=True)
class ForcePlanner:
    """The quadratic program (W4): state eliminated, forces of the feet on the ground as unknowns.

    dt: of one step of a plan [s]. state_weights: (12,), of deviations from the reference; force_weight: of those from
    an equal share of the weight [1/N^2]. tolerance: on the QP's optimality conditions.
    """

    dt: float
    state_weights: Array
    force_weight: float
    limits: Limits
    tolerance: float = 1e-6

    def plan(
        self,
        body: Body,
        state: Array,
        levers: Array,
        contact: npt.NDArray[np.bool_],
        normal: Array,
        reference_velocity: Array,
    ) -> Plan:
        """state: (12,) now; levers: (steps, feet, 3), feet from the reference of the centre of mass [m]; contact:
        (steps, feet), who stands; normal: (3,) of the ground; reference_velocity: (3,) of the centre of mass [m/s]."""
        steps, feet = contact.shape
        A, B, c = body.dynamics(levers, reference_velocity, self.dt)
        used = np.repeat(contact.ravel(), 3)  # of all (step, foot, axis)
        size = int(used.sum())
        share = np.zeros((steps, feet, 3))
        share[contact] = -body.mass * body.gravity
        share /= np.maximum(contact.sum(axis=1), 1)[:, None, None]
        wanted = np.zeros(NUM_STATES)
        wanted[9:12] = reference_velocity
        # x_k = x + E f of the forces so far. Products stay small: threads of a BLAS would cost more than they bring.
        x, E = state, np.zeros((NUM_STATES, size))
        H = self.force_weight * np.eye(size)
        h = -self.force_weight * share.ravel()[used]
        done = 0
        for k in range(steps):
            mine = B[k][:, np.repeat(contact[k], 3)]
            x = A @ x + c
            E[:, :done] = A @ E[:, :done]
            E[:, done : done + mine.shape[1]] = mine
            done += mine.shape[1]
            weighted = self.state_weights * E[:, :done].T
            H[:done, :done] += weighted @ E[:, :done]
            h[:done] += weighted @ (x - wanted)
        rows, lower, upper = self.limits.rows(normal)
        C = np.kron(np.eye(size // 3), rows).astype(np.float64)
        result = _solve(H, h, C, np.tile(lower, size // 3), np.tile(upper, size // 3), self.tolerance)
        forces = np.zeros((steps, feet, 3))
        forces[contact] = np.round(result.x, 6).reshape(-1, 3)  # its last bits are not the same in every run
        info = result.info
        return Plan(forces, info.status.name == "PROXQP_SOLVED", float(max(info.pri_res, info.dua_res)))


def _solve(H: Array, h: Array, C: Array, lower: Array, upper: Array, tolerance: float) -> Any:
    try:
        from proxsuite import proxqp
    except ImportError as error:
        raise ImportError("the quadratic programs are solved by proxsuite: pip install 'signorini[control]'") from error
    qp = proxqp.dense.QP(len(h), 0, len(C))
    qp.settings.eps_abs = tolerance
    qp.init(H, h, None, None, C, lower, upper)
    qp.solve()
    return qp.results
