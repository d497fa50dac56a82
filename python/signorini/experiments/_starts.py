"""One start says little of a motion that is chaotic: the same scene from many starts, each judged as far as its own
reference reaches; and from all of them with smaller and smaller steps."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import signorini
from signorini import engines
from signorini.engines import _exchange
from signorini.experiments import _truth
from signorini.experiments._truth import Judge, millimetres

RAISED = 0.01  # [m], at most
TILTED = 0.05  # [rad], at most
TURNED = 0.05  # [rad]: joints, at most
CLEAR = 1e-4  # [m]: what may touch is this far apart at the start
AS_NEAR = 1e-6  # [m]: errors that differ by less are the same
MOST_TRIES = 300  # for one start
REFINEMENTS = (1, 2, 4, 8, 16, 32)
Runner = tuple[engines.Engine, str]
Error = dict[str, float | None]
Table = tuple[list[str], list[list[str]]]
T = TypeVar("T")
S = TypeVar("S")


def draw(world: signorini.World, q: Any, count: int, seed: int = 0) -> list[Any]:
    """Configurations near q: a free base is tilted about a level axis and its lowest point raised over where it was,
    joints are turned; in a world with loops, which have to stay closed, joints stay as they are. Nothing touches.
    Raises InvalidInputError where something does in all of MOST_TRIES."""
    random = np.random.default_rng(seed)
    above = _above(world, q)
    out: list[Any] = []
    tries = 0
    while len(out) < count:
        tries += 1
        if tries > MOST_TRIES:
            said = f"something touches in all of {MOST_TRIES} configurations near it, must have room around it"
            raise signorini.InvalidInputError(f"q: {said}")
        change = np.zeros(world.num_v)
        for joint in world.joints:
            at = slice(joint.v_index, joint.v_index + joint.num_v)
            if joint.num_v == 6:
                level = random.standard_normal(2)
                change[at][3:5] = random.uniform(0.0, TILTED) * level / np.linalg.norm(level)
            elif not world.constraints:
                change[at] = random.uniform(-TURNED, TURNED, joint.num_v)
        raised = random.uniform(0.0, RAISED)
        one = np.array(world.integrate(q, change, 1.0))
        if above is not None:
            height = above + raised - (_above(world, one) or 0.0)
            for joint in world.joints:
                if joint.num_v == 6:
                    one[joint.q_index + 2] += height
        if not world.touching_pairs(one, CLEAR):
            out.append(one)
            tries = 0
    return out


def _above(world: signorini.World, q: Any) -> float | None:
    """How far the lowest point is above the ground [m]; None without a ground."""
    ground = {k for k, geometry in enumerate(world.geometries) if geometry.shape.type.name == "half_space"}
    found = [distance for a, b, distance in world.touching_pairs(q, 10.0) if a in ground or b in ground]
    return min(found, default=None)


@dataclass(frozen=True)
class Start:
    """A configuration, and the judge of what starts there."""

    q: Any
    judge: Judge

    @property
    def steps(self) -> int:
        """Of TIME_STEP, to the horizon."""
        return round(self.judge.horizon / _truth.TIME_STEP)


def prepare(world: signorini.World, all_q: list[Any], duration: float, fine: int) -> list[Start]:
    """Each with a reference of its own."""

    def one(q: Any) -> Start:
        places, horizon, _ = _truth.reference(world, q, duration, fine)
        return Start(q, Judge(world, places, horizon))

    return _map(one, all_q)


def errors(
    starts: list[Start],
    model: dict[str, Any],
    runner: Runner,
    python: str,
    limit: float,
    refinement: int = 1,
) -> list[Error]:
    """Of one engine from each start, with steps of TIME_STEP / refinement: "early", "end" [m]: error at EARLY and at
    the horizon; inf where it does not get there, None where nobody knows."""
    engine, setting = runner
    with tempfile.TemporaryDirectory(prefix="signorini-model-") as folder:
        _exchange.write(model, starts[0].q, Path(folder))

        def some(part: list[Start]) -> list[dict[str, Any]]:
            wanted = [(start.q, refinement * start.steps) for start in part]
            step = _truth.TIME_STEP / refinement
            return engines.run_all(python, engine, setting, Path(folder), wanted, time_step=step, limit=limit)

        halves = _map(some, [starts[0::2], starts[1::2]] if len(starts) > 1 else [starts])
    answers = [half[k] for k in range(len(halves[0])) for half in halves if k < len(half)]  # in their order again
    early = round(_truth.EARLY / _truth.LOOK)
    out: list[Error] = []
    for start, answer in zip(starts, answers, strict=True):
        error = start.judge.errors(answer["states"][::refinement]) if "states" in answer else np.zeros(0)
        known = len(start.judge.reference)
        at = [float(error[k]) if k < len(error) else math.inf for k in (early, known - 1)]
        out.append({"early": at[0] if early < known else None, "end": at[1]})
    return out


def summary(many: list[Error], ours: list[Error]) -> dict[str, Any]:
    """count: of starts, through: that it got through, to the end; for each of early and end the median error [m], the
    worst of those that it got through, and nearer: of how many starts ours is at least as near as it, of how many the
    error is known. A start that one does not get through has an error of inf."""
    out: dict[str, Any] = {"count": len(many), "through": sum(_through(one["end"]) for one in many)}
    for key in ("early", "end"):
        values = [value for one in many if (value := one[key]) is not None]
        pairs = [(mine[key], other[key]) for mine, other in zip(ours, many, strict=True)]
        both = [(near, far) for near, far in pairs if near is not None and far is not None]
        out[key] = {
            "median": float(np.median(values)) if values else None,
            "worst": max(filter(_through, values), default=None),
            "nearer": sum(_through(near) and near <= far + AS_NEAR for near, far in both),
            "of": len(both),
        }
    return out


def _through(error: float | None) -> bool:
    return error is not None and math.isfinite(error)


def table(found: dict[str, dict[str, Any]]) -> Table:
    """Of summaries, an engine a row."""
    columns = ["engine", "starts"]
    for when in (f"{_truth.EARLY:g} s", "end"):
        columns += [f"{when}: median mm off", "worst", "ours is as near"]
    rows = []
    for k, (label, one) in enumerate(found.items()):
        row = [label, str(one["count"]) if one["through"] == one["count"] else f"{one['through']} of {one['count']}"]
        for key in ("early", "end"):
            at = one[key]
            row += [millimetres(at["median"]), millimetres(at["worst"])]
            row.append("" if k == 0 else f"{at['nearer']} of {at['of']}")
        rows.append(row)
    return columns, rows


def refined(small: dict[str, list[list[Error]]]) -> Table:
    """engine -> errors from each start by refinement: medians, and the first start's at the end."""
    columns = ["steps [ms]", "1", *(f"1/{n}" for n in REFINEMENTS[1:])]
    rows = []
    for label, by_step in small.items():
        for key, said in (("early", f"{_truth.EARLY:g} s"), ("end", "end")):
            medians = [summary(many, many)[key]["median"] for many in by_step]
            rows.append([f"{label}, {said}", *map(millimetres, medians)])
        rows.append([f"{label}, end, first start", *(millimetres(many[0]["end"]) for many in by_step)])
    return columns, rows


def _map(one: Callable[[S], T], many: Iterable[S]) -> list[T]:
    """On two cores, where there are: no time counts here. What runs releases the interpreter or is a process."""
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        return list(pool.map(one, many))
