"""Fig. 4: residuals by iteration on stacks of cubes of 1 to 1e4 kg, and on the fallen humanoid Talos."""

from __future__ import annotations

from typing import Any

import numpy as np

import signorini
from signorini import scenes
from signorini.experiments import _plots
from signorini.experiments._report import Options, Report, Verdict
from signorini.experiments._runs import PAPER_SETTINGS

TARGET = 1e-9  # the paper's, absolute
_NEVER = 1e-15
TALOS_STEPS = 2500  # of a millisecond; it falls, and lies


def run(options: Options) -> Report:
    """Dual residual and complementarity of the true problem at each iteration's impulse, without stop test until 1e-9:
    the paper's ADMM with its spectral and its linear rule, PGS, and ours beyond the paper (scaled and accelerated ADMM,
    interior point, auto)."""
    limit = 1000 if options.quick else 10000
    methods: dict[str, tuple[str, dict[str, Any]]] = {
        "ADMM spectral": ("admm", PAPER_SETTINGS),
        "ADMM linear": ("admm", {**PAPER_SETTINGS, "penalty_rule": "linear", "linear_factor": 2.0}),
        "PGS": ("pgs", {}),
        "ADMM scaled, Anderson": ("admm", {}),
        "interior point": ("interior-point", {}),
        "auto": ("auto", {}),
    }
    problems = {
        "stack of 15 cubes, at rest": scenes.cube_stack(15, 1e4),
        "the same, slipping at 0.5 m/s": scenes.cube_stack(15, 1e4, 0.5),
        "wall of 48 bricks, hit by a ball": scenes.wall(8, 6, 1e4),
    }
    notes = ["The paper's scenes were not published; these are steps of our own."]
    try:
        problems["Talos on the ground"] = talos()
    except (ImportError, OSError, signorini.InvalidInputError) as error:
        notes.append(f"Talos left out: {error}")
    numbers: dict[str, Any] = {"target": TARGET, "max_iterations": limit, "problems": {}}
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    verdicts: list[Verdict] = []
    total, done = len(problems) * len(methods), 0
    for title, problem in problems.items():
        curves: dict[str, Any] = {}
        rows = []
        for name, (solver, settings) in methods.items():
            options.progress(done, total, f"{title}: {name}")
            done += 1
            solution = signorini.solve(
                problem,
                solver,  # type: ignore[arg-type]
                tolerance=_NEVER,
                max_iterations=None if solver == "auto" else limit,
                record_history=True,
                **settings,
            )
            history = solution.history
            worst = np.maximum(history["dual"], history["complementarity"])
            reached = np.flatnonzero(worst <= TARGET)
            first = int(history["iteration"][reached[0]]) if reached.size else None
            factorizations = int(history["factorizations"][reached[0]]) if reached.size else None
            end = int(reached[0]) + 1 if reached.size else len(history)
            if not len(history) and max(solution.residual.dual, solution.residual.complementarity) <= TARGET:
                first, factorizations = solution.iterations, solution.factorizations  # it keeps no history
            curves[name] = {
                "iterations_to_target": first,
                "factorizations_to_target": factorizations,
                "best_dual": float(np.nanmin(history["dual"], initial=solution.residual.dual)),
                "best_complementarity": float(
                    np.nanmin(history["complementarity"], initial=solution.residual.complementarity)
                ),
                "relative": solution.residual.relative,
                "iteration": history["iteration"][:end],
                "dual": history["dual"][:end],
                "complementarity": history["complementarity"][:end],
            }
            rows.append(
                [
                    name,
                    "-" if first is None else str(first),
                    "-" if factorizations is None else str(factorizations),
                    f"{curves[name]['best_dual']:.1e}",
                    f"{curves[name]['best_complementarity']:.1e}",
                    f"{solution.residual.relative:.1e}",
                ]
            )
        numbers["problems"][title] = {"contacts": problem.num_contacts, "methods": curves}
        columns = ["method", "iterations to 1e-9", "factorisations", "best dual", "best compl.", "final relative"]
        tables[f"{title}: {problem.num_contacts} contacts"] = (columns, rows)
        spectral = curves["ADMM spectral"]["iterations_to_target"]
        linear = curves["ADMM linear"]["iterations_to_target"]
        pgs = curves["PGS"]["iterations_to_target"]
        auto = curves["auto"]["iterations_to_target"]
        theirs = "slipping" not in title  # the paper shows nothing of the kind
        verdicts += [
            Verdict(
                f"{title}: ADMM spectral reaches 1e-9",
                _said(spectral, limit),
                "the paper: it does, in fewer iterations than linear" if theirs else "",
                spectral is not None and (linear is None or spectral <= linear) if theirs else None,
            ),
            Verdict(f"{title}: ADMM linear", _said(linear, limit), "the paper: slower than spectral" if theirs else ""),
            Verdict(
                f"{title}: PGS",
                _said(pgs, limit),
                "the paper: it loops without getting there" if theirs else "",
                pgs is None if theirs else None,
            ),
            Verdict(f"{title}: ours reaches 1e-9", _said(auto, limit), met=auto is not None),
        ]
    options.progress(total, total, "")
    report = Report("convergence", numbers, verdicts, tables, notes)
    report.write(options, {})
    if _plots.available():
        report.files.append(_plot(options, numbers))
    return report


def talos() -> signorini.ContactProblem:
    """A step of scene talos-fall in which the robot lies."""
    start = scenes.worlds()["talos-fall"]()
    simulator = signorini.Simulator(start.world, time_step=1e-3)
    simulator.state.q, simulator.state.v = start.q, start.v
    simulator.step(TALOS_STEPS)
    return simulator.contact_problem()


def _said(iterations: int | None, limit: int) -> str:
    return f"not in {limit} iterations" if iterations is None else f"in {iterations} iterations"


_STYLE = {
    "ADMM spectral": (_plots.COLORS["paper"], "-"),
    "ADMM linear": (_plots.COLORS["admm"], "-"),
    "PGS": (_plots.COLORS["pgs"], "-"),
    "ADMM scaled, Anderson": ("#e59866", "-"),
    "interior point": ("#d98880", "--"),
    "auto": (_plots.COLORS["ours"], "-"),
}


def _plot(options: Options, numbers: dict[str, Any]) -> Any:
    problems = numbers["problems"]
    figure, axes = _plots.figure(len(problems), 2, 5.0, 2.8)
    for row, (title, problem) in enumerate(problems.items()):
        for column, (key, label) in enumerate(
            (("dual", "dual residual [m/s]"), ("complementarity", "complementarity [J]"))
        ):
            axis = axes[row][column]
            for name, curve in problem["methods"].items():
                color, line = _STYLE[name]
                values = np.maximum(np.asarray(curve[key], dtype=float), 1e-16)
                axis.loglog(
                    np.maximum(curve["iteration"], 1), values, color=color, linestyle=line, label=name, linewidth=1.3
                )
            axis.axhline(TARGET, color="black", linewidth=0.6, linestyle=":")
            axis.set_ylabel(label, fontsize=8)
            axis.set_title(title, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("iteration")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8)
    figure.suptitle("As the paper's Fig. 4, on scenes of ours", fontsize=9)
    return _plots.save(figure, options.output / "convergence.png")
