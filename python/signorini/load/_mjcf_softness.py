"""MuJoCo's solref and solimp as springs and dampers in physical units. The rule: docs/robot_files.md."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from signorini.load._options import Compliance

SOLREF, SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)  # MuJoCo's defaults
_GRAVITY = 9.81  # [m/s^2]


class Spring(NamedTuple):
    """[N/m, N m/rad] and [N s/m, N m s/rad]."""

    stiffness: float
    damping: float


RIGID = Spring(math.inf, 0.0)


def is_default(solref: npt.ArrayLike, solimp: npt.ArrayLike) -> bool:
    return bool(np.allclose(solref, SOLREF) and np.allclose(solimp, SOLIMP))


def impedance(solimp: npt.ArrayLike, distance: float) -> float:
    """MuJoCo's d(r): from solimp[0] at r = 0 to solimp[1] at r = solimp[2] and beyond; their mean for no width."""
    low, high, width, middle, power = (float(x) for x in np.asarray(solimp, dtype=np.float64))
    low, high, middle = (min(max(x, 1e-4), 1.0 - 1e-4) for x in (low, high, middle))
    if width <= 1e-15:
        return 0.5 * (low + high)
    share: float
    power = max(power, 1.0)
    x = min(abs(distance) / width, 1.0)
    if x <= middle:
        share = x**power / middle ** (power - 1.0)
    else:
        share = 1.0 - (1.0 - x) ** power / (1.0 - middle) ** (power - 1.0)
    return low + share * (high - low)


def spring(solref: npt.ArrayLike, solimp: npt.ArrayLike, inverse_inertia: float, compliance: Compliance) -> Spring:
    """The spring that gives way under its own weight as far as MuJoCo's constraint does, damped in the same ratio.

    MuJoCo's constraint moves with acceleration (1 - d) a - d (b v + d k r), a being that without it: at rest under
    gravity r = (1 - d) g / (d^2 k). inverse_inertia [1/kg]: of what it holds, MuJoCo's invweight0; 0: rigid.
    """
    time, ratio = (float(x) for x in np.asarray(solref, dtype=np.float64))
    if (time > 0.0) != (ratio > 0.0):
        time, ratio = SOLREF  # neither of MuJoCo's two formats: it takes its default then
    if compliance == "rigid" or inverse_inertia <= 0.0 or (compliance == "file" and is_default((time, ratio), solimp)):
        return RIGID
    high = min(max(float(np.asarray(solimp)[1]), 1e-4), 1.0 - 1e-4)
    if time > 0.0:
        time, ratio = max(time, 1e-12), max(ratio, 1e-12)
        k, b = 1.0 / (high * time * ratio) ** 2, 2.0 / (high * time)
    else:
        k, b = -time / high**2, -ratio / high
    if not k > 0.0:
        return RIGID
    low, up = 0.0, _GRAVITY / k * 1e8  # r k d^2 / (1 - d) grows with r
    for _ in range(200):
        middle = 0.5 * (low + up)
        d = impedance(solimp, middle)
        if middle * k * d**2 / (1.0 - d) < _GRAVITY:
            low = middle
        else:
            up = middle
    d = impedance(solimp, up)
    found = Spring(k * d**2 / (1.0 - d) / inverse_inertia, b * d / math.sqrt(1.0 - d) / inverse_inertia)
    return found if max(found) <= 1e15 else RIGID
