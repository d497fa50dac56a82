"""Robots and what they touch, simulated; every step's contact forces certified.

    world = signorini.load("robot.urdf", ground=True)
    simulator = signorini.Simulator(world)
    simulator.step()
    simulator.contacts, simulator.report.residual.relative

The contact problem behind a step stands alone too: `signorini.ContactProblem`, `signorini.solve`, and `signorini.fclib`
for files. Units are SI: impulses in N s, velocities in m/s.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from signorini._core import InvalidInputError, Workspace, __version__
from signorini._inverse import InverseSolution, inverse_contact, inverse_residual
from signorini._problem import ContactProblem, Equality, FrictionCone, HalfLine, Interval
from signorini._solution import Residual, Solution
from signorini._solve import residual, solve
from signorini.load import load

if TYPE_CHECKING:
    from signorini import fclib as fclib
    from signorini._inverse_dynamics import InverseDynamics, InverseDynamicsResult, inverse_dynamics
    from signorini._simulation import Simulator, SimulatorSettings, UnsolvedStepError, UnsolvedStepWarning, rollout
    from signorini._world import (
        Box,
        Capsule,
        Convex,
        Cylinder,
        Ellipsoid,
        HalfSpace,
        HeightField,
        Joint,
        Material,
        Sphere,
        World,
        WorldBuilder,
    )

__all__ = [
    "Box",
    "Capsule",
    "ContactProblem",
    "Convex",
    "Cylinder",
    "Ellipsoid",
    "Equality",
    "FrictionCone",
    "HalfLine",
    "HalfSpace",
    "HeightField",
    "Interval",
    "InvalidInputError",
    "InverseDynamics",
    "InverseDynamicsResult",
    "InverseSolution",
    "Joint",
    "Material",
    "Residual",
    "Simulator",
    "SimulatorSettings",
    "Solution",
    "Sphere",
    "UnsolvedStepError",
    "UnsolvedStepWarning",
    "Workspace",
    "World",
    "WorldBuilder",
    "__version__",
    "fclib",
    "inverse_contact",
    "inverse_dynamics",
    "inverse_residual",
    "load",
    "residual",
    "rollout",
    "solve",
]

_SUBMODULES = ("experiments", "fclib", "peers", "scenes")
_LATER = {  # what needs the simulator, by module
    "_world": (
        "Box",
        "Capsule",
        "Convex",
        "Cylinder",
        "Ellipsoid",
        "HalfSpace",
        "HeightField",
        "Joint",
        "Material",
        "Sphere",
        "World",
        "WorldBuilder",
    ),
    "_simulation": ("Simulator", "SimulatorSettings", "UnsolvedStepError", "UnsolvedStepWarning", "rollout"),
    "_inverse_dynamics": ("InverseDynamics", "InverseDynamicsResult", "inverse_dynamics"),
}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBMODULES})


def __getattr__(name: str) -> Any:
    # Loaded at first use: they need h5py, scipy, Pinocchio or more, and `import signorini` should take no time.
    if name in _SUBMODULES:
        return importlib.import_module(f"signorini.{name}")
    for module, names in _LATER.items():
        if name in names:
            try:
                return getattr(importlib.import_module(f"signorini.{module}"), name)
            except ImportError as error:
                raise ImportError(f"signorini.{name}: this build is without the simulator ({error})") from None
    raise AttributeError(f"module 'signorini' has no attribute {name!r}")
