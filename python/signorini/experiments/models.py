"""Table I of the paper: the same scenes under every model of contact, and what each of them gives away."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import signorini
from signorini import scenes
from signorini.experiments import _plots
from signorini.experiments._report import Options, Report, Verdict

Array = npt.NDArray[np.float64]
TIME_STEP = 1e-3
TOLERANCE = 1e-6
GRAVITY = 9.81
FRICTION = 0.5
MASS, EDGE = 1.0, 0.2
SLOPE = math.radians(20.0)
SWEEPS = 1000  # of the Gauss-Seidel methods, at most
SAMPLE = 20  # every so many steps a problem is kept, on which the model's own residual is asked
STANDS = 1e-3  # the top cube has moved less than this [m]
FLOOR = 1e-5  # share of the weight of all below which a force is none: interior points are never quite zero


@dataclass(frozen=True)
class Model:
    """A row of Table I and its settings of the simulator."""

    name: str
    used_by: str
    settings: dict[str, Any] = field(default_factory=dict)


MODELS = (
    Model("LCP, 4 facets", "ODE, PhysX, DART", {"solver": "lcp-pgs", "max_iterations": SWEEPS}),
    Model("LCP, 8 facets", "", {"solver": "lcp-pgs", "facets": 8, "max_iterations": SWEEPS}),
    Model("CCP, d = .9", "MuJoCo", {"solver": "convex-newton", "impedance": 0.9}),
    Model("CCP, d = .999", "Drake (SAP)", {"solver": "convex-newton", "impedance": 0.999}),
    Model("CCP, ADMM", "rigid", {"solver": "admm", "law": "ccp"}),
    Model("NCP, PGS 50", "Bullet", {"solver": "pgs", "max_iterations": 50}),
    Model("NCP, PGS", "", {"solver": "pgs", "max_iterations": SWEEPS}),
    Model("bisection", "RaiSim", {"solver": "bisection", "max_iterations": SWEEPS}),
    Model("NCP, interior point", "Dojo", {"solver": "interior-point"}),
    Model("NCP, ADMM", "the paper", {"solver": "admm"}),
    Model("NCP, auto", "signorini", {}),
)
CCP_ADMM, BULLET, AUTO = MODELS[4].name, MODELS[5].name, MODELS[-1].name


@dataclass(frozen=True)
class Scene:
    """make() -> start. steps: full and quick. push: force on the body "block" [N]. read: the scene's own readings."""

    name: str
    make: Callable[[], scenes.Start]
    steps: tuple[int, int]
    friction: float
    push: tuple[float, float, float] | None = None
    read: Callable[[Record], dict[str, float]] = lambda record: {}


@dataclass
class Record:
    """A run: where its last body was before each step and at the end [m], (steps + 1) x 3."""

    steps: int
    positions: Array

    @property
    def velocity(self) -> Array:
        """Of the last step, mean [m/s]."""
        result: Array = (self.positions[-1] - self.positions[-2]) / TIME_STEP
        return result


def block(tilt: float = 0.0) -> scenes.Start:
    """A cube at rest on the ground; gravity tilted by `tilt` [rad] towards x."""
    builder = signorini.WorldBuilder(gravity=(GRAVITY * math.sin(tilt), 0.0, -GRAVITY * math.cos(tilt)))
    material = signorini.Material(friction=FRICTION)
    builder.add_ground(material)
    shape, inertia = signorini.Box((0.5 * EDGE, 0.5 * EDGE, 0.5 * EDGE)), MASS * EDGE**2 / 6.0 * np.eye(3)
    _add_block(builder, shape, inertia, 0.5 * EDGE, material)
    world = builder.build()
    return scenes.Start(world, world.initial_q, np.zeros(world.num_v))


def sphere() -> scenes.Start:
    """A ball that comes in flat: 2 m/s along the ground, 1 m/s down."""
    builder = signorini.WorldBuilder()
    material = signorini.Material(friction=FRICTION)
    builder.add_ground(material)
    _add_block(builder, signorini.Sphere(0.1), 4e-3 * MASS * np.eye(3), 0.15, material)
    world = builder.build()
    v = np.zeros(world.num_v)
    v[:3] = 2.0, 0.0, -1.0
    return scenes.Start(world, world.initial_q, v)


def _add_block(builder: Any, shape: Any, inertia: Array, height: float, material: Any) -> None:
    free = [signorini.Joint("block", "free")]
    builder.add_body("block", position=(0.0, 0.0, height), joints=free, mass=MASS, inertia=inertia)
    builder.add_geometry("block", shape, material=material)


def humanoid() -> scenes.Start:
    """The humanoid thrown: 3 m/s forwards, turning at 4 rad/s."""
    start = scenes.worlds()["humanoid"](height=1.3)
    start.v[:6] = 3.0, 0.0, 0.0, 0.0, 2.0, 4.0
    return start


def _slide(degrees: float) -> Scene:
    """Pushed with 1.1 mu m g: what accelerates is a tenth of mu g."""
    angle, force = math.radians(degrees), 1.1 * FRICTION * MASS * GRAVITY
    along = np.array([math.cos(angle), math.sin(angle), 0.0])

    def read(record: Record) -> dict[str, float]:
        exact = 0.1 * FRICTION * GRAVITY * record.steps * TIME_STEP
        hop = float(record.positions[-1, 2] - 0.5 * EDGE)
        return {
            "speed_error": float(np.linalg.norm(record.velocity[:2] - exact * along[:2]) / exact),
            "speed_along_error": float(record.velocity @ along / exact - 1.0),
            "speed": float(np.linalg.norm(record.velocity[:2])),
            "hop": hop,
        }

    return Scene(f"slide at {degrees:g} deg", block, (1000, 300), FRICTION, tuple(force * along), read)


def _creep(record: Record) -> dict[str, float]:
    """Speed over the second half, when all has settled [m/s]."""
    half = record.steps // 2
    moved = record.positions[-1] - record.positions[half]
    return {"creep": float(np.linalg.norm(moved[:2]) / ((record.steps - half) * TIME_STEP))}


def _stack(num_cubes: int) -> Callable[[], scenes.Start]:
    return lambda: scenes.worlds()["cube-stack"](num_cubes=num_cubes, mass_ratio=1e4, edge=EDGE, friction=FRICTION)


def _stands(record: Record) -> dict[str, float]:
    moved = record.positions[-1] - record.positions[0]
    return {"sunk": float(-moved[2]), "drift": float(np.linalg.norm(moved[:2]))}


def _all_scenes(quick: bool, notes: list[str]) -> list[Scene]:
    hold = 0.9 * FRICTION * MASS * GRAVITY
    found = [
        _slide(0.0),
        _slide(22.5),
        _slide(45.0),
        Scene("slope of 20 deg", lambda: block(SLOPE), (1000, 300), FRICTION, None, _creep),
        Scene("held at .9 mu m g", block, (1000, 300), FRICTION, (hold, 0.0, 0.0), _creep),
        Scene("stack 1:1e4", _stack(5 if quick else 15), (500, 60), FRICTION, None, _stands),
        Scene("flat ball", sphere, (300, 150), FRICTION),
    ]
    try:
        humanoid()
        found.append(Scene("humanoid", humanoid, (1500, 600), 1.0))
    except (ImportError, OSError, signorini.InvalidInputError) as error:
        notes.append(f"humanoid left out: {error}")
    return found


def run(options: Options) -> Report:
    """Every scene under every model, the same step around it: only what solves the contact problem differs."""
    notes: list[str] = []
    all_scenes = _all_scenes(options.quick, notes)
    numbers: dict[str, Any] = {
        "time_step": TIME_STEP,
        "tolerance": TOLERANCE,
        "models": {model.name: {"used_by": model.used_by, "settings": model.settings} for model in MODELS},
        "scenes": {},
    }
    for i, scene in enumerate(all_scenes):
        results = numbers["scenes"][scene.name] = {}
        for k, model in enumerate(MODELS):
            options.progress(i * len(MODELS) + k, len(all_scenes) * len(MODELS), f"{scene.name}: {model.name}")
            results[model.name] = measure(scene, model, scene.steps[options.quick])
    options.progress(1, 1, "")
    report = Report("models", numbers, _verdicts(numbers), _tables(numbers), notes)
    if _plots.available():
        report.files.append(_plot(numbers, options.output / "models.png"))
    report.write(options, {})
    return report


def measure(scene: Scene, model: Model, steps: int) -> dict[str, float]:
    """One run. Read from the contacts of each step, hence of every model alike:

    force_gap: largest gap at the end of a step in which the contact pushed [m]. penetration: deepest overlap [m].
    normal_work: energy that normal forces put in, the push out of an overlap included [J]. dissipation_error: defect of
    the friction power against mu force_N speed, summed over the run [J]. On a sample of the problems, solved anew:
    relative_median and relative_worst, the certificate of the NCP, and model_residual, the worst of the solver's own.
    iterations, microseconds: means of all steps.
    """
    start = scene.make()
    simulator = signorini.Simulator(start.world, time_step=TIME_STEP, tolerance=TOLERANCE, **model.settings)
    simulator.state.q, simulator.state.v = start.q, start.v
    if scene.push is not None:
        simulator.set_external_wrench("block", scene.push)
    top = start.world.body_names[-1]
    positions = [simulator.body_placement(top)[0]]
    weight = float(np.linalg.norm(start.world.gravity)) * sum(body.mass for body in start.world.bodies)
    force_gap = penetration = normal_work = defect = seconds = 0.0
    relative, iterations, solved = [], [], 0
    model_residual = 0.0
    settings = {key: value for key, value in model.settings.items() if key not in ("solver", "law")}
    for step in range(steps):
        began = time.perf_counter()
        simulator.step()
        seconds += time.perf_counter() - began
        for contact in simulator.contacts:
            force, velocity = contact.force_local, contact.velocity
            penetration = max(penetration, -contact.distance)
            if not force[2] > FLOOR * weight:
                continue
            force_gap = max(force_gap, contact.distance + TIME_STEP * velocity[2])
            normal_work += TIME_STEP * max(0.0, force[2] * velocity[2])
            friction_power = scene.friction * force[2] * float(np.hypot(velocity[0], velocity[1]))
            defect += TIME_STEP * abs(force[0] * velocity[0] + force[1] * velocity[1] + friction_power)
        report = simulator.report
        iterations.append(report.iterations)
        solved += report.status == "solved"
        if step % SAMPLE == SAMPLE // 2 and report.num_constraints:
            problem = simulator.contact_problem()
            solution = signorini.solve(
                problem,
                model.settings.get("solver", "auto"),
                model.settings.get("law", "ncp"),
                tolerance=TOLERANCE,
                **settings,
            )
            model_residual = max(model_residual, solution.model_residual)
            relative.append(signorini.residual(problem, solution.impulse, "ncp").relative)
        positions.append(simulator.body_placement(top)[0])
    return {
        **scene.read(Record(steps, np.array(positions))),
        "force_gap": force_gap,
        "penetration": penetration,
        "normal_work": normal_work,
        "dissipation_error": defect,
        "relative_median": float(np.median(relative)) if relative else 0.0,
        "relative_worst": max(relative, default=0.0),
        "model_residual": model_residual,
        "unsolved": steps - solved,
        "steps": steps,
        "iterations": float(np.mean(iterations)),
        "microseconds": 1e6 * seconds / steps,
    }


def creep_of_compliance(impedance: float, tangent: float, normal: float) -> float:
    """Speed at which the block creeps on its four corners under the regularised CCP [m/s]; the forces on it in [N].

    A corner that sticks moves at R lambda_T with R = (1 - d) / d 4 / m, 4 / m the mean diagonal of a corner of a cube.
    All four share the load; if the two that the push relieves slip, the others carry the rest.
    """
    relieved = 0.5 * (normal - tangent)  # on both: the push at half the edge tips the block
    share = max(0.25 * tangent, 0.5 * (tangent - FRICTION * relieved))
    return (1.0 - impedance) / impedance * 4.0 / MASS * TIME_STEP * share


def _verdicts(numbers: dict[str, Any]) -> list[Verdict]:
    results = numbers["scenes"]
    ours = {name: result[AUTO] for name, result in results.items()}
    slides = [name for name in results if name.startswith("slide")]
    slope, held = results["slope of 20 deg"], results["held at .9 mu m g"]
    creep = max(slope[AUTO]["creep"], held[AUTO]["creep"])
    error = max(ours[name]["speed_error"] for name in slides)
    hop = max(abs(ours[name]["hop"]) for name in slides)
    stack = max(abs(ours["stack 1:1e4"]["sunk"]), ours["stack 1:1e4"]["drift"])
    gap = max(result["force_gap"] for result in ours.values())
    unsolved = sum(result["unsolved"] for result in ours.values())
    verdicts = [
        Verdict(f"{AUTO}: steps not solved", f"{unsolved}", "0", unsolved == 0),
        Verdict(f"{AUTO}: creep", f"{1e6 * creep:.1e} um/s", "< 1 um/s", creep < 1e-6),
        Verdict(f"{AUTO}: speed of a sliding block, any direction", f"{100 * error:.1e} %", "< 1 %", error < 0.01),
        Verdict(f"{AUTO}: hop while sliding", f"{1e6 * hop:.1e} um", "< 10 um", hop < 1e-5),
        Verdict(f"{AUTO}: the stack stands", f"{1e6 * stack:.1e} um moved", "< 1 mm", stack < STANDS),
        Verdict(f"{AUTO}: gap across which a contact pushes", f"{1e6 * gap:.1e} um", "< 1 um", gap < 1e-6),
    ]
    for name in slides:
        run = results[name][CCP_ADMM]
        ratio = run["hop"] / (FRICTION * run["speed"] * TIME_STEP)
        verdicts.append(
            Verdict(f"{CCP_ADMM}, {name}: hop over mu v dt", f"{ratio:.4f}", "1 within 2 %", abs(ratio - 1.0) < 0.02)
        )
    loads = {
        "slope": (slope, MASS * GRAVITY * math.sin(SLOPE), MASS * GRAVITY * math.cos(SLOPE)),
        "held": (held, 0.9 * FRICTION * MASS * GRAVITY, MASS * GRAVITY),
    }
    for model in MODELS:
        impedance = model.settings.get("impedance")
        if impedance is None:
            continue
        for name, (runs, tangent, normal) in loads.items():
            measured, expected = runs[model.name]["creep"], creep_of_compliance(impedance, tangent, normal)
            verdicts.append(
                Verdict(
                    f"{model.name}, {name}: creep of the compliance",
                    f"{1e6 * measured:.2f} um/s",
                    f"{1e6 * expected:.2f} within 2 %",
                    abs(measured / expected - 1.0) < 0.02,
                )
            )
    for name, degrees in (("slide at 45 deg", 45.0), ("slide at 22.5 deg", 22.5)):
        model = MODELS[0] if degrees == 45.0 else MODELS[1]
        # Half way between two facets friction is mu / cos(pi / facets).
        expected = max(-1.0, (1.1 - 1.0 / math.cos(math.radians(degrees))) / 0.1 - 1.0)
        found = results[name][model.name]["speed_along_error"]
        verdicts.append(
            Verdict(
                f"{model.name}, {name}: speed",
                f"{100 * found:+.1f} %",
                f"{100 * expected:+.1f} % of a pyramid around the cone",
                abs(found - expected) < 0.01,
            )
        )
    own = {"convex-newton": 0.0, "lcp-pgs": 0.0, "bisection": 0.0}
    for name, runs in results.items():
        for model in MODELS:
            solver = model.settings.get("solver", "auto")
            # Gauss-Seidel is not asked where it does not arrive, whatever the model: heavy on light, the humanoid.
            if solver in own and (solver == "convex-newton" or name not in ("stack 1:1e4", "humanoid")):
                own[solver] = max(own[solver], runs[model.name]["model_residual"])
    for solver, worst in own.items():
        where = "every scene" if solver == "convex-newton" else "block and ball"
        verdicts.append(
            Verdict(f"{solver}: residual of its own model, {where}", f"{worst:.1e}", "<= 1e-6", worst <= TOLERANCE)
        )
    return verdicts


#: Title, scene, reading, factor, digits: the columns of the first table.
READINGS = (
    ("slide 0 deg [%]", "slide at 0 deg", "speed_along_error", 100.0),
    ("22.5 [%]", "slide at 22.5 deg", "speed_along_error", 100.0),
    ("45 [%]", "slide at 45 deg", "speed_along_error", 100.0),
    ("hop [um]", "slide at 0 deg", "hop", 1e6),
    ("slope [um/s]", "slope of 20 deg", "creep", 1e6),
    ("held [um/s]", "held at .9 mu m g", "creep", 1e6),
    ("ball: push at [um]", "flat ball", "force_gap", 1e6),
    ("stack: sunk [mm]", "stack 1:1e4", "sunk", 1e3),
    ("drift [mm]", "stack 1:1e4", "drift", 1e3),
    ("overlap [mm]", "stack 1:1e4", "penetration", 1e3),
)
COSTS = (
    ("push at [um]", "force_gap", 1e6),
    ("overlap [um]", "penetration", 1e6),
    ("normal work [mJ]", "normal_work", 1e3),
    ("friction defect [mJ]", "dissipation_error", 1e3),
    ("certificate", "relative_median", 1.0),
    ("worst", "relative_worst", 1.0),
    ("its own model", "model_residual", 1.0),
    ("unsolved", "unsolved", 1.0),
    ("iterations", "iterations", 1.0),
    ("us/step", "microseconds", 1.0),
)


def _number(value: float) -> str:
    """Three digits; what is below a thousandth of a unit as a power of ten."""
    if 1e3 <= abs(value) < 1e6:
        return f"{float(f'{value:.3g}'):.0f}"
    return "0" if value == 0.0 else f"{value:.3g}" if 1e-3 <= abs(value) < 1e3 else f"{value:.0e}"


def _tables(numbers: dict[str, Any]) -> dict[str, tuple[list[str], list[list[str]]]]:
    results = numbers["scenes"]
    readings = [row for row in READINGS if row[1] in results]
    rows = [
        [model.name, model.used_by]
        + [_number(factor * results[scene][model.name][key]) for _, scene, key, factor in readings]
        for model in MODELS
    ]
    tables = {"What each model gives away": (["model", "as in", *(row[0] for row in readings)], rows)}
    for scene, runs in results.items():
        rows = [
            [model.name, *(_number(factor * runs[model.name][key]) for _, key, factor in COSTS)] for model in MODELS
        ]
        tables[scene] = (["model", *(row[0] for row in COSTS)], rows)
    return tables


def _plot(numbers: dict[str, Any], path: Path) -> Path:
    results = numbers["scenes"]
    last = "humanoid" if "humanoid" in results else "stack 1:1e4"
    panels = (
        ("speed error, slide at 45 deg", "%", "slide at 45 deg", "speed_error", 100.0),
        ("hop while sliding", "um", "slide at 0 deg", "hop", 1e6),
        ("creep on a slope", "um/s", "slope of 20 deg", "creep", 1e6),
        ("overlap in the stack", "mm", "stack 1:1e4", "penetration", 1e3),
        (f"{last}: work of normal forces", "mJ", last, "normal_work", 1e3),
        (f"{last}: time of a step", "us", last, "microseconds", 1.0),
    )
    made, axes = _plots.figure(2, 3)
    names = [model.name for model in MODELS]
    colors = [_plots.COLORS["ours" if name == AUTO else "pgs" if "PGS" in name else "other"] for name in names]
    for axis, (title, unit, scene, key, factor) in zip(axes.ravel(), panels, strict=True):
        values = [max(abs(factor * results[scene][name][key]), 1e-9) for name in names]
        axis.barh(names, values, color=colors)
        if max(values) > 100.0 * min(values):
            axis.set_xscale("log")
        axis.invert_yaxis()
        axis.set_title(title)
        axis.set_xlabel(unit)
    for axis in axes[:, 1:].ravel():
        axis.set_yticklabels([])
    return _plots.save(made, path)
