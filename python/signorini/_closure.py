"""Equalities of a world as equations of q: how far they are from holding, and the next configuration where they do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from signorini import _simulator
from signorini._core import InvalidInputError

if TYPE_CHECKING:
    from signorini._world import World

Array = NDArray[np.float64]
_ROWS = {"connect": 3, "weld": 6, "coupling": 1}
_MAX_STEPS = 200
_CLOSED = 1e-13  # rounding, of configurations of about 1 m


def gaps(world: World, q: Array) -> Array:
    """(rows,): 3 of a connect [m], 6 of a weld [m, rad], along the axes of the frame on body a; 1 of a coupling; in the
    order of world.constraints."""
    return np.concatenate([np.zeros(0), *(_gap(world, c, q) for c in world.constraints)])


def closed(world: World, q: Array, tolerance: float) -> Array:
    """Damped Gauss-Newton steps within the joint limits; free joints stay."""
    from scipy.optimize import lsq_linear

    lower, upper = np.full(world.num_v, -np.inf), np.full(world.num_v, np.inf)
    moves = np.ones(world.num_v, dtype=bool)
    at = np.array(q)
    limited = [(joint.q_index, joint.v_index) for joint in world.joints if joint.num_q == 1]
    for joint in world.joints:
        if joint.num_q == 1:
            at[joint.q_index] = np.clip(at[joint.q_index], joint.lower, joint.upper)
            lower[joint.v_index], upper[joint.v_index] = joint.lower, joint.upper
            moves[joint.v_index] = joint.lower < joint.upper
        elif joint.num_q == 7:
            moves[joint.v_index : joint.v_index + 6] = False
    gap = gaps(world, at)
    for _ in range(_MAX_STEPS):
        size = np.abs(gap).max(initial=0.0)
        if size <= _CLOSED or not moves.any():
            break
        values = np.zeros(world.num_v)
        for position, velocity in limited:
            values[velocity] = at[position]
        jacobian = _jacobian(world, at)[:, moves]
        damping = min(1e-3, size) * np.abs(jacobian).max(initial=1e-12)  # vanishes with the gap: quadratic at the end
        matrix = np.vstack([jacobian, damping * np.eye(jacobian.shape[1])])
        wanted = np.concatenate([-gap, np.zeros(jacobian.shape[1])])
        bounds = (np.minimum(lower - values, 0.0)[moves], np.maximum(upper - values, 0.0)[moves])
        step = np.zeros(world.num_v)
        step[moves] = lsq_linear(matrix, wanted, bounds, method="bvls").x
        step *= min(1.0, 0.5 / np.abs(step).max(initial=1e-12))  # [rad, m]; the equations are not linear farther off
        for _ in range(30):
            trial = world.integrate(at, step, 1.0)
            trial_gap = gaps(world, trial)
            if trial_gap @ trial_gap < gap @ gap:
                break
            step *= 0.5
        else:
            break
        at, gap = trial, trial_gap
    if np.abs(gap).max(initial=0.0) > tolerance:
        first = np.cumsum([0, *(_ROWS[c.type.name] for c in world.constraints)])
        worst = world.constraints[int(np.searchsorted(first, np.argmax(np.abs(gap)), "right")) - 1]
        raise InvalidInputError(
            f"q: no configuration near it has its loops closed within the limits of its joints; nearest: constraint "
            f"{worst.name!r} is open by {np.abs(gap).max():.3g}"
        )
    return at


def _ends(world: World, constraint: Any, q: Array) -> list[tuple[Array, Array]]:
    """Position and rotation in the world of the frame on each body."""
    result = []
    for body, placement in (
        (constraint.body_a, constraint.placement_a),
        (constraint.body_b, constraint.placement_b),
    ):
        position, rotation = world.body_placement(world.body_names[body], q)
        result.append((rotation @ placement.translation + position, rotation @ placement.rotation))
    return result


def _gap(world: World, constraint: Any, q: Array) -> Array:
    kind = _simulator.ConstraintType
    if constraint.type == kind.coupling:
        target = constraint.coefficients[0]
        if constraint.joint_a >= 0:
            x = q[world.joints[constraint.joint_a].q_index] - constraint.reference_a
            target = float(np.polynomial.polynomial.polyval(x, constraint.coefficients))
        return np.array([q[world.joints[constraint.joint_b].q_index] - constraint.reference_b - target])
    (position_a, rotation_a), (position_b, rotation_b) = _ends(world, constraint, q)
    apart = rotation_a.T @ (position_b - position_a)
    if constraint.type == kind.connect:
        return np.asarray(apart)
    return np.concatenate([apart, _vector(rotation_a.T @ rotation_b)])


def _jacobian(world: World, q: Array) -> Array:
    """(rows, num_v) of the gaps, for turns of welds to first order in the gap."""
    blocks = [np.zeros((0, world.num_v))]
    for constraint in world.constraints:
        kind = constraint.type.name
        if kind == "coupling":
            row = np.zeros((1, world.num_v))
            row[0, world.joints[constraint.joint_b].v_index] = 1.0
            if constraint.joint_a >= 0:
                driver = world.joints[constraint.joint_a]
                slope = np.polynomial.polynomial.polyder(constraint.coefficients)
                x = q[driver.q_index] - constraint.reference_a
                row[0, driver.v_index] -= np.polynomial.polynomial.polyval(x, slope)
            blocks.append(row)
            continue
        (position_a, rotation_a), (position_b, _) = _ends(world, constraint, q)
        a = world.jacobian(q, world.body_names[constraint.body_a], constraint.placement_a.translation)
        b = world.jacobian(q, world.body_names[constraint.body_b], constraint.placement_b.translation)
        turning = np.cross(position_b - position_a, a[3:], axisb=0, axisc=0)  # of the axes
        rows = [rotation_a.T @ (b[:3] - a[:3] + turning), rotation_a.T @ (b[3:] - a[3:])]
        blocks.append(np.concatenate(rows)[: _ROWS[kind]])
    return np.concatenate(blocks)


def _vector(rotation: Array) -> Array:
    """The rotation vector of a rotation."""
    axis = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine, cosine = float(np.linalg.norm(axis)), 0.5 * (float(np.trace(rotation)) - 1.0)
    if sine < 1e-9:
        if cosine > 0.0:
            return axis
        values, vectors = np.linalg.eigh(0.5 * (rotation + rotation.T))
        return np.asarray(np.pi * vectors[:, int(np.argmax(values))])
    return np.asarray(axis * (np.arctan2(sine, cosine) / sine))
