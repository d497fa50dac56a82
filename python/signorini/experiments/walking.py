"""Solo12 walks under model-predictive control: up slopes and over random steps, without falling."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini.experiments import _plots
from signorini.experiments._report import Options, Report, Verdict
from signorini.scenes import worlds
from signorini.scenes._solo import LEGS, trot

DISTANCE, QUICK_DISTANCE = 5.0, 0.7  # [m], horizontal
PATIENCE = 20.0  # [s] of simulated time
LOWEST, STEEPEST = 0.12, 45.0  # of the base: [m] over the ground, [degrees] from the slope
RATE = 50.0  # [Hz]
#: Options of the scene, by name; claims are made about the first three.
SLOPE: dict[str, dict[str, Any]] = {"slope 15": {"slope": 15.0}}
STEPS = {f"steps 4 cm, seed {seed}": {"slope": 0.0, "steps": 0.04, "seed": seed} for seed in range(5)}
BOTH = {f"slope 15, steps 4 cm, seed {seed}": {"slope": 15.0, "steps": 0.04, "seed": seed} for seed in range(5)}
MORE = {
    "down 15": {"slope": -15.0},
    "slope 25": {"slope": 25.0},
    **{f"steps 8 cm, seed {seed}": {"slope": 0.0, "steps": 0.08, "seed": seed} for seed in range(5)},
    **{f"slope 15, steps 8 cm, seed {seed}": {"slope": 15.0, "steps": 0.08, "seed": seed} for seed in range(3)},
}


@dataclass
class Walk:
    """What a walk was like.

    distance: horizontal [m]. duration: simulated [s]; cpu, control_cpu: processor time of all of it, and of the
    controller [s]. lowest, highest: base over the ground [m]. steepest: angle between base and slope [degrees]. aside:
    largest distance from the middle line [m]. slip: path of sliding feet [m], all together. cone: largest |f_t| - mu
    f_n [N]. bumps: steps at which something else than a foot touched. plan_rate: quadratic programs a second [Hz];
    unsolved_plans of them; worst_residual: of their optimality conditions. torque: largest [N m]. steps: of the
    simulator, unsolved of them; worst_relative: certificate. path: (n, 5): time, x, height, tilt, speed ahead, every
    10 ms.
    """

    distance: float
    duration: float
    cpu: float
    control_cpu: float
    lowest: float
    highest: float
    steepest: float
    aside: float
    slip: float
    cone: float
    bumps: int
    plan_rate: float
    unsolved_plans: int
    worst_residual: float
    torque: float
    steps: int
    unsolved: int
    worst_relative: float
    path: Any

    @property
    def upright(self) -> bool:
        return self.lowest > LOWEST and self.steepest < STEEPEST


def walk(distance: float, *, friction: float = 0.8, **options: Any) -> Walk:
    """Walks until that far [m], fallen, or out of patience; options: of the scene `solo-terrain`."""
    world, q, v = worlds()["solo-terrain"](friction=friction, **options)
    simulator = signorini.Simulator(world)
    simulator.state.q, simulator.state.v = q, v
    control = trot(simulator, friction=friction, **options)
    terrain = control.terrain
    feet = {f"{leg}-ball" for leg in LEGS}
    heights, tilts, asides, relatives, path = [], [], [], [], []
    slip, cone, bumps, torque, control_cpu = 0.0, -math.inf, 0, 0.0, 0.0
    began = time.process_time()
    while simulator.state.time < PATIENCE:
        before = time.process_time()
        control()
        control_cpu += time.process_time() - before
        simulator.step()
        place, rotation = simulator.body_placement("base_link")
        heights.append(place[2] - terrain.height(place[0], place[1]))
        tilts.append(math.degrees(math.acos(min(1.0, float(rotation[:, 2] @ terrain.normal)))))
        asides.append(abs(place[1]))
        relatives.append(simulator.report.residual.relative)
        torque = max(torque, float(np.abs(simulator.control).max()))
        bumped = False
        for contact in simulator.contacts:
            if contact.mode == "open":
                continue
            tangent, normal = math.hypot(*contact.force_local[:2]), float(contact.force_local[2])
            cone = max(cone, tangent - friction * normal)
            bumped |= not {contact.geometry_a, contact.geometry_b} & feet
            if contact.mode == "slide":
                slip += math.hypot(*contact.velocity[:2]) * simulator.settings.time_step
        bumps += bumped
        if len(heights) % 10 == 0:
            path.append((simulator.state.time, place[0], heights[-1], tilts[-1], control.velocity[0]))
        if place[0] >= distance or heights[-1] < LOWEST or tilts[-1] > STEEPEST:
            break
    duration = simulator.state.time
    return Walk(
        distance=float(place[0]),
        duration=duration,
        cpu=time.process_time() - began,
        control_cpu=control_cpu,
        lowest=min(heights),
        highest=max(heights),
        steepest=max(tilts),
        aside=max(asides),
        slip=slip,
        cone=cone,
        bumps=bumps,
        plan_rate=control.num_plans / duration,
        unsolved_plans=control.unsolved_plans,
        worst_residual=control.worst_residual,
        torque=torque,
        steps=len(heights),
        unsolved=simulator.report.unsolved,
        worst_relative=max(relatives),
        path=np.array(path),
    )


def run(options: Options) -> Report:
    """Five metres on every terrain (quick: a shorter way, fewer terrains)."""
    distance = QUICK_DISTANCE if options.quick else DISTANCE
    every = {**SLOPE, **(dict(list(STEPS.items())[:1]) if options.quick else {**STEPS, **BOTH, **MORE})}
    walks: dict[str, Walk] = {}
    for k, (name, chosen) in enumerate(every.items()):
        options.progress(k, len(every), name)
        walks[name] = walk(distance, **chosen)
    options.progress(len(every), len(every), "")

    def claim(text: str, names: dict[str, Any]) -> list[Verdict]:
        mine = [walks[name] for name in names if name in walks]
        far = sum(w.upright and w.distance >= distance for w in mine)
        bad = sum(w.unsolved for w in mine)
        rate, plans = min(w.plan_rate for w in mine), sum(w.unsolved_plans for w in mine)
        return [
            Verdict(f"{text}: {distance:g} m without a fall", f"{far} of {len(mine)}", "all", far == len(mine)),
            Verdict(f"{text}: steps not solved", str(bad), "0", bad == 0),
            Verdict(f"{text}: plans a second", f"{rate:.0f}, {plans} not solved", ">= 50", rate >= RATE and plans == 0),
        ]

    verdicts = claim("slope of 15 degrees", SLOPE) + claim("random steps of 4 cm", STEPS)
    if not options.quick:
        verdicts += claim("both", BOTH)
    numbers = {"distance": distance, "walks": {name: asdict(w) for name, w in walks.items()}}
    notes = [
        "of all seeds: extremes; slip: mean. base: over the ground; tilt: of the trunk from the slope; aside: from the "
        "middle line; slip: path of all feet that slide; bumps: steps at which something else than a foot touches; "
        "cone: how far a force left it; real time: simulated over processor time, controller and measurement included; "
        "controller: processor time of a simulated second"
    ]
    report = Report("walking", numbers, verdicts, {"Solo12": _table(walks, distance)}, notes)
    if _plots.available():
        report.files.append(_plot(walks, options.output / "walking.png"))
    report.write(options, {})
    return report


def _table(walks: dict[str, Walk], distance: float) -> tuple[list[str], list[list[str]]]:
    """A terrain a row, all its seeds."""
    columns = [
        "terrain", "arrived", "time [s]", "base [cm]", "tilt [deg]", "aside [cm]", "slip [mm/m]", "bumps",
        "torque [N m]", "cone [N]", "plans/s", "plan residual", "not solved", "certificate", "real time",
        "controller [s]",
    ]  # fmt: skip
    rows = []
    for terrain in dict.fromkeys(name.split(", seed")[0] for name in walks):
        some = [walk for name, walk in walks.items() if name.split(", seed")[0] == terrain]
        arrived = sum(w.upright and w.distance >= distance for w in some)
        rows.append(
            [
                terrain,
                f"{arrived} of {len(some)}",
                _span([w.duration for w in some], 1),
                f"{100 * min(w.lowest for w in some):.1f} to {100 * max(w.highest for w in some):.1f}",
                f"{max(w.steepest for w in some):.1f}",
                f"{100 * max(w.aside for w in some):.1f}",
                f"{np.mean([1e3 * w.slip / max(w.distance, 1e-3) for w in some]):.1f}",
                str(sum(w.bumps for w in some)),
                f"{max(w.torque for w in some):.2f}",
                f"{max(w.cone for w in some):.0e}",
                _span([w.plan_rate for w in some], 0),
                f"{max(w.worst_residual for w in some):.0e}",
                f"{sum(w.unsolved for w in some)} of {sum(w.steps for w in some)}",
                f"{max(w.worst_relative for w in some):.0e}",
                _span([w.duration / w.cpu for w in some], 1),
                _span([w.control_cpu / w.duration for w in some], 2),
            ]
        )
    return columns, rows


def _span(values: list[float], digits: int) -> str:
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"


def _plot(walks: dict[str, Walk], path: Path) -> Path:
    made, axes = _plots.figure(1, 3)
    for axis, column, label in zip(axes[0], (2, 3, 4), ("base height [m]", "tilt [deg]", "speed [m/s]"), strict=True):
        for name in [*SLOPE, *list(STEPS)[:2]]:
            if name in walks:
                axis.plot(walks[name].path[:, 1], walks[name].path[:, column], label=name, linewidth=0.8)
        axis.set_xlabel("x [m]")
        axis.set_ylabel(label)
    axes[0][0].legend()
    return _plots.save(made, path)
