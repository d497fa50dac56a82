"""Steps a second of other people's simulators beside ours, and beside each what its steps are worth.

All run the same plain model from the same state; every state they pass through is judged by the same rulers, ours:
distances between shapes, energy, and where the bodies are, held against a run of ours with far smaller steps (_truth).
One start says little of a chaotic motion: errors are those of several, too (_starts). Small scenes with a known answer
(_trials) say what each engine gives away: creep, sliding, a heavy stack, a bounce.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini import engines, scenes
from signorini.engines import _exchange, _worker
from signorini.experiments import _plots, _starts, _trials
from signorini.experiments._report import Options, Report, Verdict
from signorini.experiments._starts import Start
from signorini.experiments._truth import EARLY, TIME_STEP, Judge, millimetres, places, reference, short

DURATION, QUICK_DURATION = 2.0, 0.5  # simulated [s]
ROUNDS, QUICK_ROUNDS = 5, 1
FINE, QUICK_FINE = 100, 20  # the reference's steps in one of ours
LIMIT, QUICK_LIMIT = 60.0, 4.0  # [s] of stepping a run
LONG = 5.0  # [s] of stepping; what takes longer is not repeated
STARTS, QUICK_STARTS = 20, 2  # beside the scene's own
LONG_START = 2.0  # [s] of stepping; what would take longer from one of them is left out
FRICTION = 0.8
SAME = 1e-5  # relative: masses that differ by less are the same (links without mass have 1e-6 kg in some engines)
GOAL_SCENES = ("ur5", "cassie", "humanoid")  # of the goal: as many steps a second as MuJoCo, at no larger error
SCENES: dict[str, dict[str, Any]] = {"ur5": {}, "cassie": {}, "humanoid": {}, "cube-stack": {"mass_ratio": 1.0}}
AT_REST = ("cube-stack",)  # ought to stay where it is: what moves there creeps
TRIALS = "trials"
OURS = "ours"
REFINED = (OURS, "MuJoCo accurate")
Table = tuple[list[str], list[list[str]]]
NOT_INSTALLED = _trials.NOT_INSTALLED


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
    options: Options,
    install: bool = False,
    only: tuple[str, ...] = (),
    only_scenes: tuple[str, ...] = (),
    refine: bool = False,
) -> Report:
    """Every scene by every engine that is there, in turns, several rounds, then from several starts, and the trials
    once; install: those that are not, from PyPI into environments of their own. only: these engines, by name;
    only_scenes: these scenes. refine: from all starts with smaller steps too, ours and MuJoCo accurate."""
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
        "starts": 1 + (QUICK_STARTS if quick else STARTS),
        "reference": {"time_step": TIME_STEP / fine},
        "friction": FRICTION,
        "scenes": {},
    }
    tables: dict[str, Table] = {}
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
        if name not in AT_REST:
            options.progress(done, work, f"{name}: other starts")
            found = _from_starts(numbers, name, model, Start(start.q, judge), runners, pythons, options, refine)
            for title, rows in found.items():
                tables[f"{name}, {title}"] = rows
        verdicts += _verdicts(name, numbers["scenes"][name], steps)
    if len(numbers["scenes"]) > 1:
        tables = {"Steps a second, and ours over it": _speeds(numbers["scenes"]), **tables}
    verdicts += _goal(numbers["scenes"])
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


def _trials_table(numbers: dict[str, Any]) -> Table:
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
    return ("+" if factor == 100.0 and value > 0.0 else "") + short(factor * value)


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


def _table(results: dict[str, dict[str, Any]]) -> Table:
    """Without the columns that nobody fills."""
    columns = [
        "engine", f"mm off at {EARLY:g} s", "mm off at the end", "1 cm off [s]", "overlap [mm]", "creep [um/s]",
        "J gained", "J change", "loop gap [mm]", "ours is faster by", "model", "certificate",
    ]  # fmt: skip
    rows = []
    ours = results.get(OURS, {}).get("steps_per_second")
    for label, result in results.items():
        if "error" in result:
            said = NOT_INSTALLED if result["error"] == NOT_INSTALLED else "cannot run"
            rows.append([label, said, *[""] * (len(columns) - 2)])
            continue
        rows.append(
            [
                label + (f" ({result['steps']} steps)" if result["stopped"] else ""),
                millimetres(result["error_early"]),
                millimetres(result["error_horizon"]),
                "never" if result["parted"] is None else f"{result['parted']:.2f}",
                millimetres(result["overlap"]),
                "" if result["creep"] is None else short(1e6 * result["creep"]),
                f"{result['energy_gain']:.2g}",
                f"{result['energy_change']:.3g}",
                millimetres(result["loop_gap"]),
                short(ours / result["steps_per_second"]) if ours and label != OURS else "",
                "differs" if result["differs"] else "same",
                f"{result['worst_certificate']:.0e}" if "worst_certificate" in result else "",
            ]
        )
    used = [k for k, column in enumerate(columns) if k < 2 or any(row[k] for row in rows)]
    return [columns[k] for k in used], [[row[k] for k in used] for row in rows]


def _speeds(scenes: dict[str, Any]) -> Table:
    rows = []
    for label in next(iter(scenes.values()))["engines"]:
        row = [label]
        for scene in scenes.values():
            theirs = scene["engines"][label].get("steps_per_second")
            ours = scene["engines"].get(OURS, {}).get("steps_per_second")
            ratio = f" ({ours / theirs:.2f})" if ours and theirs and label != OURS else ""
            row.append("" if theirs is None else f"{theirs:.0f}{ratio}")
        rows.append(row)
    return ["engine", *scenes], rows


def _from_starts(
    numbers: dict[str, Any],
    name: str,
    model: dict[str, Any],
    first: Start,
    runners: list[tuple[engines.Engine, str]],
    pythons: dict[str, str | None],
    options: Options,
    refine: bool,
) -> dict[str, Table]:
    """A scene from its own start and several more by each engine that is not slow; into its numbers: "starts". Of the
    quick ones ours and MuJoCo alone."""
    quick, scene = options.quick, numbers["scenes"][name]
    world, limit = first.judge.world, QUICK_LIMIT if quick else LIMIT
    others = _starts.draw(world, first.q, QUICK_STARTS if quick else STARTS)
    fine = QUICK_FINE if quick else FINE
    starts = [first, *_starts.prepare(world, others, numbers["duration"], fine)]
    errors: dict[str, list[_starts.Error]] = {}
    small: dict[str, list[list[_starts.Error]]] = {}
    for engine, setting in runners:
        label, python = _label(engine, setting), pythons[engine.name]
        result = scene["engines"][label]
        if python is None or "error" in result or result["stopped"] or result["differs"]:
            continue
        longest = max(start.steps for start in starts) / result["steps_per_second"]
        if longest > LONG_START or (quick and engine.name not in ("signorini", "mujoco")):
            continue
        errors[label] = _starts.errors(starts, model, (engine, setting), python, limit)
        if refine and label in REFINED:
            small[label] = [errors[label]] + [
                _starts.errors(starts, model, (engine, setting), python, n * limit, n) for n in _starts.REFINEMENTS[1:]
            ]
    horizons = [start.judge.horizon for start in starts]
    found = {label: _starts.summary(many, errors[OURS]) for label, many in errors.items()} if OURS in errors else {}
    scene["starts"] = {"horizons": horizons, "errors": errors, "summary": found, "refined": small}
    span = dict.fromkeys((f"{min(horizons):.2f}", f"{max(horizons):.2f}"))
    tables = {f"{len(starts)} starts; end: of each its own, {' to '.join(span)} s": _starts.table(found)}
    if small:
        tables[f"{len(starts)} starts, smaller steps: median mm off, and of the first start"] = _starts.refined(small)
    return tables


def _verdicts(name: str, scene: dict[str, Any], steps: int) -> list[Verdict]:
    """Every step certified; and beside each setting of MuJoCo as many steps a second at no larger error, by the median
    over the starts where there are several."""
    results = scene["engines"]
    ours = results[OURS]
    if "error" in ours:
        return [Verdict(f"{name}: ours runs", ours["error"], "", False)]
    verdicts = [
        Verdict(
            f"{name}: every step certified", f"{ours['unsolved']} of {steps} not solved", "0", ours["unsolved"] == 0
        )
    ]
    for label in _beside(scene):
        ratio, mine, theirs = _held(scene, label)
        said = f"{ratio:.2f} times the steps/s; at the end {millimetres(mine)} mm off, it {millimetres(theirs)}"
        found = scene.get("starts", {}).get("summary", {})
        if label in found:
            own, its = (millimetres(_inf(one["error_horizon"])) for one in (ours, results[label]))
            said += f" (median of {found[label]['count']} starts; the scene's own: {own} mm, it {its})"
        met = ratio >= 1.0 and _as_near(mine, theirs)
        verdicts.append(Verdict(f"{name}: steps/s of {label} or more, at no larger error", said, "both", met))
        if label in found:
            early, it = found[OURS]["early"]["median"], found[label]["early"]["median"]
            if early is not None and it is not None:
                both = f"{millimetres(early)} mm, {millimetres(it)} mm"
                near = _as_near(early, it + _starts.AS_NEAR)
                verdicts.append(
                    Verdict(f"{name}: median error at {EARLY:g} s, ours and {label}", both, "ours not larger", near)
                )
    return verdicts


def _beside(scene: dict[str, Any]) -> list[str]:
    """The settings of MuJoCo that ran the same model."""
    return [
        label
        for label, result in scene["engines"].items()
        if label.startswith("MuJoCo") and "error" not in result and not result["differs"]
    ]


def _held(scene: dict[str, Any], label: str) -> tuple[float, float, float]:
    """Our steps a second over an engine's; our error at the end and its: the medians over the starts, else of the one
    [m]; inf for one that does not get there."""
    ours, it = scene["engines"][OURS], scene["engines"][label]
    found = scene.get("starts", {}).get("summary", {})
    mine, theirs = ours["error_horizon"], it["error_horizon"]
    if label in found:
        mine, theirs = (found[key]["end"]["median"] for key in (OURS, label))
    return ours["steps_per_second"] / it["steps_per_second"], _inf(mine), _inf(theirs)


def _inf(error: float | None) -> float:
    return np.inf if error is None else error


def _as_near(mine: float, theirs: float) -> bool:
    """Of two that do not get there neither is near."""
    return bool(np.isfinite(mine)) and mine <= theirs


def _goal(scenes: dict[str, Any]) -> list[Verdict]:
    """On all of GOAL_SCENES; only where they all ran, and MuJoCo too."""
    there = {
        name: scenes[name] for name in GOAL_SCENES if name in scenes and "error" not in scenes[name]["engines"][OURS]
    }
    if len(there) < len(GOAL_SCENES) or not all(_beside(scene) for scene in there.values()):
        return []
    held = {f"{name}, {label}": _held(scene, label) for name, scene in there.items() for label in _beside(scene)}
    bad = [one for one, (ratio, mine, theirs) in held.items() if ratio < 1.0 or not _as_near(mine, theirs)]
    worse = [one for one, (ratio, mine, theirs) in held.items() if ratio < 1.0 and mine > theirs]
    said = f"{len(held) - len(bad)} of {len(held)}" + (f"; not: {'; '.join(bad)}" if bad else "")
    claim = f"at or above MuJoCo in steps/s on {', '.join(GOAL_SCENES)} at equal or better accuracy"
    return [
        Verdict(claim, said, "every setting on all", not bad),
        Verdict("settings of MuJoCo that are faster and nearer than ours, both", "; ".join(worse) or "none"),
    ]


def _plot(numbers: dict[str, Any], path: Path) -> Path:
    """Speed against error at the horizon: right and down is better."""
    names = list(numbers["scenes"])
    made, axes = _plots.figure(1, len(names), width=3.8, height=3.6)
    labels = list(dict.fromkeys(label for name in names for label in numbers["scenes"][name]["engines"]))
    color = dict(zip(dict.fromkeys(label.split()[0] for label in labels), _PALETTE, strict=False))
    for axis, name in zip(axes[0], names, strict=True):
        for k, label in enumerate(labels):
            result = numbers["scenes"][name]["engines"].get(label, {"error": ""})
            if "error" in result or result["error_horizon"] is None:
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
