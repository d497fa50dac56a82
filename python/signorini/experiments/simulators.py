"""Steps a second of other people's simulators beside ours, and beside each what its steps are worth.

All run the same plain model from the same state; every state they pass through is judged by the same rulers, ours:
distances between shapes, energy, and where the bodies are, held against a run of ours with far smaller steps. Small
scenes with a known answer (_trials) say what each engine gives away: creep, sliding, a heavy stack, a bounce.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini import engines, scenes
from signorini.engines import _exchange, _worker
from signorini.experiments import _plots, _trials
from signorini.experiments._report import Options, Report, Verdict

TIME_STEP = 1e-3
DURATION, QUICK_DURATION = 2.0, 0.5  # simulated [s]
ROUNDS, QUICK_ROUNDS = 5, 1
FINE, QUICK_FINE = 100, 20  # the reference's steps in one of ours
TOLERANCES = (1e-10, 1e-8, 1e-6)  # of the reference, the first that will do
LIMIT, QUICK_LIMIT = 60.0, 4.0  # [s] of stepping a run
LONG = 5.0  # [s] of stepping; what takes longer is not repeated
FRICTION = 0.8
EARLY = 0.15  # [s]
PARTED = 0.01  # [m]: two motions this far apart have parted
BLOCK = _worker.BLOCK
SAME = 1e-5  # relative: masses that differ by less are the same (links without mass have 1e-6 kg in some engines)
MUJOCO_GOAL = 1.0  # steps a second over MuJoCo's, elliptic
SCENES: dict[str, dict[str, Any]] = {"ur5": {}, "cassie": {}, "humanoid": {}, "cube-stack": {"mass_ratio": 1.0}}
AT_REST = ("cube-stack",)  # ought to stay where it is: what moves there creeps
TRIALS = "trials"
OURS = "ours"
NOT_INSTALLED = _trials.NOT_INSTALLED


@dataclass(frozen=True)
class Judge:
    """The rulers. reference: positions of the links (times, links, 3) of the fine run; horizon: until when it is known
    to a millimetre: after that two fine runs of ours have parted, and nobody's error means anything [s]. at_rest: it
    ought to stay where it is."""

    world: signorini.World
    reference: Any
    horizon: float
    at_rest: bool = False

    def __call__(self, answer: dict[str, Any]) -> dict[str, float | None]:
        """Of one run: error against the reference early and at the horizon [m], when it parted from it [s], deepest
        overlap [m], creep: the fastest body over the second half, of a scene at rest [m/s], largest gain of energy and
        final change [J], loops' largest gap [m]."""
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
        half = (len(states) - 1) // 2
        moved = np.linalg.norm(places(self.world, states[-1][0]) - places(self.world, states[half][0]), axis=1).max()
        gaps = [np.abs(self.world.constraint_gaps(q)).max() for q, _ in states] if self.world.constraints else []
        return {
            "error_early": float(error[early]) if early <= known else None,
            "error_horizon": float(error[known]),
            "parted": float(parted[0] * BLOCK * TIME_STEP) if parted.size else None,
            "overlap": max(overlap, 0.0),
            "creep": float(moved / ((len(states) - 1 - half) * BLOCK * TIME_STEP)) if self.at_rest else None,
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


def differences(world: signorini.World, model: dict[str, Any], q: Any, answer: dict[str, Any]) -> list[str]:
    """In what an engine's model, as the engine itself says, is not the one that it was given: step, gravity, masses,
    inertias, limits, damping, start, pairs that may touch."""
    said, out = answer["report"], []
    if abs(said["time_step"] - TIME_STEP) > 1e-9:
        out.append(f"steps of {said['time_step']:g} s")
    if not np.allclose(said["gravity"], model["gravity"], rtol=0.0, atol=1e-6):
        out.append(f"gravity of {said['gravity']} m/s^2")
    for link, theirs in zip(model["links"], said["links"], strict=True):
        if link["mass"] == 0.0:
            continue
        ours = np.array([link["mass"], *_worker.principal(link["inertia"])])
        off = (
            np.inf if theirs is None else max(abs(theirs[0] / ours[0] - 1.0), np.abs(ours - theirs)[1:].max() / ours[3])
        )
        if off > SAME:
            out.append(f"mass or inertia of {link['name']} by {off:.0e}")
    off = mass_error(world, q, answer)
    if off > SAME:
        out.append(f"mass matrix by {off:.0e}")
    if said["limits"]:
        out.append(f"limits on {said['limits']} joints")
    if said["damping"] > 0.0:
        out.append(f"damping or dry friction of {said['damping']:g}")
    at, v = (np.array(x) for x in answer["states"][0])
    apart = np.linalg.norm(places(world, at) - places(world, q), axis=1).max()
    if apart > 1e-6 or np.any(v):  # some keep poses as float
        out.append(f"starts {1e3 * apart:.1e} mm off at {np.abs(v).max():.1e} m/s")
    carriers = sorted({geometry["link"] for geometry in model["geometries"]})
    allowed = {(a, b) for a in carriers for b in carriers if a < b} - {
        tuple(sorted(pair)) for pair in model["excluded"]
    }
    pairs = {tuple(sorted(pair)) for pair in said["pairs"]} if said["pairs"] is not None else allowed
    for a, b in sorted(pairs ^ allowed):
        out.append(f"{_pair(model, a, b)} may {'' if (a, b) in pairs else 'not '}touch")
    for a, b in sorted({tuple(pair) for pair in answer["touched"]} - allowed):
        out.append(f"{_pair(model, a, b)} touched")
    return out


def _pair(model: dict[str, Any], a: int, b: int) -> str:
    return " and ".join(model["links"][k]["name"] if k >= 0 else "the world" for k in (a, b))


def run(
    options: Options, install: bool = False, only: tuple[str, ...] = (), only_scenes: tuple[str, ...] = ()
) -> Report:
    """Every scene by every engine that is there, in turns, several rounds, and the trials once; install: those that are
    not, from PyPI into environments of their own. only: these engines, by name; only_scenes: these scenes."""
    quick = options.quick
    steps = round((QUICK_DURATION if quick else DURATION) / TIME_STEP)
    rounds, fine, limit = (QUICK_ROUNDS, QUICK_FINE, QUICK_LIMIT) if quick else (ROUNDS, FINE, LIMIT)
    notes = ["steps/s are worth what the machine was free for: other work on it slows all, not evenly"]
    versions: dict[str, str] = {}
    known = {engine.name: engine for engine in engines.ENGINES}
    for name in only:
        if name not in known:
            raise signorini.InvalidInputError(f"engine: is {name!r}, must be one of {', '.join(known)}")
    for name in only_scenes:
        if name not in (*SCENES, TRIALS):
            raise signorini.InvalidInputError(f"scene: is {name!r}, must be one of {', '.join((*SCENES, TRIALS))}")
    wanted = {name: changes for name, changes in SCENES.items() if not only_scenes or name in only_scenes}
    trials = _trials.TRIALS if not only_scenes or TRIALS in only_scenes else ()
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
    work = len(wanted) * (rounds * len(runners) + 1) + len(trials) * len(runners)
    done = 0
    for name, changes in wanted.items():
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
        judge = Judge(world, known_places, horizon, name in AT_REST)
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
                        answer: dict[str, Any] = {"error": NOT_INSTALLED}
                    elif before and ("error" in before[0] or "stopped" in before[0] or before[0]["seconds"] > LONG):
                        continue  # it would do the same again, or takes too long
                    else:
                        answer = engines.run(
                            python, engine, setting, Path(folder), time_step=TIME_STEP, steps=steps, limit=limit
                        )
                    before.append(answer)
                    if "version" in answer and engine.name != "signorini":
                        versions[engine.title] = answer["version"]
        results = {label: _judged(judge, model, start.q, many) for label, many in answers.items()}
        _note(name, results, notes)
        numbers["scenes"][name] = {
            "horizon": judge.horizon,
            "reference_tolerance": tolerance,
            "engines": results,
        }
        tables[f"{name}; mm off: against the reference, end: at {judge.horizon:.2f} s"] = _table(results)
        verdicts += _verdicts(name, results, steps)
    if trials:
        _try(options, trials, runners, pythons, limit, versions, (done, work), numbers, notes)
        tables = {_trials_title(numbers): _trials_table(numbers), **tables}
        verdicts = [*_trials_verdicts(numbers), *verdicts]
    for engine in chosen:
        version = versions.get(engine.title)
        if version is not None and engine.is_old(version):
            least = ".".join(map(str, engine.least))
            notes.append(f"{engine.title} is {version}, older than {least}, which is the one to measure")
    options.progress(work, work, "")
    report = Report("simulators", numbers, verdicts, tables, notes)
    if _plots.available() and numbers["scenes"]:
        report.files.append(_plot(numbers, options.output / "simulators.png"))
    if _plots.available() and trials:
        report.files.append(_plot_trials(numbers, options.output / "simulators-trials.png"))
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


def _note(name: str, results: dict[str, dict[str, Any]], notes: list[str]) -> None:
    for label, result in results.items():
        why = result.get("error") or result.get("stopped")
        if why and why != NOT_INSTALLED:
            notes.append(f"{name}, {label}: {why}")
        if result.get("differs"):
            notes.append(f"{name}, {label}: another model: {'; '.join(result['differs'])}")


def _try(
    options: Options,
    trials: tuple[_trials.Trial, ...],
    runners: list[tuple[engines.Engine, str]],
    pythons: dict[str, str | None],
    limit: float,
    versions: dict[str, str],
    progress: tuple[int, int],
    numbers: dict[str, Any],
    notes: list[str],
) -> None:
    """Every trial by every engine; into numbers: "trials", trial -> engine -> what was read, and "passes"."""
    done, work = progress
    numbers[TRIALS], numbers["passes"] = {}, {}
    for trial in trials:
        model, q = trial.model()
        world, steps = _exchange.build(model), trial.steps[options.quick]
        results: dict[str, dict[str, Any]] = {}
        numbers[TRIALS][trial.name] = results
        with tempfile.TemporaryDirectory(prefix="signorini-model-") as folder:
            _exchange.write(model, q, Path(folder))
            for engine, setting in runners:
                label, python = _label(engine, setting), pythons[engine.name]
                options.progress(done, work, f"{trial.name}: {label}")
                done += 1
                if python is None:
                    results[label] = {"error": NOT_INSTALLED}
                    continue
                answer = engines.run(
                    python, engine, setting, Path(folder), time_step=TIME_STEP, steps=steps, limit=limit
                )
                if "version" in answer and engine.name != "signorini":
                    versions[engine.title] = answer["version"]
                if "error" in answer:
                    results[label] = {"error": answer["error"]}
                    continue
                results[label] = {
                    **trial.judge(answer, steps),
                    "steps": answer["steps"],
                    "stopped": answer.get("stopped"),
                    "failed": answer.get("failed", False),
                    "differs": differences(world, model, q, answer),
                    **answer["extra"],
                }
        _note(trial.name, results, notes)
    for engine, setting in runners:
        label = _label(engine, setting)
        numbers["passes"][label] = _trials.passes({name: found[label] for name, found in numbers[TRIALS].items()})


def _trials_title(numbers: dict[str, Any]) -> str:
    bounds = f"creep below {1e6 * _trials.CREEPS:g} um/s, slides and bounce within {100 * _trials.SLIDES:g} %"
    bounds += f", hop below {1e6 * _trials.HOPS:g} um, no cube of the stack moved by {1e3 * _trials.STANDS:g} mm"
    return f"One setting, every column: {bounds}"


#: Title, trial, reading, factor: the columns.
READINGS = (
    ("creep: slope [um/s]", "slope of 20 deg", "creep", 1e6),
    ("held [um/s]", "held at .9 mu m g", "creep", 1e6),
    ("slide 0 deg [%]", "slide at 0 deg", "slide_error", 100.0),
    ("45 deg [%]", "slide at 45 deg", "slide_error", 100.0),
    ("hop [um]", "slide at 0 deg", "hop", 1e6),
    ("stack moved [mm]", "stack 1:1e4", "moved", 1e3),
    ("stood [s]", "stack 1:1e4", "stood", 1.0),
    ("bounce [%]", "bounce", "bounce_error", 100.0),
)


def _trials_table(numbers: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    fast = [name for name in ("humanoid", "cube-stack") if name in numbers["scenes"]]
    columns = ["engine", *(title for title, *_ in READINGS), "passes", *(f"{name} steps/s" for name in fast)]
    rows = []
    for label, passed in numbers["passes"].items():
        row = [label]
        for _, trial, key, factor in READINGS:
            result = dict(numbers[TRIALS][trial][label])
            if key == "hop":  # the higher of the two
                other = numbers[TRIALS]["slide at 45 deg"][label]
                result = other if other.get("hop", 0.0) > result.get("hop", 0.0) else result
            row.append(_reading(result, key, factor))
        said = f"{sum(one is True for one in passed.values())} of {len(passed)}"
        row.append("" if all("error" in numbers[TRIALS][trial][label] for trial in numbers[TRIALS]) else said)
        for name in fast:
            speed = numbers["scenes"][name]["engines"][label].get("steps_per_second")
            row.append("" if speed is None else f"{speed:.0f}")
        rows.append(row)
    return columns, rows


def _reading(result: dict[str, Any], key: str, factor: float) -> str:
    if "error" in result:
        known = {_worker.NO_RESTITUTION: "none", NOT_INSTALLED: NOT_INSTALLED}
        return next((short for said, short in known.items() if said in result["error"]), "cannot run")
    value = result[key]
    if value is None:
        return "fails" if result["failed"] else "out of time"
    return f"{factor * value:+.2g}" if factor == 100.0 else f"{factor * value:.2g}"


def _trials_verdicts(numbers: dict[str, Any]) -> list[Verdict]:
    found = {name: result[OURS] for name, result in numbers[TRIALS].items()}
    broken = [f"{name}: {result['error']}" for name, result in found.items() if "error" in result]
    if broken:
        return [Verdict("trials: ours runs", "; ".join(broken), "", False)]
    passed = numbers["passes"][OURS]
    unsolved = sum(result["unsolved"] for result in found.values())
    creep = max(found[name]["creep"] for name in ("slope of 20 deg", "held at .9 mu m g"))
    slides = [found[name] for name in ("slide at 0 deg", "slide at 45 deg")]
    error = max(max(abs(one["slide_error"]), one["sideways"]) for one in slides)
    hop, stack = max(one["hop"] for one in slides), found["stack 1:1e4"]
    said = "out of time" if stack["moved"] is None else f"{1e6 * stack['moved']:.1e} um moved"
    bounce = found["bounce"]["bounce_error"]
    verdicts = [
        Verdict("trials: every step certified", f"{unsolved} not solved", "0", unsolved == 0),
        Verdict(
            "trials: creep, slope and held",
            f"{1e6 * creep:.1e} um/s",
            f"< {1e6 * _trials.CREEPS:g} um/s",
            all(passed[name] is True for name in ("creep, slope", "creep, held")),
        ),
        Verdict(
            "trials: acceleration of the slides, axis and 45 deg",
            f"{100 * error:.1e} % off",
            f"< {100 * _trials.SLIDES:g} %",
            all(passed[name] is True for name in ("slide at 0 deg", "slide at 45 deg")),
        ),
        Verdict("trials: hop", f"{1e6 * hop:.1e} um", f"< {1e6 * _trials.HOPS:g} um", passed["hop"] is True),
        Verdict(
            "trials: stack of 1 kg to 10 t stands", said, f"< {1e3 * _trials.STANDS:g} mm", passed["stack"] is True
        ),
        Verdict(
            "trials: height of the bounce",
            f"{100 * bounce:+.2g} %",
            f"within {100 * _trials.SLIDES:g} %",
            passed["bounce"] is True,
        ),
    ]
    all_of = [label for label, one in numbers["passes"].items() if all(value is True for value in one.values())]
    verdicts.append(Verdict("trials: who passes every column in one setting", ", ".join(all_of) or "nobody"))
    return verdicts


def _judged(judge: Judge, model: dict[str, Any], q: Any, answers: list[dict[str, Any]]) -> dict[str, Any]:
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
        "differs": differences(judge.world, model, q, first),
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
        "overlap [mm]", "creep [um/s]", "J gained", "J change", "loop [mm]", "model", "certificate",
    ]  # fmt: skip
    rows = []
    ours = results.get(OURS, {}).get("steps_per_second")
    for label, result in results.items():
        if "error" in result:
            said = NOT_INSTALLED if result["error"] == NOT_INSTALLED else "cannot run"
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
                "" if result["creep"] is None else f"{1e6 * result['creep']:.2g}",
                f"{result['energy_gain']:.1e}",
                f"{result['energy_change']:.3g}",
                _millimetres(result["loop_gap"]),
                "differs" if result["differs"] else "same",
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
        if not label.startswith("MuJoCo") or "error" in result or result["differs"]:
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
    made, axes = _plots.figure(1, len(names), width=3.8, height=3.6)
    labels = list(dict.fromkeys(label for name in names for label in numbers["scenes"][name]["engines"]))
    color = dict(zip(dict.fromkeys(label.split()[0] for label in labels), _PALETTE, strict=False))
    for axis, name in zip(axes[0], names, strict=True):
        for k, label in enumerate(labels):
            result = numbers["scenes"][name]["engines"].get(label, {"error": ""})
            if "error" in result:
                continue
            at = result["steps_per_second"], max(1e3 * result["error_horizon"], 1e-6)
            axis.loglog(*at, "os^Dv"[k % 5], color=color[label.split()[0]], label=label)
        axis.set_title(f"{name}, {numbers['scenes'][name]['horizon']:.2f} s")
        axis.set_xlabel("steps a second")
        axis.set_ylabel("position error [mm]")
        axis.margins(x=0.15, y=0.15)
    handles = {one: handle for axis in axes[0] for handle, one in zip(*axis.get_legend_handles_labels(), strict=True)}
    made.legend(handles.values(), handles, loc="outside lower center", ncols=6, fontsize=8)
    return _plots.save(made, path)


_PALETTE = (_plots.COLORS["ours"], _plots.COLORS["paper"], _plots.COLORS["other"], "#8e44ad", "#d68910")


def _plot_trials(numbers: dict[str, Any], path: Path) -> Path:
    """Each reading by engine, on a log scale, with the bound that it is held against."""
    panels = (
        ("creep on a slope", "um/s", "slope of 20 deg", "creep", 1e6, _trials.CREEPS),
        ("creep, held at .9 mu m g", "um/s", "held at .9 mu m g", "creep", 1e6, _trials.CREEPS),
        ("slide along an axis, error", "%", "slide at 0 deg", "slide_error", 100.0, _trials.SLIDES),
        ("slide at 45 deg, error", "%", "slide at 45 deg", "slide_error", 100.0, _trials.SLIDES),
        ("hop, slide at 45 deg", "um", "slide at 45 deg", "hop", 1e6, _trials.HOPS),
        ("stack of 1 kg to 10 t, moved", "mm", "stack 1:1e4", "moved", 1e3, _trials.STANDS),
        ("bounce, error of height", "%", "bounce", "bounce_error", 100.0, _trials.SLIDES),
    )
    made, axes = _plots.figure(2, 4, 3.4, 3.4)
    labels = list(numbers["passes"])
    for axis, (title, unit, trial, key, factor, bound) in zip(axes.ravel(), panels, strict=False):
        least = 1e-3 * factor * bound  # what is less is drawn as that
        for k, label in enumerate(labels):
            result = numbers[TRIALS][trial][label]
            value = result.get(key)
            if value is None:
                said = _reading(result, key, factor)
                axis.text(2.0 * least, k, said, va="center", fontsize=7)
                continue
            color = _plots.COLORS["ours" if label == OURS else "other"]
            axis.barh(k, max(abs(factor * value), 1.5 * least), color=color)
        axis.axvline(factor * bound, color="black", linewidth=0.8, linestyle=":")
        axis.set_xscale("log")
        axis.set_xlim(left=least)
        axis.set_ylim(len(labels) - 0.5, -0.5)
        axis.set_yticks(range(len(labels)), labels, fontsize=7)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel(unit, fontsize=8)
    for axis in axes[:, 1:].ravel():
        axis.set_yticklabels([])
    axes.ravel()[-1].set_visible(False)
    made.suptitle("One setting, every trial; left of the dotted line is right", fontsize=10)
    return _plots.save(made, path)
