"""What every engine's process does: load, step, time. Run by whatever Python has the engine; needs numpy alone.

An engine is a function load(folder, model, setting, time_step) -> object with step(count), state() -> (q, v) in our
order and conventions, set_state(q) at rest, mass_matrix() or None, total_mass(), report(), touching() and `extra`,
numbers of its own.

report(): what it says of the model that it has made: time_step [s], gravity [m/s^2], links: of each its mass [kg] and
principal inertias in order [kg m^2], or None where it has none; limits: how many joints have some; damping: the
largest; pairs: of links that may touch, -1 the world, or None where it cannot be asked. touching(): pairs of links with
a contact now.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

BLOCK = 10  # steps between two looks at the state
NO_RESTITUTION = "no coefficient of restitution"


def principal(inertia: Any) -> list[float]:
    """Principal moments of a 3 x 3 inertia about the centre, in order."""
    return [float(x) for x in np.linalg.eigvalsh(np.asarray(inertia))]


def rotation(q: Any) -> Any:
    """3 x 3 of a quaternion (x, y, z, w)."""
    x, y, z, w = np.asarray(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def layout(model: dict[str, Any]) -> list[tuple[int, int, int, int]]:
    """(first of q, values of q, first of v, values of v) of each link."""
    sizes = {"free": (7, 6), "ball": (4, 3), "revolute": (1, 1), "prismatic": (1, 1)}
    out, q, v = [], 0, 0
    for link in model["links"]:
        num_q, num_v = sizes[link["type"]]
        out.append((q, num_q, v, num_v))
        q, v = q + num_q, v + num_v
    return out


def _said(error: Exception) -> str:
    """Its first sentence."""
    lines = str(error).strip().splitlines() or [""]
    return f"{type(error).__name__}: {lines[0].split('. ')[0]}"


def main(version: str, load: Callable[[Path, dict[str, Any], str, float], Any]) -> None:
    """Reads a request from the file named on the command line, writes the answer next to it.

    Request: model (folder), setting, time_step, limit (seconds of stepping after which it stops), starts: of each run
    its q and steps, or None for q: the model's own start. Answer: version, runs: of each what _run says, or its error;
    or error, where there is no model to run.
    """
    path = Path(sys.argv[1])
    request = json.loads(path.read_text())
    answer: dict[str, Any] = {"version": version}
    try:
        folder = Path(request["model"])
        model = json.loads((folder / "model.json").read_text())
        own = json.loads((folder / "start.json").read_text())["q"]
        answer["runs"] = runs = []
        for q, steps in request["starts"]:
            try:
                engine = load(folder, model, request["setting"], request["time_step"])
                runs.append(_run(engine, np.array(own if q is None else q), steps, request["limit"]))
            except Exception as error:
                runs.append({"error": _said(error)})  # the other starts may do
    except Exception as error:
        answer["error"] = _said(error)
    path.with_suffix(".answer").write_text(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # some engines crash while Python takes them down


def _run(engine: Any, q: Any, wanted: int, limit: float) -> dict[str, Any]:
    """Seconds in all and of each block of steps, steps made, q and v after every BLOCK steps, mass_matrix at the start,
    total_mass, report, touched: pairs of links that touched at one of those times, extra; stopped: why it made fewer
    steps, failed: when it was not for lack of time."""
    engine.set_state(q)
    matrix = engine.mass_matrix()
    answer: dict[str, Any] = {"mass_matrix": None if matrix is None else np.asarray(matrix).tolist()}
    answer |= {"total_mass": float(engine.total_mass()), "report": engine.report()}
    states: list[Any] = [[np.asarray(x).tolist() for x in engine.state()]]
    blocks: list[float] = []  # seconds of each
    steps = 0
    touched: set[tuple[int, int]] = set()
    while steps < wanted and sum(blocks) < limit:
        count = min(BLOCK, wanted - steps)
        began = time.perf_counter()
        try:
            engine.step(count)
        except Exception as error:
            if not steps:
                raise
            answer |= {"stopped": f"failed after {steps} steps: {_said(error)}", "failed": True}
            break
        blocks.append(time.perf_counter() - began)
        steps += count
        touched |= {(min(pair), max(pair)) for pair in engine.touching()}
        states.append([np.asarray(x).tolist() for x in engine.state()])
        if not all(np.isfinite(x).all() for x in states[-1]):
            states.pop()
            answer |= {"stopped": f"not finite after {steps} steps", "failed": True}
            break
    if steps < wanted:
        answer.setdefault("stopped", f"out of time after {steps} steps")
    answer |= {"seconds": sum(blocks), "blocks": blocks, "steps": steps, "states": states}
    return answer | {"touched": sorted(touched), "extra": engine.extra()}
