"""Tables III and IV: how often the penalty moves, and what it costs, for the linear and the spectral rule."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

import signorini
from signorini.experiments import _paper, _plots
from signorini.experiments._data import data_directory, problem_files
from signorini.experiments._report import Options, Report, RunLog, Verdict, build_id, summary
from signorini.experiments._runs import PAPER_SETTINGS, measure, ours

TOLERANCE = 1e-4
MAX_ITERATIONS = 20000
_NEVER = 1e-15  # of the certificate: only the paper's own test (43) stops
# What the paper leaves open, for p = 0.05: the tolerance of (43), the tube alpha, the exponent to start from.
_OPEN = tuple(itertools.product((1e-4, 1e-6), (10.0, 30.0, 100.0), (0.2, 0.25)))
_FEWEST = (1e-4, 100.0, 0.2)
_COLUMNS = ["rule", "updates", "paper", "ms", "paper (M1 Max)", "reach (43)", "median cert.", "worst cert."]


@dataclass(frozen=True)
class _Case:
    """One way to run the paper's ADMM."""

    name: str
    settings: dict[str, Any]
    column: int  # of the paper's tables


def _rules() -> list[_Case]:
    cases = []
    for column, (rule, parameter) in enumerate(_paper.RULES):
        linear = rule == "linear"
        settings = {"penalty_rule": rule, "linear_factor" if linear else "spectral_increment": parameter}
        name = f"tau = {parameter:g}" if linear else f"p = {parameter:g}"
        cases.append(_Case(name, {**settings, "paper_tolerance": TOLERANCE}, column))
    return cases


def _open_name(tolerance: float, alpha: float, start: float) -> str:
    return f"{tolerance:.0e}, alpha = {alpha:g}, from {start:g}"


def _open_choices() -> list[_Case]:
    column = _paper.RULES.index(("spectral", 0.05))
    return [
        _Case(
            _open_name(tolerance, alpha, start),
            {"spectral_increment": 0.05, "paper_tolerance": tolerance, "ratio": alpha, "spectral_exponent": start},
            column,
        )
        for tolerance, alpha, start in _OPEN
    ]


def run(options: Options) -> Report:
    """The paper's ADMM as written, without scaling or acceleration, stopped by (43) at 1e-4 or after 20 000 iterations,
    once with each rule, and the spectral one with p = 0.05 for several choices of what the paper leaves open. Cholesky
    updates are factorisations after the first."""
    data = data_directory(options.data)
    wanted = options.families or tuple(_paper.FAMILIES)
    files = problem_files(data, wanted, options.step(25))
    rules, choices = _rules(), _open_choices()
    runners = [
        ours(case.name, "admm", _NEVER, max_iterations=MAX_ITERATIONS, **{**PAPER_SETTINGS, **case.settings})
        for case in rules + choices
    ]
    setting = {
        "build": build_id(),
        "limit": MAX_ITERATIONS,
        "cases": {case.name: case.settings for case in rules + choices},
    }
    log = RunLog(options.output / "updates.runs.jsonl", setting, options.fresh)
    work = [(family, path) for family in wanted for path in files[family]]
    for done, (family, path) in enumerate(work):
        key = f"{family}/{path.stem}"
        options.progress(done, len(work), key)
        if key not in log:
            log.add(key, {"runs": measure(signorini.fclib.read(path), runners)})
    options.progress(len(work), len(work), "")

    numbers: dict[str, Any] = {"tolerance": TOLERANCE, "max_iterations": MAX_ITERATIONS, "families": {}}
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    for family in wanted:
        items = [log.items[f"{family}/{path.stem}"] for path in files[family]]
        results = {case.name: _result(case, family, items) for case in rules + choices}
        numbers["families"][family] = {"problems": len(items), "rules": results}
        tables[f"{family}: {len(items)} problems"] = (_COLUMNS, [_row(name, one) for name, one in results.items()])
    families = numbers["families"]
    tables = {
        f"Updates at {TOLERANCE:.0e}, ours / paper's": _all_families(families, [case.name for case in rules]),
        "p = 0.05: tolerance, alpha, start": _all_families(families, [case.name for case in choices]),
        **tables,
    }
    report = Report("updates", numbers, [v for family in wanted for v in _verdicts(family, families[family])], tables)
    report.notes.append("Other problems than FCLIB's own and another processor: compare the rules with each other.")
    report.notes.append("The paper does not say at which tolerance, alpha and start its tables were made.")
    report.write(options, {})
    if _plots.available():
        report.files.append(_plot(options, numbers, [case.name for case in rules]))
    return report


def _result(case: _Case, family: str, items: list[dict[str, Any]]) -> dict[str, Any]:
    runs = [item["runs"][case.name] for item in items]
    none = [(np.nan, np.nan)] * len(_paper.RULES)
    return {
        "updates": summary([one["factorizations"] - 1 for one in runs]),
        "milliseconds": summary([1e3 * one["seconds"] for one in runs]),
        "iterations": summary([one["iterations"] for one in runs]),
        "relative": summary([one["relative"] for one in runs]),
        "share_stopped_by_43": float(np.mean([one["iterations"] < MAX_ITERATIONS for one in runs])),
        "paper_updates": _paper.UPDATES.get(family, none)[case.column],
        "paper_milliseconds": _paper.MILLISECONDS.get(family, none)[case.column],
    }


def _row(name: str, one: dict[str, Any]) -> list[str]:
    updates, milliseconds, relative = one["updates"], one["milliseconds"], one["relative"]
    return [
        name,
        f"{updates['mean']:.2f} ± {updates['std']:.2f}",
        "{:g} ± {:g}".format(*one["paper_updates"]),
        f"{milliseconds['mean']:.3g} ± {milliseconds['std']:.3g}",
        "{:g} ± {:g}".format(*one["paper_milliseconds"]),
        f"{100 * one['share_stopped_by_43']:.1f} %",
        f"{relative.get('median', np.nan):.1e}",
        f"{relative.get('max', np.nan):.1e}",
    ]


def _verdicts(family: str, numbers: dict[str, Any]) -> list[Verdict]:
    verdicts: list[Verdict] = []
    if family not in _paper.UPDATES:
        return verdicts
    for name in (_open_name(*_FEWEST), _open_name(1e-6, 10.0, 0.25)):
        updates, (mean, deviation) = numbers["rules"][name]["updates"], numbers["rules"][name]["paper_updates"]
        verdicts.append(
            Verdict(
                f"{family}: mean Cholesky updates, spectral p = 0.05, at or below the paper's, at {name}",
                f"{updates['mean']:.2f} ± {updates['std']:.2f}",
                f"{mean:g} ± {deviation:g}",
                updates["mean"] <= mean,
            )
        )
    return verdicts


def _all_families(families: dict[str, Any], names: list[str]) -> tuple[list[str], list[list[str]]]:
    rows = []
    for name in names:
        row = [name]
        for family in families.values():
            one = family["rules"][name]
            ours, (mean, deviation) = one["updates"], one["paper_updates"]
            paper = f" / {mean:.1f} ± {deviation:.1f}" if np.isfinite(mean) else ""
            row.append(f"{ours['mean']:.1f} ± {ours['std']:.1f}{paper}")
        rows.append(row)
    return ["", *(f"{name} ({family['problems']})" for name, family in families.items())], rows


def _plot(options: Options, numbers: dict[str, Any], names: list[str]) -> Any:
    families = list(numbers["families"])
    figure, axes = _plots.figure(2, len(families), 4.2, 2.8)
    x = np.arange(len(names))
    for column, family in enumerate(families):
        rules = [numbers["families"][family]["rules"][name] for name in names]
        for row, (mine, theirs, label) in enumerate(
            (("updates", "paper_updates", "Cholesky updates"), ("milliseconds", "paper_milliseconds", "time [ms]"))
        ):
            axis = axes[row][column]
            axis.bar(x - 0.2, [r[mine]["mean"] for r in rules], 0.38, color=_plots.COLORS["ours"], label="ours")
            axis.bar(x + 0.2, [r[theirs][0] for r in rules], 0.38, color=_plots.COLORS["paper"], label="paper")
            axis.set_yscale("log")
            axis.set_xticks(x, names, rotation=35, fontsize=7)
            axis.set_title(f"{family}: mean {label}", fontsize=9)
    axes[0][0].legend(fontsize=8)
    figure.suptitle("As Tables III and IV; other problems of the same description, another processor", fontsize=9)
    return _plots.save(figure, options.output / "updates.png")
