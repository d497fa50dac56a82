"""Fig. 5: time per step over sequences of contact problems of four robot scenes, every solver cold and warm."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import signorini
from signorini import fclib, peers, scenes
from signorini._hardest import as_contacts
from signorini._problem import FrictionCone
from signorini.experiments import _paper, _plots
from signorini.experiments._report import Options, Report, Verdict, summary
from signorini.experiments._runs import PAPER_SETTINGS, SHORT, record, solves

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-4  # the paper's, here of the relative certificate
MAX_ITERATIONS = 1000  # the paper's
TIME_STEP = 1e-3
#: Scene -> steps that are made; Talos lands after 64.
STEPS = {"solo-terrain": 2000, "talos-fall": 2000, "allegro-cubes": 1000, "cube-stack": 500}
QUICK_STEPS = 100
REPEATS = 2  # of a solve; the least time counts, free of what else the machine did
LONG = 0.02  # [s]; what takes longer is not repeated
OURS = "auto"


@dataclass(frozen=True)
class Step:
    """The contact problem of a step. ids, frames: of its contacts in row order, (nc,) and (nc, 3, 3): columns t1, t2, n
    in the world. number: of the step, from 1."""

    problem: signorini.ContactProblem
    ids: list[int]
    frames: Array
    number: int


def record_steps(scene: str, num_steps: int, every: int = 1, **options: Any) -> Iterator[Step]:
    """Simulates a scene and hands out every `every`-th step that has a constraint at all, one at a time."""
    made = scenes.worlds()[scene]
    start = made(**options)
    simulator = signorini.Simulator(start.world, time_step=TIME_STEP)
    simulator.state.q, simulator.state.v = start.q, start.v
    controller = made.controller(simulator, start, options) if made.controller is not None else None
    for number in range(1, num_steps + 1):
        if controller is not None:
            controller()
        simulator.step()
        if number % every:
            continue
        problem = simulator.contact_problem()
        if problem.size:
            contacts = simulator.contacts
            frames = np.array([contact.frame for contact in contacts]).reshape(-1, 3, 3)
            yield Step(problem, [contact.id for contact in contacts], frames, number)


def carried(before: Step, impulse: Array, now: Step) -> Array:
    """The impulse of a step as the guess of a later one, as the simulator carries it.

    Contacts keep theirs in world axes by id, new ones start at zero; joint limits, joint friction and equalities keep
    theirs in order, limits only while there are as many (which joint a row belongs to is not in a problem).
    """
    guess = np.zeros(now.problem.size)
    rows_before, rows_now = _rows(before.problem), _rows(now.problem)
    contacts_before = dict(zip(before.ids, zip(rows_before[FrictionCone], before.frames, strict=True), strict=True))
    for identity, row, frame in zip(now.ids, rows_now[FrictionCone], now.frames, strict=True):
        if identity in contacts_before:
            old_row, old_frame = contacts_before[identity]
            guess[row : row + 3] = frame.T @ old_frame @ impulse[old_row : old_row + 3]
    for kind, rows in rows_now.items():
        if kind is not FrictionCone and len(rows) == len(rows_before.get(kind, [])):
            guess[rows] = impulse[rows_before[kind]]
    return guess


def _rows(problem: signorini.ContactProblem) -> dict[type, list[int]]:
    """First rows of the constraints of each kind."""
    out: dict[type, list[int]] = {FrictionCone: []}
    row = 0
    for constraint in problem.constraints:
        out.setdefault(type(constraint), []).append(row)
        row += 3 if isinstance(constraint, FrictionCone) else 1
    return out


@dataclass
class Solver:
    """One that takes part: solve(problem, guess) -> anything with impulse, residual, iterations, seconds."""

    name: str
    law: str
    solve: Callable[[signorini.ContactProblem, Any], Any]


def solvers(with_peers: bool = True) -> list[Solver]:
    """Ours, both ADMMs, PGS under both laws, and SCS on the CCP where it is installed. Each solver of ours has a
    workspace that it keeps from step to step, as in a simulator."""

    def own(name: str, method: str, law: Any = "ncp", **settings: Any) -> Solver:
        workspace = signorini.Workspace()

        def solve(problem: signorini.ContactProblem, guess: Any) -> Any:
            return signorini.solve(
                problem,
                method,  # type: ignore[arg-type]
                law,
                TOLERANCE,
                max_iterations=MAX_ITERATIONS,
                guess=guess,
                workspace=workspace,
                **settings,
            )

        return Solver(name, law, solve)

    def scs(problem: signorini.ContactProblem, guess: Any) -> Any:
        return peers.scs.solve_ccp(problem, TOLERANCE, MAX_ITERATIONS, None if guess is None else guess.impulse)

    listed = [
        own(OURS, "auto", aim=TOLERANCE),
        own("ADMM (paper)", "admm", **PAPER_SETTINGS),
        own("ADMM", "admm"),
        own("PGS", "pgs"),
        own("PGS, CCP", "pgs", "ccp"),
    ]
    if with_peers and any(peer.name == "scs" for peer in peers.available()):
        listed.append(Solver("SCS, CCP", "ccp", scs))
    return listed


def measure(steps: Iterator[Step], taking_part: list[Solver], repeats: int) -> list[dict[str, Any]]:
    """Every step by every solver, cold and warm, in turns: step, contacts, and runs: (solver, start) -> its record.

    Warm: from the last warm answer of the same solver.
    """
    last: dict[str, Any] = {}
    before: Step | None = None
    out = []
    for step in steps:
        jobs: list[tuple[str, Solver, Any]] = []
        for solver in taking_part:
            guess = None
            if before is not None:
                answer = last[solver.name]
                guess = replace(answer, impulse=carried(before, answer.impulse, step))  # ADMM's penalty stays
            jobs += [(f"{solver.name}, cold", solver, None), (f"{solver.name}, warm", solver, guess)]
        runs: dict[str, dict[str, Any]] = {}
        times: dict[str, list[float]] = {key: [] for key, _, _ in jobs}
        order = np.random.default_rng(step.number)
        for turn in range(repeats):
            for k in order.permutation(len(jobs)):  # nobody always comes after the same one, and its cold caches
                key, solver, guess = jobs[k]
                if turn and times[key][0] > LONG:
                    continue
                solution = solver.solve(step.problem, guess)
                if solution.seconds < SHORT:
                    solution = solver.solve(step.problem, guess)
                times[key].append(float(solution.seconds))
                if turn == 0:
                    runs[key] = record(solution)
                    if key.endswith("warm"):
                        last[solver.name] = solution
        ordered = {key: {**runs[key], "seconds": min(seconds)} for key, seconds in times.items()}
        out.append({"step": step.number, "contacts": step.problem.num_contacts, "runs": ordered})
        before = step
    return out


def write_problems(steps: Iterator[Step], folder: Path, scene: str, without: list[int]) -> Iterator[Step]:
    """Hands the steps on and writes each as folder/SCENE/STEP.hdf5.

    FCLIB has no intervals: those with joint friction or drives' limits are written without, which the file says, and
    their numbers go into `without`. Such a file is a problem of its own, of the same bodies with smooth joints.
    """
    (folder / scene).mkdir(parents=True, exist_ok=True)
    for step in steps:
        contacts, said = as_contacts(step.problem), f"{TIME_STEP:g} s a step"
        if contacts is None:
            without.append(step.number)
            contacts = as_contacts(step.problem, drop_intervals=True)
            said += "; joint friction and limits of drives left out"
        assert contacts is not None
        path = folder / scene / f"{scene}-{step.number:06d}.hdf5"
        fclib.write(path, contacts, title=path.stem, description=said)
        yield step


def run(options: Options, write_to: Path | None = None) -> Report:
    """Records each scene, solves every step as it comes, and compares medians and tails with the best of the others.

    A step that is not solved counts with the time that it took; the share solved, by the certificate of the law that a
    solver works on, stands beside. write_to: folder for the problems as FCLIB files, a folder a scene.
    """
    taking_part = solvers(options.with_peers)
    scene_steps = {name: QUICK_STEPS if options.quick else count for name, count in STEPS.items()}
    every = options.every or 1
    total = sum(scene_steps.values())
    versions = {peer.name: peer.version() for peer in peers.available() if peer.name == "scs" and options.with_peers}
    numbers: dict[str, Any] = {
        "tolerance": TOLERANCE,
        "max_iterations": MAX_ITERATIONS,
        "time_step": TIME_STEP,
        "scenes": {},
    }
    verdicts: list[Verdict] = []
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    notes = [
        _paper.said("timings"),
        "Times are of the solve alone, the least of three; percentiles are over steps. A solver that is stopped by "
        "1000 iterations or gives up counts with the time until then. solved: relative certificate at 1e-4, of the "
        "CCP for solvers of the CCP.",
        "auto is asked for 1e-4 and no more (aim=1e-4), like the others. ADMM (paper) is Algorithm 1 as written; ADMM "
        "has our scaling and acceleration.",
    ]
    if not any(solver.name.startswith("SCS") for solver in taking_part):
        notes.append("SCS does not take part (pip install 'signorini[peers]')")
    done = 0
    for scene, count in scene_steps.items():

        def watched(steps: Iterator[Step], first: int = done, scene: str = scene) -> Iterator[Step]:
            for step in steps:
                options.progress(first + step.number, total, scene)
                yield step

        without: list[int] = []
        began = time.perf_counter()
        try:
            steps = watched(record_steps(scene, count, every))
            if write_to is not None:
                steps = write_problems(steps, write_to, scene, without)
            items = measure(steps, taking_part, REPEATS)
        except (FileNotFoundError, ImportError, signorini.InvalidInputError) as error:
            notes.append(f"{scene} left out: {error}")
            done += count
            continue
        done += count
        if write_to is not None:
            notes.append(_written(scene, len(items), without))
        numbers["scenes"][scene] = {
            "steps": len(items),
            "every": every,
            "seconds": time.perf_counter() - began,
            "written_without_intervals": without,
            "solvers": _solvers(items),
            "runs": items,
        }
        contacts = [item["contacts"] for item in items]
        title = f"{scene}: {len(items)} steps, {min(contacts)}-{max(contacts)} contacts"
        tables[title] = (_COLUMNS, _table(numbers["scenes"][scene]["solvers"]))
        verdicts += _verdicts(scene, numbers["scenes"][scene]["solvers"])
    options.progress(total, total, "")
    if tables:
        tables = {"Median, 99th percentile [ms] (solved)": _all_scenes(numbers["scenes"], list(tables)), **tables}
    report = Report("timings", numbers, verdicts, tables, notes)
    report.write(options, versions)
    if _plots.available() and numbers["scenes"]:
        report.files.append(_plot(numbers["scenes"], options.output / "timings.png"))
    if write_to is not None:
        report.files.append(write_to)
    return report


def _written(scene: str, count: int, without: list[int]) -> str:
    if not without:
        return f"{scene}: all {count} problems written"
    spans: list[list[int]] = []
    for number in without:
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    said = ", ".join(f"{first}-{last}" if last > first else str(first) for first, last in spans)
    return f"{scene}: all {count} problems written, without their joint friction, which FCLIB has not: {said}"


def _solvers(items: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    out = {}
    for key in items[0]["runs"]:
        runs = [item["runs"][key] for item in items]
        out[key] = {
            "milliseconds": summary([1e3 * one["seconds"] for one in runs]),
            "share_solved": float(np.mean([solves(one, TOLERANCE) for one in runs])),
            "iterations": summary([one["iterations"] for one in runs]),
            "relative": summary([one["relative"] for one in runs]),
        }
    return out


_COLUMNS = ["solver, start", "median ms", "99 % ms", "mean ms", "solved", "median iterations", "worst cert."]


def _table(found: dict[str, dict[str, Any]]) -> list[list[str]]:
    return [
        [
            key,
            f"{one['milliseconds']['median']:.3g}",
            f"{one['milliseconds']['p99']:.3g}",
            f"{one['milliseconds']['mean']:.3g}",
            f"{100 * one['share_solved']:.1f} %",
            f"{one['iterations']['median']:.0f}",
            f"{one['relative'].get('max', np.nan):.1e}",
        ]
        for key, one in found.items()
    ]


def _all_scenes(found: dict[str, Any], titles: list[str]) -> tuple[list[str], list[list[str]]]:
    """One table of all scenes, with the share that is solved where it is not all."""
    rows = []
    for key in next(iter(found.values()))["solvers"]:
        row = [key]
        for scene in found.values():
            one = scene["solvers"][key]
            share = "" if one["share_solved"] == 1.0 else f" ({100 * one['share_solved']:.1f} %)"
            row.append(f"{one['milliseconds']['median']:.3g}, {one['milliseconds']['p99']:.3g}{share}")
        rows.append(row)
    return ["solver, start", *titles], rows


def _verdicts(scene: str, found: dict[str, dict[str, Any]]) -> list[Verdict]:
    out = []
    for start in ("cold", "warm"):
        mine = found[f"{OURS}, {start}"]
        others = {key: one for key, one in found.items() if key.endswith(start) and not key.startswith(f"{OURS},")}
        out.append(
            Verdict(
                f"{scene}, {start}: ours solves every step",
                f"{100 * mine['share_solved']:.1f} %",
                "100 %",
                mine["share_solved"] == 1.0,
            )
        )
        for key, label in (("median", "median"), ("p99", "99th percentile")):
            best = min(others, key=lambda name: others[name]["milliseconds"][key])
            ours, theirs = mine["milliseconds"][key], others[best]["milliseconds"][key]
            out.append(
                Verdict(
                    f"{scene}, {start}: {label} at or below the best of ADMM, PGS and SCS",
                    f"{ours:.3g} ms",
                    f"{theirs:.3g} ms, {best}, which solves {100 * others[best]['share_solved']:.1f} %",
                    ours <= theirs,
                )
            )
    return out


_STYLE = {
    OURS: _plots.COLORS["ours"],
    "ADMM (paper)": _plots.COLORS["paper"],
    "ADMM": _plots.COLORS["admm"],
    "PGS": _plots.COLORS["pgs"],
    "PGS, CCP": "#b2babb",
    "SCS, CCP": "#8e44ad",
}


def _plot(found: dict[str, dict[str, Any]], path: Path) -> Path:
    made, axes = _plots.figure(2, len(found), 4.0, 3.0)
    for column, (scene, numbers) in enumerate(found.items()):
        keys = list(numbers["solvers"])
        for row, start in enumerate(("cold", "warm")):
            axis = axes[row][column]
            mine = [key for key in keys if key.endswith(start)]
            times = [[1e3 * item["runs"][key]["seconds"] for item in numbers["runs"]] for key in mine]
            boxes = axis.boxplot(times, whis=(1, 99), showfliers=False, patch_artist=True, widths=0.6)
            names = [key.rsplit(", ", 1)[0] for key in mine]
            for box, name in zip(boxes["boxes"], names, strict=True):
                box.set_facecolor(_STYLE.get(name, _plots.COLORS["other"]))
            for line in boxes["medians"]:
                line.set_color("black")
            axis.set_xticks(range(1, len(names) + 1), names, rotation=30, fontsize=7, ha="right")
            axis.set_yscale("log")
            axis.set_title(f"{scene}, {start}", fontsize=10)
    for row in axes:
        row[0].set_ylabel("time of a step [ms]")
    made.suptitle(
        "As the paper's Fig. 5, on scenes of ours: quartiles, whiskers at 1 and 99 %; 1e-4, at most 1000 iterations",
        fontsize=9,
    )
    return _plots.save(made, path)
