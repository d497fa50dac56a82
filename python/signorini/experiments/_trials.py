"""Small scenes with a known answer that any engine can be given: creep, sliding, a heavy stack, a bounce.

A push on the box is a part of gravity: on one body that is the same, and needs nothing of an engine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import signorini
from signorini import scenes
from signorini.engines import _exchange, _worker
from signorini.experiments.models import EDGE, FRICTION, GRAVITY, SLOPE, block

Array = npt.NDArray[np.float64]
TIME_STEP = 1e-3
PERIOD = _worker.BLOCK * TIME_STEP  # between two states [s]
STACK = 15  # cubes, 1 kg below to 1e4 kg above
RADIUS, DROP, RESTITUTION = 0.1, 0.5, 0.8  # of the ball; its lowest point is DROP above the ground [m]

NOT_INSTALLED = "not installed"
CREEPS = 1e-6  # [m/s]: what is slower holds
SLIDES = 0.01  # error of the acceleration, and of the height of a bounce
HOPS = 1e-5  # [m]
STANDS = 0.01  # [m]: a stack stands while no cube has moved so far


@dataclass(frozen=True)
class Run:
    """places: of all bodies (times, bodies, 3) as an engine moved them [m]; whole: it was not stopped before."""

    places: Array
    whole: bool


@dataclass(frozen=True)
class Trial:
    """make() -> start; gravity: instead of the start's; steps: full and quick. read: what is measured, None where the
    run was too short to tell."""

    name: str
    make: Callable[[], scenes.Start]
    steps: tuple[int, int]
    read: Callable[[Run], dict[str, float | None]]
    gravity: tuple[float, float, float] | None = None
    restitution: float = 0.0

    def model(self) -> tuple[dict[str, Any], Array]:
        """The plain model, and q at the start; all are at rest then."""
        start = self.make()
        model = _exchange.plain(start.world, FRICTION, self.restitution)
        if self.gravity is not None:
            model["gravity"] = list(self.gravity)
        return model, start.q

    def judge(self, answer: dict[str, Any], steps: int) -> dict[str, float | None]:
        """Of a run's states; its bodies are all free."""
        q = np.array([state[0] for state in answer["states"]]).reshape(len(answer["states"]), -1, 7)
        return self.read(Run(q[:, :, :3], answer["steps"] == steps))


def ball() -> scenes.Start:
    """At rest in the air."""
    builder = signorini.WorldBuilder()
    builder.add_ground()
    joints = [signorini.Joint("ball", "free")]
    builder.add_body("ball", position=(0, 0, RADIUS + DROP), joints=joints, mass=1.0, inertia=4e-3 * np.eye(3))
    builder.add_geometry("ball", signorini.Sphere(RADIUS))
    world = builder.build()
    return scenes.Start(world, world.initial_q, np.zeros(world.num_v))


def stack() -> scenes.Start:
    return scenes.worlds()["cube-stack"](num_cubes=STACK, mass_ratio=1e4, edge=EDGE, friction=FRICTION)


def _creep(run: Run) -> dict[str, float | None]:
    """Speed over the second half, when all has settled [m/s]."""
    half = len(run.places) // 2
    moved = run.places[-1, 0] - run.places[half, 0]
    return {"creep": float(np.linalg.norm(moved[:2]) / ((len(run.places) - 1 - half) * PERIOD))}


def _slide(degrees: float) -> Trial:
    """Pushed with 1.1 mu m g: what accelerates is a tenth of mu g, along the push.

    Measured by how much longer the second half of the way is than the first: the speed of a box that hops or rocks is
    a matter of the moment, and how an engine starts is not asked.
    """
    angle = math.radians(degrees)
    along = np.array([math.cos(angle), math.sin(angle)])

    def read(run: Run) -> dict[str, float | None]:
        half = (len(run.places) - 1) // 2
        x = run.places[:, 0, :2]
        share = (x[2 * half] - 2.0 * x[half] + x[0]) / (half * PERIOD) ** 2 / (0.1 * FRICTION * GRAVITY)
        return {
            "slide_error": float(share @ along - 1.0),
            "sideways": float(np.linalg.norm(share - (share @ along) * along)),
            "hop": float((run.places[:, 0, 2] - 0.5 * EDGE).max()),
        }

    push = 1.1 * FRICTION * GRAVITY * along
    return Trial(f"slide at {degrees:g} deg", block, (1000, 300), read, (push[0], push[1], -GRAVITY))


def _stack_moved(run: Run) -> dict[str, float | None]:
    moved = np.linalg.norm(run.places - run.places[0], axis=2).max(axis=1)
    fallen = np.flatnonzero(moved > STANDS)
    return {
        "moved": float(moved[-1]) if run.whole or fallen.size else None,
        "stood": float((fallen[0] if fallen.size else len(moved) - 1) * PERIOD),
    }


def _bounce(run: Run) -> dict[str, float | None]:
    """Error of the height after the first bounce."""
    height = run.places[:, 0, 2] - RADIUS
    rising = np.flatnonzero(np.diff(height) >= 0.0)
    apex = float(height[rising[0] :].max()) if rising.size else 0.0
    return {"bounce_error": apex / (RESTITUTION**2 * DROP) - 1.0}


HOLD = 0.9 * FRICTION * GRAVITY
TRIALS = (
    Trial("slope of 20 deg", lambda: block(SLOPE), (1000, 300), _creep),
    Trial("held at .9 mu m g", block, (1000, 300), _creep, (HOLD, 0.0, -GRAVITY)),
    _slide(0.0),
    _slide(45.0),
    Trial("stack 1:1e4", stack, (5000, 1000), _stack_moved),
    Trial("bounce", ball, (600, 600), _bounce, None, RESTITUTION),
)


def passes(found: dict[str, dict[str, Any]]) -> dict[str, bool | None]:
    """Column -> whether one engine passes it; None: it cannot be told. found: trial -> what was read, with "failed", or
    an "error"."""

    def holds(trial: str, key: str, bound: float) -> bool | None:
        result = found[trial]
        if result.get("error") == NOT_INSTALLED:
            return None
        if "error" in result or result["failed"]:
            return False
        return None if result[key] is None else bool(abs(result[key]) < bound)

    slides = [trial.name for trial in TRIALS if trial.name.startswith("slide")]
    out = {
        "creep, slope": holds(TRIALS[0].name, "creep", CREEPS),
        "creep, held": holds(TRIALS[1].name, "creep", CREEPS),
    }
    for name in slides:
        straight, fast = holds(name, "sideways", SLIDES), holds(name, "slide_error", SLIDES)
        out[name] = None if fast is None or straight is None else fast and straight
    hops = [holds(name, "hop", HOPS) for name in slides]
    out["hop"] = None if None in hops else all(hops)
    out["stack"] = holds("stack 1:1e4", "moved", STANDS)
    out["bounce"] = holds("bounce", "bounce_error", SLIDES)
    return out
