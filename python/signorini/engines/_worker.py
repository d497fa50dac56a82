"""What every engine's process does: load, step, time. Run by whatever Python has the engine; needs numpy alone.

An engine is a function load(folder, model, setting, time_step) -> object with step(count), state() -> (q, v) in our
order and conventions, set_state(q) at rest, mass_matrix() or None, total_mass(), and `extra`, numbers of its own.
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


def main(version: str, load: Callable[[Path, dict[str, Any], str, float], Any]) -> None:
    """Reads a request from the file named on the command line, writes the answer next to it.

    Request: model (folder), setting, time_step, steps, limit (seconds of stepping after which it stops). Answer:
    version, seconds in all and of each block of steps, steps made, q and v after every BLOCK steps, mass_matrix at the
    start, total_mass, extra; or error.
    """
    path = Path(sys.argv[1])
    request = json.loads(path.read_text())
    folder = Path(request["model"])
    model = json.loads((folder / "model.json").read_text())
    answer: dict[str, Any] = {"version": version}
    try:
        engine = load(folder, model, request["setting"], request["time_step"])
        engine.set_state(np.array(json.loads((folder / "start.json").read_text())["q"]))
        matrix = engine.mass_matrix()
        answer |= {"mass_matrix": None if matrix is None else np.asarray(matrix).tolist()}
        answer |= {"total_mass": float(engine.total_mass())}
        states: list[Any] = [[np.asarray(x).tolist() for x in engine.state()]]
        blocks: list[float] = []  # seconds of each
        steps = 0
        while steps < request["steps"] and sum(blocks) < request["limit"]:
            count = min(BLOCK, request["steps"] - steps)
            began = time.perf_counter()
            engine.step(count)
            blocks.append(time.perf_counter() - began)
            steps += count
            states.append([np.asarray(x).tolist() for x in engine.state()])
            if not all(np.isfinite(x).all() for x in states[-1]):
                states.pop()
                answer["stopped"] = f"not finite after {steps} steps"
                break
        if steps < request["steps"]:
            answer.setdefault("stopped", f"out of time after {steps} steps")
        answer |= {"seconds": sum(blocks), "blocks": blocks, "steps": steps, "states": states, "extra": engine.extra()}
    except Exception as error:
        answer["error"] = f"{type(error).__name__}: {str(error).strip().splitlines()[0] if str(error).strip() else ''}"
    path.with_suffix(".answer").write_text(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # some engines crash while Python takes them down
