"""Steps a second beside MuJoCo, on the same models in the same run: the humanoid and a stack of 15 cubes."""

from __future__ import annotations

import gc
import time
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini import scenes
from signorini.experiments import _plots
from signorini.experiments._report import Options, Report, Verdict

TIME_STEP = 1e-3
TOLERANCE = 1e-6
DURATION = 2.0  # simulated [s], the scenes' own
ROUNDS, QUICK_ROUNDS = 5, 2
OURS = "ours"
#: Against MuJoCo's elliptic and accurate setting, by scene: at least so many times as fast.
GOALS = {"humanoid": {"elliptic": 1.0, "accurate": 4.0}, "15 cubes": {"accurate": 1.5}}
TALOS_GOAL = 12_000.0
TAIL_GOAL = 10.0


def cubes_mjcf(num_cubes: int = 15, edge: float = 0.2, mass: float = 1.0) -> str:
    """MuJoCo's model of a stack of equal cubes on a plane."""
    bodies = "".join(
        f'<body pos="0 0 {edge * (i + 0.5):.17g}"><freejoint/><geom type="box" size="{edge / 2} {edge / 2} {edge / 2}" '
        f'mass="{mass}" friction="0.8 0.005 0.0001"/></body>'
        for i in range(num_cubes)
    )
    return (
        f'<mujoco><worldbody><geom type="plane" size="5 5 1" friction="0.8 0.005 0.0001"/>{bodies}</worldbody></mujoco>'
    )


def run(options: Options) -> Report:
    """Each engine steps its own copy of a scene for two seconds, in turns, several rounds; medians of steps a second.

    Ours is certified at 1e-6 at every step; what MuJoCo's steps are worth is measured elsewhere (penetration is shown).
    """
    steps = round((0.5 if options.quick else DURATION) / TIME_STEP)
    rounds = QUICK_ROUNDS if options.quick else ROUNDS
    notes: list[str] = []
    versions: dict[str, str] = {}
    settings: tuple[str, ...] = ()
    try:
        import mujoco

        from signorini.engines import _mujoco_settings

        versions["MuJoCo"] = mujoco.__version__
        settings = _mujoco_settings.SETTINGS
    except ImportError:
        notes.append("MuJoCo is missing (pip install 'signorini[mjcf]'): ours alone")
    numbers: dict[str, Any] = {"time_step": TIME_STEP, "tolerance": TOLERANCE, "steps": steps, "scenes": {}}
    rows: list[list[str]] = []
    verdicts: list[Verdict] = []
    all_scenes = _scenes(notes)
    work = len(all_scenes) * rounds
    for index, (name, (start, mjcf)) in enumerate(all_scenes.items()):
        runs: dict[str, list[dict[str, Any]]] = {OURS: []}
        engines = settings if mjcf is not None else ()
        for setting in engines:
            runs[f"MuJoCo {setting}"] = []
        for k in range(rounds):
            options.progress(index * rounds + k, work, name)
            gc.collect()
            runs[OURS].append(_ours(start, steps))
            for setting in engines:
                assert mjcf is not None
                runs[f"MuJoCo {setting}"].append(_mujoco(mjcf, setting, start, steps))
        median = {key: float(np.median([one["steps_per_second"] for one in many])) for key, many in runs.items()}
        ours = runs[OURS][0]
        numbers["scenes"][name] = {"runs": runs, "median_steps_per_second": median}
        tail = float(np.median([one["p99_9"] / one["p50"] for one in runs[OURS]]))
        for key, many in runs.items():
            rows.append(
                [
                    name,
                    key,
                    f"{median[key]:.0f}",
                    "" if key == OURS else f"{median[OURS] / median[key]:.2f}",
                    "" if key != OURS else f"{many[0]['worst_relative']:.0e}",
                    f"{many[0]['penetration']:.0e}",
                ]
            )
        verdicts.append(
            Verdict(
                f"{name}: every step certified", f"{ours['unsolved']} of {steps} not solved", "0", ours["unsolved"] == 0
            )
        )
        verdicts.append(Verdict(f"{name}: 99.9th percentile over median", f"{tail:.1f}", "< 10", tail < TAIL_GOAL))
        for setting, goal in GOALS.get(name, {}).items():
            if f"MuJoCo {setting}" in median:
                ratio = median[OURS] / median[f"MuJoCo {setting}"]
                verdicts.append(
                    Verdict(f"{name}: over MuJoCo {setting}", f"{ratio:.2f}", f">= {goal:g}", ratio >= goal)
                )
        if name == "talos-fall":
            verdicts.append(
                Verdict(f"{name}: steps a second", f"{median[OURS]:.0f}", "> 12 000", median[OURS] > TALOS_GOAL)
            )
    options.progress(work, work, "")
    columns = ["scene", "engine", "steps/s", "ours over it", "certificate", "overlap [m]"]
    report = Report("stepping", numbers, verdicts, {"Steps a second": (columns, rows)}, notes)
    if _plots.available():
        report.files.append(_plot(numbers, options.output / "stepping.png"))
    report.write(options, versions)
    return report


def _scenes(notes: list[str]) -> dict[str, tuple[scenes.Start, str | None]]:
    """Name -> (our start, the same as MJCF text or path)."""
    found: dict[str, tuple[scenes.Start, str | None]] = {}
    known = scenes.worlds()
    try:
        from signorini.scenes._worlds import gymnasium_file

        found["humanoid"] = (known["humanoid"](), gymnasium_file("humanoid.xml").read_text())
    except (ImportError, OSError, signorini.InvalidInputError) as error:
        notes.append(f"humanoid left out: {error}")
    found["15 cubes"] = (known["cube-stack"](mass_ratio=1.0), cubes_mjcf())
    try:
        found["talos-fall"] = (known["talos-fall"](), None)
    except (ImportError, OSError, signorini.InvalidInputError) as error:
        notes.append(f"talos-fall left out: {error}")
    return found


def _ours(start: scenes.Start, steps: int) -> dict[str, Any]:
    simulator = signorini.Simulator(start.world, time_step=TIME_STEP, tolerance=TOLERANCE)
    simulator.state.q, simulator.state.v = start.q, start.v
    began = time.perf_counter()
    trace = simulator.run(steps)
    elapsed = time.perf_counter() - began
    p50, p99, p99_9 = np.percentile(trace.seconds, [50.0, 99.0, 99.9])
    return {
        "steps_per_second": steps / elapsed,
        "p50": p50,
        "p99": p99,
        "p99_9": p99_9,
        "unsolved": int(steps - trace.solved.sum()),
        "worst_relative": float(trace.relative.max()),
        "factorizations": float(trace.factorizations.mean()),
        "contacts": float(trace.num_contacts.mean()),
        "penetration": float(trace.penetration.max()),
        "state_hash": simulator.state_hash,
    }


def _mujoco(mjcf: str, setting: str, start: scenes.Start, steps: int) -> dict[str, Any]:
    import mujoco

    from signorini.engines import _mujoco_settings

    model = mujoco.MjModel.from_xml_string(mjcf)
    _mujoco_settings.apply(model, setting, TIME_STEP)
    data = mujoco.MjData(model)
    data.qpos[:] = _mujoco_q(start)
    block, penetration, elapsed = 50, 0.0, 0.0
    for first in range(0, steps, block):
        began = time.perf_counter()
        mujoco.mj_step(model, data, nstep=min(block, steps - first))
        elapsed += time.perf_counter() - began
        if data.ncon:
            penetration = max(penetration, -float(np.min(data.contact.dist[: data.ncon])))
    return {"steps_per_second": steps / elapsed, "penetration": penetration}


def _mujoco_q(start: scenes.Start) -> Any:
    """Our q in MuJoCo's order of joints and of quaternions (w x y z); bodies in the order of the file, as ours."""
    q = np.array(start.q)
    for joint in start.world.joints:
        if joint.num_q == 7:
            at = joint.q_index + 3
            q[at : at + 4] = np.roll(q[at : at + 4], 1)
        elif joint.num_q == 4:
            q[joint.q_index : joint.q_index + 4] = np.roll(q[joint.q_index : joint.q_index + 4], 1)
    return q


def _plot(numbers: dict[str, Any], path: Path) -> Path:
    names = list(numbers["scenes"])
    made, axes = _plots.figure(1, len(names))
    for axis, name in zip(axes[0], names, strict=True):
        median = numbers["scenes"][name]["median_steps_per_second"]
        colors = [_plots.COLORS["ours" if key == OURS else "other"] for key in median]
        axis.barh(list(median), list(median.values()), color=colors)
        axis.invert_yaxis()
        axis.set_title(name)
        axis.set_xlabel("steps a second")
    return _plots.save(made, path)
