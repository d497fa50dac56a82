"""signorini solve: problem files in, a table or JSON of certificates out."""

from __future__ import annotations

import sys
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

import signorini
from signorini.cli._output import check_outputs, finite, printer, report, write_json

Result = dict[str, Any]
COLUMNS = {
    "primal": "primal",
    "dual": "dual",
    "complementarity": "complem.",
    "relative": "relative",
    "against_free_velocity": "over g",
}


class Solver(str, Enum):
    AUTO = "auto"
    ADMM = "admm"
    PGS = "pgs"
    INTERIOR_POINT = "interior-point"
    NEWTON = "newton"
    LCP_PGS = "lcp-pgs"
    CONVEX_NEWTON = "convex-newton"
    BISECTION = "bisection"


class Law(str, Enum):
    NCP = "ncp"
    CCP = "ccp"


class PenaltyRule(str, Enum):
    SPECTRAL = "spectral"
    LINEAR = "linear"
    RESIDUAL_BALANCING = "residual-balancing"
    CONSTANT = "constant"


class Operator(str, Enum):
    DELASSUS = "delassus"
    MASS = "mass"


def solve(
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="FCLIB files, or folders of them (*.hdf5).")],
    solver: Annotated[Solver, typer.Option(help="The method; auto chooses.")] = Solver.AUTO,
    law: Annotated[Law, typer.Option(help="Signorini and Coulomb (ncp), or its convex relaxation (ccp).")] = Law.NCP,
    tolerance: Annotated[float, typer.Option(help="On the certificate, in (0, 1).")] = 1e-6,
    max_iterations: Annotated[
        int | None, typer.Option(help="At least 1; of auto: factorizations, about. Default: the solver's own.")
    ] = None,
    penalty_rule: Annotated[PenaltyRule, typer.Option(help="How ADMM moves rho.")] = PenaltyRule.RESIDUAL_BALANCING,
    facets: Annotated[int, typer.Option(help="Sides of lcp-pgs' friction pyramid: even, 4 to 64.")] = 4,
    impedance: Annotated[
        float, typer.Option(help="Of convex-newton: d, in [0.001, 1 - 1e-6]; its compliance is (1 - d) / d.")
    ] = 0.9,
    operator: Annotated[
        Operator | None, typer.Option(help="Explicit matrix or mass matrix; default: what the file holds.")
    ] = None,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE|-", help="Write JSON to FILE, or to standard output.")
    ] = None,
) -> None:
    """Solve contact problems and certify the answers.

    Exit status: 0 when all are solved, 1 when one is not, 2 on bad input.
    """
    errors = printer(stderr=True)
    options: dict[str, Any] = {
        "solver": solver.value,
        "law": law.value,
        "tolerance": tolerance,
        "max_iterations": max_iterations,
        "penalty_rule": penalty_rule.value,
        "facets": facets,
        "impedance": impedance,
    }
    try:  # a bad option is one error, not one a file
        signorini.solve(signorini.ContactProblem(np.zeros((0, 0)), [], []), **options)
    except signorini.InvalidInputError as error:
        report(errors, error)
        raise typer.Exit(2) from None
    paths, bad_input = _expand(files, errors)
    try:
        check_outputs({"--json": json_file}, paths)
    except signorini.InvalidInputError as error:
        report(errors, error)
        raise typer.Exit(2) from None
    results: list[Result] = []
    with Progress(
        TextColumn("solving"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
        console=errors,
        transient=True,
    ) as progress:
        task = progress.add_task("", total=len(paths))
        for path in paths:
            progress.update(task, description=path.stem)
            try:
                problem = signorini.fclib.read(path, operator.value if operator else None)
                results.append(_result(problem, signorini.solve(problem, **options)))
            except (signorini.InvalidInputError, OSError) as error:
                bad_input = True
                missing = isinstance(error, FileNotFoundError)
                report(errors, f"{path}: there is no such file" if missing else error)
            progress.advance(task)

    if json_file is not None:
        content = {"version": signorini.__version__, "results": results}
        bad_input |= not write_json(json_file, content, errors)
    if json_file != "-" and results:
        _print_table(results, tolerance)
    if bad_input:
        raise typer.Exit(2)
    raise typer.Exit(0 if all(result["status"] == "solved" for result in results) else 1)


def _expand(files: list[Path], errors: Console) -> tuple[list[Path], bool]:
    paths, bad = [], False
    for file in files:
        found = sorted(file.glob("*.hdf5")) if file.is_dir() else [file]
        if not found:
            report(errors, f"{file}: holds no *.hdf5 files")
            bad = True
        paths += found
    return paths, bad


def _print_table(results: list[Result], tolerance: float) -> None:
    table = Table(title="certificates")
    table.add_column("problem")
    table.add_column("solver")
    table.add_column("status")
    for column in ("contacts", "iterations", "factorizations", "ms", *COLUMNS.values()):
        table.add_column(column, justify="right")
    solved = 0
    for result in results:
        status = result["status"]
        solved += status == "solved"
        table.add_row(
            result["name"],
            result["solver"],
            Text(status, style="" if status == "solved" else "red"),
            str(result["num_contacts"]),
            str(result["iterations"]),
            str(result["factorizations"]),
            f"{1e3 * result['seconds']:.2f}",
            *("nan" if (value := result["residual"][key]) is None else f"{value:.1e}" for key in COLUMNS),
        )
    # Into a file or a pipe: as wide as the table needs, nothing cut off.
    console = printer() if sys.stdout.isatty() else printer(width=200)
    console.print(table)
    console.print(f"{solved} of {len(results)} solved")
    unbounded = [result["name"] for result in results if _grows_without_bound(result, tolerance)]
    if unbounded:
        console.print(f"perhaps without solution (impulses grow without bound): {', '.join(unbounded)}")


def _grows_without_bound(result: Result, tolerance: float) -> bool:
    relative = result["residual"]["relative"]
    return result["status"] != "solved" and relative is not None and relative <= tolerance


def _result(problem: signorini.ContactProblem, solution: signorini.Solution) -> Result:
    residual = solution.residual.to_dict()
    return {
        "name": problem.name,
        "num_contacts": problem.num_contacts,
        "solver": solution.solver,
        "status": solution.status,
        "iterations": solution.iterations,
        "factorizations": solution.factorizations,
        "seconds": solution.seconds,
        "residual": {key: finite(residual[key]) for key in COLUMNS},
        "model_residual": finite(solution.model_residual),
        "asymmetry": finite(problem.asymmetry),
    }
