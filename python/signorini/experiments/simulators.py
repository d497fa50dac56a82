"""Steps a second of other people's simulators beside ours, and beside each what its steps are worth.

All run the same plain model from the same state; every state they pass through is judged by the same rulers, ours:
distances between shapes, energy, and where the bodies are, held against a run of ours with far smaller steps.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini import engines, scenes
from signorini.engines import _exchange
from signorini.experiments import _plots
from signorini.experiments._report import Options, Report, Verdict

TIME_STEP = 1e-3
DURATION, QUICK_DURATION = 2.0, 0.5  # simulated [s]
ROUNDS, QUICK_ROUNDS = 5, 1
FINE, QUICK_FINE = 100, 20  # the reference's steps in one of ours
TOLERANCES = (1e-10, 1e-8, 1e-6)  # of the reference, the first that will do
LIMIT, QUICK_LIMIT = 60.0, 4.0  # [s] of stepping a run
FRICTION = 0.8
EARLY = 0.15  # [s]
PARTED = 0.01  # [m]: two motions this far apart have parted
BLOCK = 10  # steps between two states, as in engines._worker
MUJOCO_GOAL = 1.0  # steps a second over MuJoCo's, elliptic
SCENES: dict[str, dict[str, Any]] = {"ur5": {}, "cassie": {}, "humanoid": {}, "cube-stack": {"mass_ratio": 1.0}}
OURS = "ours"


@dataclass(frozen=True)
class Judge:
    """The rulers. reference: positions of the links (times, links, 3) of the fine run; horizon: until when it is known
    to a millimetre: after that two fine runs of ours have parted, and nobody's error means anything [s]."""

    world: signorini.World
    reference: Any
    horizon: float

    def __call__(self, answer: dict[str, Any]) -> dict[str, float | None]:
        """Of one run: error against the reference early and at the horizon [m], when it parted from it [s], deepest
        overlap [m], largest gain of energy and final change [J], loops' largest gap [m]."""
        states = [(np.array(q), np.array(v)) for q, v in answer["states"]]
        count = min(len(states), len(self.reference))
        error = np.array(
            [np.linalg.norm(places(self.world, states[k][0]) - self.reference[k], axis=1).max() for k in range(count)]
        )
        known = min(count - 1, round(self.horizon / (BLOCK * TIME_STEP)))
        early = round(EARLY / (BLOCK * TIME_STEP))
        parted = np.flatnonzero(error[: known + 1] > PARTED)
        overlap = max((-d for q, _ in states for _, _, d in self.world.touching_pairs(q, 0.0)), default=0.0)
        energies = energy(self.world, states)
        gaps = [np.abs(self.world.constraint_gaps(q)).max() for q, _ in states] if self.world.constraints else []
        return {
            "error_early": float(error[early]) if early <= known else None,
            "error_horizon": float(error[known]),
            "parted": float(parted[0] * BLOCK * TIME_STEP) if parted.size else None,
            "overlap": max(overlap, 0.0),
            "energy_gain": float((energies - energies[0]).max()),
            "energy_change": float(energies[-1] - energies[0]),
            "loop_gap": float(max(gaps)) if gaps else None,
        }


def places(world: signorini.World, q: Any) -> Any:
    """(links, 3): origins of all links in the world [m]."""
    return np.array([frame.translation for frame in world._core.frame_placements(q)[1:]])


def energy(world: signorini.World, states: list[tuple[Any, Any]]) -> Any:
    """Total energy of each state [J]."""
    simulator = signorini.Simulator(world)
    out = []
    for q, v in states:
        simulator.state.q, simulator.state.v = q, v
        out.append(simulator.energy.total)
    return np.array(out)


def reference(world: signorini.World, q: Any, duration: float, fine: int) -> tuple[Any, float, float]:
    """Positions of the links every BLOCK steps of TIME_STEP, with steps fine times smaller; the time until which a run
    with steps twice as large stays within a millimetre of it [s]; the tolerance of both.

    The tolerance is the first of TOLERANCES with which that time is not short, else that of the longest.
    """
    best: tuple[Any, float, float] | None = None
    for tolerance in TOLERANCES:
        runs = [_fine(world, q, duration, refinement, tolerance) for refinement in (fine // 2, fine)]
        apart = np.linalg.norm(runs[0] - runs[1], axis=2).max(axis=1)
        lost = np.flatnonzero(apart > 1e-3)
        horizon = (int(lost[0]) - 1 if lost.size else len(apart) - 1) * BLOCK * TIME_STEP
        if best is None or horizon > best[1]:
            best = runs[1], horizon, tolerance
        if horizon >= min(EARLY, duration) - 1e-9:
            break
    assert best is not None
    return best


def _fine(world: signorini.World, q: Any, duration: float, refinement: int, tolerance: float) -> Any:
    simulator = signorini.Simulator(world, time_step=TIME_STEP / refinement, tolerance=tolerance)
    simulator.state.q = q
    at = [places(world, simulator.state.q)]
    for _ in range(round(duration / TIME_STEP / BLOCK)):
        simulator.run(BLOCK * refinement)
        at.append(places(world, simulator.state.q))
    return np.array(at)


def mass_error(world: signorini.World, q: Any, answer: dict[str, Any]) -> float:
    """How far an engine's masses are from ours, relative: of the total, and of the mass matrix's part that belongs to
    the joints (which does not depend on how a free base is described)."""
    total = sum(body.mass for body in world.bodies)
    off = abs(answer["total_mass"] - total) / total
    matrix = answer.get("mass_matrix")
    joints = [joint.v_index for joint in world.joints if joint.num_v == 1]
    if matrix is not None and joints:
        simulator = signorini.Simulator(world)
        simulator.state.q = q
        ours = simulator.mass_matrix[np.ix_(joints, joints)]
        theirs = np.array(matrix)
        if len(theirs) != len(joints):
            theirs = theirs[np.ix_(joints, joints)]
        off = max(off, float(np.abs(theirs - ours).max() / np.abs(ours).max()))
    return float(off)


def run(options: Options, install: bool = False, only: tuple[str, ...] = ()) -> Report:
    """Every scene by every engine that is there, in turns, several rounds; install: those that are not, from PyPI into
    environments of their own. only: these engines, by name."""
    quick = options.quick
    steps = round((QUICK_DURATION if quick else DURATION) / TIME_STEP)
    rounds, fine, limit = (QUICK_ROUNDS, QUICK_FINE, QUICK_LIMIT) if quick else (ROUNDS, FINE, LIMIT)
    notes = ["steps/s are worth what the machine was free for: other work on it slows all, not evenly"]
    versions: dict[str, str] = {}
    known = {engine.name: engine for engine in engines.ENGINES}
    for name in only:
        if name not in known:
            raise signorini.InvalidInputError(f"engine: is {name!r}, must be one of {', '.join(known)}")
    chosen = [engine for engine in engines.ENGINES if not only or engine.name in (*only, "signorini")]
    pythons = {engine.name: _python(engine, install, notes) for engine in chosen}
    runners = [(engine, setting) for engine in chosen for setting in engine.settings]
    numbers: dict[str, Any] = {
        "time_step": TIME_STEP,
        "duration": steps * TIME_STEP,
        "rounds": rounds,
        "reference": {"time_step": TIME_STEP / fine},
        "friction": FRICTION,
        "scenes": {},
    }
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    verdicts: list[Verdict] = []
    work = len(SCENES) * (rounds * len(runners) + 1)
    done = 0
    for name, changes in SCENES.items():
        options.progress(done, work, f"{name}: reference")
        try:
            start = scenes.worlds()[name](**changes)
        except (ImportError, OSError, signorini.InvalidInputError) as error:
            notes.append(f"{name} left out: {error}")
            done += rounds * len(runners) + 1
            continue
        if np.any(start.v):
            raise signorini.InvalidInputError(f"scene {name!r}: moves at the start, must be at rest")
        model = _exchange.plain(start.world, FRICTION)
        world = _exchange.build(model)
        known_places, horizon, tolerance = reference(world, start.q, steps * TIME_STEP, fine)
        judge = Judge(world, known_places, horizon)
        answers: dict[str, list[dict[str, Any]]] = {_label(*runner): [] for runner in runners}
        done += 1
        with tempfile.TemporaryDirectory(prefix="signorini-model-") as folder:
            _exchange.write(model, start.q, Path(folder))
            for k in range(rounds):
                for i in range(len(runners)):
                    engine, setting = runners[(i + k) % len(runners)]  # nobody always comes after the same one
                    label, python = _label(engine, setting), pythons[engine.name]
                    options.progress(done, work, f"{name}: {label}")
                    done += 1
                    before = answers[label]
                    if python is None:
                        answer: dict[str, Any] = {"error": "not installed"}
                    elif before and ("error" in before[0] or "stopped" in before[0]):
                        continue  # it would do the same again
                    else:
                        answer = engines.run(
                            python, engine, setting, Path(folder), time_step=TIME_STEP, steps=steps, limit=limit
                        )
                    before.append(answer)
                    if "version" in answer and engine.name != "signorini":
                        versions[engine.title] = answer["version"]
        results = {label: _judged(judge, start.q, many) for label, many in answers.items()}
        for label, result in results.items():
            why = result.get("error") or result.get("stopped")
            if why and why != "not installed":
                notes.append(f"{name}, {label}: {why}")
        numbers["scenes"][name] = {
            "horizon": judge.horizon,
            "reference_tolerance": tolerance,
            "engines": results,
        }
        tables[f"{name}; mm off: against the reference, end: at {judge.horizon:.2f} s"] = _table(results)
        verdicts += _verdicts(name, results, steps)
    options.progress(work, work, "")
    report = Report("simulators", numbers, verdicts, tables, notes)
    if _plots.available() and numbers["scenes"]:
        report.files.append(_plot(numbers, options.output / "simulators.png"))
    report.write(options, versions)
    return report


def _label(engine: engines.Engine, setting: str) -> str:
    return engine.title if len(engine.settings) == 1 else f"{engine.title} {setting}"


def _python(engine: engines.Engine, install: bool, notes: list[str]) -> str | None:
    python = engines.interpreter(engine)
    if python is None and install:
        try:
            engines.install(engine)
        except (RuntimeError, OSError) as error:
            notes.append(str(error))
        python = engines.interpreter(engine)
    if python is None:
        notes.append(f"{engine.title} ({engine.licence}) is not installed: --install makes an environment for it")
    return python


def _judged(judge: Judge, q: Any, answers: list[dict[str, Any]]) -> dict[str, Any]:
    first = answers[0]
    if "error" in first:
        return {"error": first["error"]}
    speeds = [answer["steps"] / answer["seconds"] for answer in answers if "seconds" in answer]
    return {
        "steps_per_second": first["steps"] / _least_seconds(answers),
        "speeds": speeds,
        "steps": first["steps"],
        "stopped": first.get("stopped"),
        "mass_error": mass_error(judge.world, q, first),
        **judge(first),
        **first["extra"],
    }


def _least_seconds(answers: list[dict[str, Any]]) -> float:
    """Of a run: of each block the least that a round took. All rounds do the same work, so that the rest is what else
    the machine had to do."""
    whole = [answer["blocks"] for answer in answers if "blocks" in answer]
    count = max(len(blocks) for blocks in whole)
    return float(np.min([blocks for blocks in whole if len(blocks) == count], axis=0).sum())


def _table(results: dict[str, dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    columns = [
        "engine", "steps/s", "range", "ours/it", f"mm off {EARLY:g} s", "mm off, end", "1 cm off [s]",
        "overlap [mm]", "J gained", "J change", "loop [mm]", "masses", "certificate",
    ]  # fmt: skip
    rows = []
    ours = results.get(OURS, {}).get("steps_per_second")
    for label, result in results.items():
        if "error" in result:
            said = "not installed" if result["error"] == "not installed" else "cannot run"
            rows.append([label, said, *[""] * (len(columns) - 2)])
            continue
        speed = result["steps_per_second"]
        rows.append(
            [
                label + (f" ({result['steps']} steps)" if result["stopped"] else ""),
                f"{speed:.0f}",
                f"{min(result['speeds']):.0f}-{max(result['speeds']):.0f}",
                f"{ours / speed:.2f}" if ours else "",
                _millimetres(result["error_early"]),
                _millimetres(result["error_horizon"]),
                "never" if result["parted"] is None else f"{result['parted']:.2f}",
                _millimetres(result["overlap"]),
                f"{result['energy_gain']:.1e}",
                f"{result['energy_change']:.3g}",
                _millimetres(result["loop_gap"]),
                f"{result['mass_error']:.0e}",
                f"{result['worst_certificate']:.0e}" if "worst_certificate" in result else "",
            ]
        )
    return columns, rows


def _millimetres(value: float | None) -> str:
    return "" if value is None else f"{1e3 * value:.2g}"


def _verdicts(name: str, results: dict[str, dict[str, Any]], steps: int) -> list[Verdict]:
    ours = results[OURS]
    if "error" in ours:
        return [Verdict(f"{name}: ours runs", ours["error"], "", False)]
    verdicts = [
        Verdict(
            f"{name}: every step certified", f"{ours['unsolved']} of {steps} not solved", "0", ours["unsolved"] == 0
        )
    ]
    for label, result in results.items():
        if not label.startswith("MuJoCo") or "error" in result:
            continue
        ratio = ours["steps_per_second"] / result["steps_per_second"]
        verdicts.append(Verdict(f"{name}: speed over {label}", f"{ratio:.2f}", ">= 1", ratio >= MUJOCO_GOAL))
        better = ours["error_horizon"] <= result["error_horizon"]
        both = f"{_millimetres(ours['error_horizon'])} mm, {_millimetres(result['error_horizon'])} mm"
        verdicts.append(Verdict(f"{name}: error at the horizon, ours and {label}", both, "ours not larger", better))
    return verdicts


def _plot(numbers: dict[str, Any], path: Path) -> Path:
    """Speed against error at the horizon: right and down is better."""
    names = list(numbers["scenes"])
    made, axes = _plots.figure(1, len(names), width=4.6)
    for axis, name in zip(axes[0], names, strict=True):
        for label, result in numbers["scenes"][name]["engines"].items():
            if "error" in result:
                continue
            at = result["steps_per_second"], max(1e3 * result["error_horizon"], 1e-6)
            axis.loglog(*at, "o", color=_plots.COLORS["ours" if label == OURS else "other"])
            axis.annotate(label, at, textcoords="offset points", xytext=(4, 4), fontsize=7)
        axis.set_title(f"{name}, {numbers['scenes'][name]['horizon']:.2f} s")
        axis.set_xlabel("steps a second")
        axis.set_ylabel("position error [mm]")
        axis.margins(x=0.3, y=0.15)
    return _plots.save(made, path)
