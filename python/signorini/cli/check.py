"""signorini check: what of a robot file was loaded, what was not, and whether it can be simulated."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console
from rich.table import Table

import signorini
from signorini.cli._output import check_outputs, finite, printer, report, write_json
from signorini.load import Loaded, _inertia, assemble
from signorini.load._ground import NOTHING_TOUCHES, add_touching_ground
from signorini.load._options import Options

Array = npt.NDArray[np.float64]

DT = 1e-3  # [s] of the first step
OVERLAP = 1e-3  # [m] at the start, up to which a file is fine
CONDITION = 1e10  # of the mass matrix, with ones on its diagonal: beyond, rounding eats the tolerance
MAX_ROWS = 3000  # of a contact problem whose eigenvalues are asked for


def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A robot file (URDF, MJCF, SDF).")],
    ground: Annotated[bool, typer.Option("--ground", help="Add a floor that the lowest point just touches.")] = False,
    floating: Annotated[
        bool | None,
        typer.Option(
            "--floating/--fixed", help="URDF, SDF files: free or fixed base; default: fixed (URDF), the file's (SDF)."
        ),
    ] = None,
    package_dir: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER", help="Holds the packages of package:// paths, or is one; may be given several times."
        ),
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Warnings are problems too.")] = False,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE|-", help="Write JSON to FILE, or to standard output.")
    ] = None,
) -> None:
    """Load a robot file; look at its masses, hulls, overlaps and the first contact problem.

    Exit status: 0 when all is well, 1 when there are problems, 2 when it cannot be loaded.
    """
    errors = printer(stderr=True)
    try:
        check_outputs({"--json": json_file}, [file])
        options = Options(floating_base=floating, package_dirs=tuple(package_dir or ()), repair_inertia=True)
        result = {"version": signorini.__version__, "file": str(file), **inspect(assemble(file, options), ground)}
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None
    if json_file is not None and not write_json(json_file, result, errors):
        raise typer.Exit(2)
    if json_file != "-":
        _print(result, errors)
    raise typer.Exit(1 if result["problems"] or (strict and result["warnings"]) else 0)


def inspect(loaded: Loaded, ground: bool = False) -> dict[str, Any]:
    """What --json writes, but version and file. warnings: what is not carried over; problems: what is wrong."""
    world, height = loaded.world, None
    if ground:
        height = add_touching_ground(loaded.builder, world, loaded.added.file.name)
        world = loaded.builder.build()
    bodies = [_body(body) for body in world.bodies[1:] if body.mass > 0.0]
    moving = {world.bodies[index].frame for index in range(1, len(world.bodies))} - {world.bodies[0].frame}
    problems = [
        f'body "{name}": no body can have the inertia that the file gives it; load(..., repair_inertia=True) mends this'
        for name in loaded.added.mended
    ]
    for body in world.bodies[1:]:
        fault = _inertia.fault(_inertia.Inertia(body.mass, body.center, body.inertia))
        if fault is not None and body.frame in moving and body.name not in loaded.added.mended:
            problems.append(f'body "{body.name}": {fault}')
    overlaps = [
        {"a": world.geometries[a].name, "b": world.geometries[b].name, "overlap_m": -distance}
        for a, b, distance in world.touching_pairs()
        if distance < -OVERLAP
    ]
    problems += [f'"{o["a"]}" and "{o["b"]}" overlap by {1e3 * o["overlap_m"]:.3g} mm at the start' for o in overlaps]
    simulator = signorini.Simulator(world, time_step=DT)
    condition, weakest = _condition(simulator.mass_matrix)
    if not condition < CONDITION:
        named = {joint.name for joint in world.joints for v in weakest if 0 <= v - joint.v_index < joint.num_v}
        problems.append(
            f"the mass matrix has condition {condition:.1e}: masses or inertias out of all proportion, mostly on "
            + ", ".join(f'"{name}"' for name in sorted(named))
        )
    simulator.step()
    first = _first_step(simulator)
    if first["status"] != "solved":
        problems.append(f"the first step is not solved: {first['status']}, certificate {first['relative']}")
    return {
        "bodies": bodies,
        "total_mass_kg": float(sum(body["mass_kg"] for body in bodies)),
        "joints": [_joint(joint) for joint in world.joints],
        "num_q": world.num_q,
        "num_v": world.num_v,
        "actuators": [_actuator(world, actuator) for actuator in world.actuators],
        "constraints": len(world.constraints),
        "geometries": dict(Counter(g.shape.type.name for g in world.geometries)),
        "hulls": [_hull(world.geometries[index], hull) for index, hull in loaded.added.hulls.items()],
        "ground_m": height,
        "mass_matrix_condition": finite(condition),
        "overlaps": overlaps,
        "first_step": first,
        "warnings": list(world.warnings),
        "problems": problems,
    }


def _body(body: Any) -> dict[str, Any]:
    moments = np.linalg.eigvalsh(body.inertia)
    others = float(moments[0] + moments[1])
    return {
        "name": body.name,
        "mass_kg": float(body.mass),
        "moments_kg_m2": moments.tolist(),
        "triangle_share": float(moments[2]) / others if others > 0.0 else None,
    }


def _joint(joint: Any) -> dict[str, Any]:
    return {
        "name": joint.name,
        "type": joint.type.name,
        "lower": finite(joint.lower),
        "upper": finite(joint.upper),
    }


def _actuator(world: signorini.World, actuator: Any) -> dict[str, Any]:
    return {
        "name": actuator.name,
        "type": _drive_type(actuator),
        "acts_on": _acts_on(world, actuator),
        "control_range": [finite(actuator.control_lower), finite(actuator.control_upper)],
        "force_range": [finite(actuator.force_lower), finite(actuator.force_upper)],
    }


def _drive_type(actuator: Any) -> str:
    (_, *gain), (offset, *bias) = actuator.gain, actuator.bias
    if any(gain) or offset or actuator.activation.name != "none":
        return "general"
    return "position" if bias[0] else "velocity" if bias[1] else "motor"


def _acts_on(world: signorini.World, actuator: Any) -> str:
    if actuator.tendon >= 0:
        return f"tendon {world.tendons[actuator.tendon].name}"
    if actuator.body >= 0:
        return f"body {world.bodies[actuator.body].name}"
    return f"joint {world.joints[actuator.joint].name}"


def _hull(geometry: Any, hull: Any) -> dict[str, Any]:
    return {
        "geometry": geometry.name,
        "shape": geometry.shape.type.name,
        "mesh_points": hull.mesh_points,
        "vertices": len(hull.vertices),
        "volume_m3": hull.volume,
        "mesh_volume_m3": hull.mesh_volume,
        "added_share": hull.added,
    }


def _condition(matrix: Array) -> tuple[float, list[int]]:
    """Of a mass matrix with its units taken out: ones on the diagonal; and the velocities with most of a part in the
    motion that meets the least inertia."""
    if not len(matrix):
        return 1.0, []
    scale = 1.0 / np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix * scale * scale[:, None])
    parts = np.abs(vectors[:, 0])
    condition = float(values[-1] / values[0]) if values[0] > 0.0 else math.inf
    return condition, np.flatnonzero(parts > 0.5 * parts.max()).tolist()


def _first_step(simulator: signorini.Simulator) -> dict[str, Any]:
    """Size, rank and condition (of the part that is not singular) of G; the certificate."""
    problem, done = simulator.contact_problem(), simulator.report
    rank, condition = None if problem.size else 0, None
    if 0 < problem.size <= MAX_ROWS:
        matrix = problem.delassus
        values = np.linalg.eigvalsh(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())
        positive = values[values > 1e-12 * values[-1]]
        rank, condition = len(positive), finite(positive[-1] / positive[0]) if len(positive) else None
    return {
        "contacts": problem.num_contacts,
        "rows": problem.size,
        "rank": rank,
        "condition": condition,
        "status": done.status,
        "relative": finite(done.residual.relative),
    }


def _print(result: dict[str, Any], errors: Console) -> None:
    console = printer()
    first = result["first_step"]
    shapes = ", ".join(f"{count} {name}" for name, count in result["geometries"].items())
    floor = "none" if result["ground_m"] is None else f"z = {result['ground_m']:.6g} m"
    rows = {
        "bodies with mass": f"{len(result['bodies'])}, {result['total_mass_kg']:.4g} kg",
        "joints; values, velocities": f"{len(result['joints'])}; {result['num_q']}, {result['num_v']}",
        "actuators, equalities": f"{len(result['actuators'])}, {result['constraints']}",
        "geometries": shapes or "none",
        "floor added": floor,
        "condition of the mass matrix": _number(result["mass_matrix_condition"]),
        "pairs that overlap": str(len(result["overlaps"])),
        "first step: contacts, rows, rank": f"{first['contacts']}, {first['rows']}, {_text(first['rank'])}",
        "first step: condition": _number(first["condition"]),
        "first step: certificate": f"{first['status']}, {_number(first['relative'])}",
    }
    table = Table(title=Path(result["file"]).name, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    for key, value in rows.items():
        table.add_row(key, value)
    console.print(table)
    _table(
        console,
        ("body", "mass [kg]", "principal moments [kg m^2]", "largest over sum of the others"),
        [
            (
                body["name"],
                f"{body['mass_kg']:.4g}",
                " ".join(f"{x:.3g}" for x in body["moments_kg_m2"]),
                "-" if body["triangle_share"] is None else f"{body['triangle_share']:.3f}",
            )
            for body in result["bodies"]
        ],
    )
    _table(
        console,
        ("joint", "type", "range"),
        [(joint["name"], joint["type"], _range(joint["lower"], joint["upper"])) for joint in result["joints"]],
    )
    _table(
        console,
        ("actuator", "type", "acts on", "control", "force"),
        [
            (a["name"], a["type"], a["acts_on"], _range(*a["control_range"]), _range(*a["force_range"]))
            for a in result["actuators"]
        ],
    )
    _table(
        console,
        ("mesh of", "becomes", "points", "vertices", "volume [l]", "added"),
        [
            (
                hull["geometry"],
                hull["shape"],
                str(hull["mesh_points"]),
                str(hull["vertices"]),
                f"{1e3 * hull['volume_m3']:.4g}",
                "not closed" if hull["added_share"] is None else f"{hull['added_share']:.1%}".replace("-0.0%", "0.0%"),
            )
            for hull in result["hulls"]
        ],
    )
    for warning in result["warnings"]:
        of_option = NOTHING_TOUCHES in warning  # not of the file, which the report is about
        (errors if of_option else console).print(f"warning: {warning}", style="yellow", soft_wrap=True)
    for problem in result["problems"]:
        console.print(f"problem: {problem}", style="red", soft_wrap=True)
    count = len(result["problems"])
    console.print("no problems" if not count else f"{count} problem{'s' if count > 1 else ''}")


def _table(console: Console, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Nothing without rows; numbers to the right."""
    if not rows:
        return
    table = Table()
    for column in columns:
        words = column in ("body", "joint", "actuator", "type", "acts on", "mesh of", "becomes")
        table.add_column(column, justify="left" if words else "right")
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _range(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return "-"
    return f"{'-inf' if lower is None else f'{lower:.4g}'} to {'inf' if upper is None else f'{upper:.4g}'}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def _text(value: int | None) -> str:
    return "-" if value is None else str(value)
