"""Frictional contact problems, solved and certified.

    problem = signorini.ContactProblem(delassus, free_velocity, friction)
    solution = signorini.solve(problem)
    solution.impulse, solution.residual.relative

`signorini.fclib` reads and writes FCLIB files. Units are SI: impulses in N s, velocities in m/s.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from signorini._core import InvalidInputError, Workspace, __version__
from signorini._problem import ContactProblem, Equality, FrictionCone, HalfLine, Interval
from signorini._solution import Residual, Solution
from signorini._solve import residual, solve

if TYPE_CHECKING:
    from signorini import fclib as fclib

__all__ = [
    "ContactProblem",
    "Equality",
    "FrictionCone",
    "HalfLine",
    "Interval",
    "InvalidInputError",
    "Residual",
    "Solution",
    "Workspace",
    "__version__",
    "fclib",
    "residual",
    "solve",
]

_SUBMODULES = ("experiments", "fclib", "peers", "scenes")


def __getattr__(name: str) -> Any:
    # Loaded at first use: they need h5py, scipy or more, and `import signorini` should take no time.
    if name in _SUBMODULES:
        return importlib.import_module(f"signorini.{name}")
    raise AttributeError(f"module 'signorini' has no attribute {name!r}")
