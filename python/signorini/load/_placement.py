"""Rotations and placements as the readers need them; quaternions are (x, y, z, w)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Placement(NamedTuple):
    """x -> rotation x + position."""

    rotation: Array
    position: Array

    def __matmul__(self, other: Placement) -> Placement:
        return Placement(self.rotation @ other.rotation, self.rotation @ other.position + self.position)

    def inverse(self) -> Placement:
        return Placement(self.rotation.T, -self.rotation.T @ self.position)


def identity() -> Placement:
    return Placement(np.eye(3), np.zeros(3))


def from_roll_pitch_yaw(angles: npt.ArrayLike) -> Array:
    """R_z(yaw) R_y(pitch) R_x(roll), as URDF has it [rad]."""
    (r, p, y), sin, cos = np.asarray(angles, dtype=np.float64), np.sin, np.cos
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos(r), -sin(r)], [0.0, sin(r), cos(r)]])
    about_y = np.array([[cos(p), 0.0, sin(p)], [0.0, 1.0, 0.0], [-sin(p), 0.0, cos(p)]])
    about_z = np.array([[cos(y), -sin(y), 0.0], [sin(y), cos(y), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def from_quaternion(quaternion: npt.ArrayLike) -> Array:
    """The rotation of a unit quaternion (x, y, z, w)."""
    x, y, z, w = np.asarray(quaternion, dtype=np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def basis(normal: npt.ArrayLike) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed frame (a, b, normal); x and y for the normal z."""
    n = np.asarray(normal, dtype=np.float64)
    n = n / np.linalg.norm(n)
    axis = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    a = axis - n * (axis @ n)
    a /= np.linalg.norm(a)
    return a, np.cross(n, a)


def about(point: Array, axis: Array, angle: float) -> Placement:
    """The turn by an angle [rad] about the line through a point along a unit vector."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return Placement(rotation, point - rotation @ point)
