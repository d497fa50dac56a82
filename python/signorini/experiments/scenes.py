"""Every ready scene, heaps of up to 10 000 bodies too: steps a second, contacts, certificates, overlaps."""

from __future__ import annotations

import time
from typing import Any

import signorini
from signorini import scenes
from signorini.experiments._report import Options, Report, Verdict

TIME_STEP = 1e-3
TOLERANCE = 1e-6
QUICK_SHARE = 0.05  # of the simulated time
QUICK_SIZE = 100  # bodies, at most
#: Scene, options, simulated time [s]; solo-terrain is the experiment `walking`.
RUNS: tuple[tuple[str, dict[str, Any], float], ...] = (
    ("cube-stack", {}, 2.0),
    ("cube-wall", {}, 3.0),
    ("humanoid", {}, 2.0),
    ("talos-fall", {}, 2.0),
    ("talos-wall", {}, 2.0),
    ("ur5", {}, 2.0),
    ("ur5-wall", {}, 2.0),
    ("cassie", {}, 2.0),
    ("allegro-cubes", {}, 5.0),
    ("allegro-cubes", {"task": 1}, 5.0),
    ("chain", {}, 2.0),
    ("chain", {"size": 100}, 2.0),
    ("chain", {"size": 1000}, 1.0),
    ("cable", {}, 2.0),
    ("cable", {"size": 100}, 2.0),
    ("cable", {"size": 1000}, 1.0),
    *((name, {"size": 10}, 2.0) for name in ("spheres", "boxes", "capsules-box")),
    *((name, {"size": 100}, 2.0) for name in ("spheres", "boxes", "capsules-box")),
    ("spheres", {"size": 1000}, 0.38),
    ("boxes", {"size": 1000}, 0.72),
    ("capsules-box", {"size": 1000}, 0.8),
    ("spheres", {"size": 10_000}, 0.32),
    ("boxes", {"size": 10_000}, 0.6),
    ("capsules-box", {"size": 10_000}, 0.6),
)


def run(options: Options) -> Report:
    """Each of RUNS once, with its controller where it has one (quick: a short while of the smaller ones)."""
    rows, verdicts, notes, numbers = [], [], [], []
    chosen = [one for one in RUNS if not options.quick or one[1].get("size", 0) <= QUICK_SIZE]
    for k, (name, changes, duration) in enumerate(chosen):
        title = " ".join([name, *(f"{key}={value}" for key, value in changes.items())])
        options.progress(k, len(chosen), title)
        steps = round((QUICK_SHARE if options.quick else 1.0) * duration / TIME_STEP)
        try:
            one = _run(name, changes, steps)
        except (ImportError, OSError, signorini.InvalidInputError) as error:
            notes.append(f"{title} left out: {error}")
            continue
        numbers.append({"scene": name, "options": changes, "duration": steps * TIME_STEP, **one})
        rows.append(
            [
                f"{title}, {steps * TIME_STEP:g} s",
                str(one["bodies"]),
                f"{one['contacts_mean']:.0f}, {one['contacts_most']}",
                f"{one['steps_per_second']:.0f}",
                f"{one['certificate']:.0e}",
                f"{one['overlap']:.0e}",
            ]
        )
        unsolved = one["unsolved"]
        verdicts.append(
            Verdict(f"{title}: every step certified", f"{unsolved} of {steps} not solved", "0", unsolved == 0)
        )
    options.progress(len(chosen), len(chosen), "")
    columns = [
        "scene",
        "bodies",
        "contacts, mean and most",
        "steps a second",
        "worst certificate",
        "deepest overlap [m]",
    ]
    notes.append("bodies: those with mass; steps a second: of processor time, a controller included")
    report = Report("scenes", {"time_step": TIME_STEP, "runs": numbers}, verdicts, {"Scenes": (columns, rows)}, notes)
    report.write(options, {})
    return report


def _run(name: str, changes: dict[str, Any], steps: int) -> dict[str, Any]:
    scene = scenes.worlds()[name]
    start = scene(**changes)
    simulator = signorini.Simulator(start.world, time_step=TIME_STEP, tolerance=TOLERANCE)
    simulator.state.q, simulator.state.v = start.q, start.v
    controller = scene.controller(simulator, start, changes) if scene.controller is not None else None
    began = time.process_time()
    trace = simulator.run(steps, controller=controller)
    seconds = time.process_time() - began
    return {
        "bodies": sum(body.mass > 0.0 for body in start.world.bodies),
        "contacts_mean": float(trace.num_contacts.mean()),
        "contacts_most": int(trace.num_contacts.max()),
        "steps_per_second": steps / seconds,
        "certificate": float(trace.relative.max()),
        "overlap": float(trace.penetration.max()),
        "unsolved": int(steps - trace.solved.sum()),
    }
