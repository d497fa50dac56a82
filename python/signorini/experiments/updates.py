"""Tables III and IV: how often the penalty moves, and what it costs, for the linear and the spectral rule."""

from __future__ import annotations

from typing import Any

import numpy as np

import signorini
from signorini.experiments import _paper, _plots
from signorini.experiments._data import data_directory, problem_files
from signorini.experiments._report import Options, Report, RunLog, Verdict, build_id, summary
from signorini.experiments._runs import PAPER_SETTINGS, measure, ours

TOLERANCE = 1e-6
MAX_ITERATIONS = 20000
_NEVER = 1e-15  # of the certificate: only the paper's own test (43) stops


def _name(rule: str, parameter: float) -> str:
    return f"tau = {parameter:g}" if rule == "linear" else f"p = {parameter:g}"


def run(options: Options) -> Report:
    """The paper's ADMM as written, without scaling or acceleration, stopped by (43) at 1e-6 or after 20 000 iterations,
    once with each rule. Cholesky updates are factorisations after the first."""
    data = data_directory(options.data)
    wanted = options.families or tuple(_paper.FAMILIES)
    files = problem_files(data, wanted, options.step(25))
    runners = []
    for rule, parameter in _paper.RULES:
        settings: dict[str, Any] = {**PAPER_SETTINGS, "penalty_rule": rule, "paper_tolerance": TOLERANCE}
        settings["linear_factor" if rule == "linear" else "spectral_increment"] = parameter
        runners.append(ours(_name(rule, parameter), "admm", _NEVER, max_iterations=MAX_ITERATIONS, **settings))
    log = RunLog(options.output / "updates.runs.jsonl", {"build": build_id(), "limit": MAX_ITERATIONS}, options.fresh)
    work = [(family, path) for family in wanted for path in files[family]]
    for done, (family, path) in enumerate(work):
        key = f"{family}/{path.stem}"
        options.progress(done, len(work), key)
        if key not in log:
            log.add(key, {"runs": measure(signorini.fclib.read(path), runners)})
    options.progress(len(work), len(work), "")

    numbers: dict[str, Any] = {"tolerance": TOLERANCE, "max_iterations": MAX_ITERATIONS, "families": {}}
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    verdicts: list[Verdict] = []
    names = [runner.name for runner in runners]
    for family in wanted:
        items = [log.items[f"{family}/{path.stem}"] for path in files[family]]
        numbers["families"][family] = {"problems": len(items), "rules": {}}
        rows = []
        for k, name in enumerate(names):
            runs = [item["runs"][name] for item in items]
            updates = summary([one["factorizations"] - 1 for one in runs])
            milliseconds = summary([1e3 * one["seconds"] for one in runs])
            stopped = float(np.mean([one["iterations"] < MAX_ITERATIONS for one in runs]))
            relative = summary([one["relative"] for one in runs])
            theirs = _paper.UPDATES[family][k] if family in _paper.UPDATES else (np.nan, np.nan)
            their_ms = _paper.MILLISECONDS[family][k] if family in _paper.MILLISECONDS else (np.nan, np.nan)
            numbers["families"][family]["rules"][name] = {
                "updates": updates,
                "milliseconds": milliseconds,
                "iterations": summary([one["iterations"] for one in runs]),
                "relative": relative,
                "share_stopped_by_43": stopped,
                "paper_updates": theirs,
                "paper_milliseconds": their_ms,
            }
            rows.append(
                [
                    name,
                    f"{updates['mean']:.2f} ± {updates['std']:.2f}",
                    f"{theirs[0]:g} ± {theirs[1]:g}",
                    f"{milliseconds['mean']:.3g} ± {milliseconds['std']:.3g}",
                    f"{their_ms[0]:g} ± {their_ms[1]:g}",
                    f"{100 * stopped:.1f} %",
                    f"{relative.get('median', np.nan):.1e}",
                    f"{relative.get('max', np.nan):.1e}",
                ]
            )
            if name == "p = 0.05":
                verdicts.append(
                    Verdict(
                        f"{family}: mean Cholesky updates, spectral p = 0.05, at or below the paper's",
                        f"{updates['mean']:.2f} ± {updates['std']:.2f}",
                        f"{theirs[0]:g} ± {theirs[1]:g}",
                        updates["mean"] <= theirs[0],
                    )
                )
        columns = ["rule", "updates", "paper", "ms", "paper (M1 Max)", "reach (43)", "median cert.", "worst cert."]
        tables[f"{family}: {len(items)} problems"] = (columns, rows)
    tables = {"Updates, ours / paper's": _all_families(numbers["families"], names), **tables}
    report = Report("updates", numbers, verdicts, tables)
    report.notes.append("Other problems than FCLIB's own and another processor: compare the rules with each other.")
    report.write(options, {})
    if _plots.available():
        report.files.append(_plot(options, numbers, names))
    return report


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
    return ["rule", *(f"{name} ({family['problems']})" for name, family in families.items())], rows


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
