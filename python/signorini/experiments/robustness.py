"""Every problem there is, as it is and made harder, to a relative certificate of 1e-8: what is solved, at what cost."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini.experiments import _no_solution, _plots
from signorini.experiments._data import all_families, data_directory, problem_files
from signorini.experiments._report import Options, Report, RunLog, Verdict, build_id, summary
from signorini.experiments._runs import REPEATS, measure, ours, solves
from signorini.scenes import STRESSES

TOLERANCE = 1e-8
SMALL_FAMILIES = ("cube_stack", "real")
UNSOLVABLE = ("RockPile_tob1",)  # no other solver that we know of reaches 1e-8, and auto only with luck
UNCERTAIN = ("friction 3", "friction 10")  # many have no solution (docs/auto.md)
TAIL = 20.0

Items = dict[tuple[str, str], list[dict[str, Any]]]  # runs by stress and family


def run(options: Options, stresses: tuple[str, ...] = (), solver: str = "auto") -> Report:
    """Each problem under each stress with one solver (auto), NCP, tolerance 1e-8.

    stresses: names of signorini.scenes.STRESSES, none for all. What auto does not solve may be proven to have no
    solution. With several workers the times are not to be quoted. An interrupted run goes on where it was.
    """
    unknown = [name for name in stresses if name not in STRESSES]
    if unknown:
        raise signorini.InvalidInputError(f"stress: is {unknown[0]!r}, must be one of {', '.join(STRESSES)}")
    chosen = tuple(name for name in STRESSES if name in stresses) or tuple(STRESSES)
    data = data_directory(options.data)
    wanted = options.families or tuple(all_families(data))
    small = () if options.quick else SMALL_FAMILIES
    files = problem_files(data, wanted, options.step(25), small)
    repeats = REPEATS if options.workers == 1 else 1
    setting = {"build": build_id(), "tolerance": TOLERANCE, "solver": solver, "repeats": repeats}
    log = RunLog(options.output / "robustness.runs.jsonl", setting, options.fresh)
    keys = {
        (stress, family): [f"{stress}/{family}/{path.stem}" for path in files[family]]
        for stress in chosen
        for family in wanted
    }
    jobs = [
        (str(path), family, todo, solver, repeats)
        for family in wanted
        for path in files[family]
        if (todo := tuple(stress for stress in chosen if f"{stress}/{family}/{path.stem}" not in log))
    ]
    for done, (path, family, results) in enumerate(_results(jobs, options.workers)):
        for stress, item in results.items():
            log.add(f"{stress}/{family}/{path}", item)
        options.progress(done + 1, len(jobs), f"{family}/{path}")
    items = {place: [log.items[key] for key in names] for place, names in keys.items()}
    paths = {(family, path.stem): path for family in wanted for path in files[family]}
    _prove(options, items, paths, log, solver == "auto")
    return _report(options, items, chosen, wanted)


def _prove(options: Options, items: Items, files: dict[tuple[str, str], Path], log: RunLog, prove: bool) -> None:
    """Sets "none" of every run: whether it is proven that there is no solution, by auto or here."""
    todo = []
    for (stress, _), runs in items.items():
        for one in runs:
            one["none"] = one["status"] == "infeasible"
            if prove and not one["none"] and not solves(one, TOLERANCE):
                todo.append((stress, one))
    for done, (stress, one) in enumerate(todo):
        key = f"no solution/{one['key']}"
        if key not in log:
            _, family, stem = one["key"].rsplit("/", 2)
            problem = signorini.fclib.read(files[family, stem])
            log.add(key, {"none": _no_solution.proven(STRESSES[stress](problem), TOLERANCE)})
        one["none"] = log.items[key]["none"]
        options.progress(done + 1, len(todo), key)


def _results(jobs: list[Any], workers: int) -> Iterator[tuple[str, str, dict[str, Any]]]:
    if workers <= 1:
        yield from map(_job, jobs)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for future in as_completed([pool.submit(_job, job) for job in jobs]):
            yield future.result()


def _job(job: tuple[str, str, tuple[str, ...], str, int]) -> tuple[str, str, dict[str, Any]]:
    """One file under some stresses: (stem, family, {stress: numbers})."""
    path, family, stresses, solver, repeats = job
    problem = signorini.fclib.read(path)
    runner = ours(solver, solver, TOLERANCE)
    results = {}
    for stress in stresses:
        runs = measure(STRESSES[stress](problem), [runner], repeats)
        results[stress] = {**runs[solver], "contacts": problem.num_contacts}
    return Path(path).stem, family, results


def _report(
    options: Options,
    items: Items,
    stresses: tuple[str, ...],
    wanted: tuple[str, ...],
) -> Report:
    numbers: dict[str, Any] = {"tolerance": TOLERANCE, "workers": options.workers, "stresses": {}}
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    verdicts: list[Verdict] = []
    columns = [
        "family",
        "solved",
        "no solution",
        "open",
        "1e-6",
        "median cert.",
        "worst cert.",
        "median fact.",
        "max fact.",
        "median ms",
        "max / median",
    ]
    for stress in stresses:
        numbers["stresses"][stress] = {}
        rows, failures, count = [], [], 0
        for family in wanted:
            runs = items[stress, family]
            solved = [solves(one, TOLERANCE) for one in runs]
            near = [solves(one, 1e-6) for one in runs]
            relative = summary([one["relative"] for one in runs])
            factorizations = summary([one["factorizations"] for one in runs])
            milliseconds = summary([1e3 * one["seconds"] for one in runs])
            tail = milliseconds["max"] / milliseconds["median"]
            names = [one["key"].split("/")[-1] for one in runs]
            slowest = names[int(np.argmax([one["seconds"] for one in runs]))]
            bad = [(name, one) for name, one, fine in zip(names, runs, solved, strict=True) if not fine]
            bad.sort(key=lambda pair: -(np.inf if pair[1]["relative"] is None else pair[1]["relative"]))
            none = sum(one["none"] for _, one in bad)
            failures += [(family, *pair) for pair in bad if pair[0] not in UNSOLVABLE]
            count += sum(name not in UNSOLVABLE for name in names)
            numbers["stresses"][stress][family] = {
                "problems": len(runs),
                "solved": int(sum(solved)),
                "proven_without_solution": none,
                "solved_1e-6": int(sum(near)),
                "relative": relative,
                "factorizations": factorizations,
                "milliseconds": milliseconds,
                "max_over_median": tail,
                "slowest": slowest,
                "unsolved": [{"name": name, **one} for name, one in bad],
            }
            rows.append(
                [
                    family,
                    f"{sum(solved)} of {len(runs)}",
                    str(none),
                    str(len(bad) - none),
                    str(sum(near)),
                    f"{relative.get('median', np.nan):.0e}",
                    f"{relative.get('max', np.nan):.0e}",
                    f"{factorizations['median']:.0f}",
                    f"{factorizations['max']:.0f}",
                    f"{milliseconds['median']:.3g}",
                    f"{tail:.3g} ({slowest})",
                ]
            )
            if stress == "as is" and family not in SMALL_FAMILIES:
                verdicts.append(
                    Verdict(
                        f"{family}: no problem more than {TAIL:g} times the median time",
                        f"{tail:.1f} times ({slowest})",
                        f"{TAIL:g} times",
                        tail <= TAIL if options.workers == 1 else None,
                    )
                )
        tables[stress] = (columns, rows)
        failures.sort(key=lambda entry: -(np.inf if entry[2]["relative"] is None else entry[2]["relative"]))
        told = f"{count - len(failures)} of {count} (RockPile_tob1 aside)"
        if proven := sum(one["none"] for _, _, one in failures):
            told += f", {proven} proven to have no solution, {len(failures) - proven} open"
        failures = [entry for entry in failures if not entry[2]["none"]]
        if failures:
            family, name, one = failures[0]
            value = "none" if one["relative"] is None else f"{one['relative']:.1e}"
            told += f"; worst {family}/{name} at {value}"
        if stress in UNCERTAIN:
            verdicts.append(Verdict(f"{stress}: solved to 1e-8", told, "many have no solution"))
        else:
            verdicts.append(Verdict(f"{stress}: solved to 1e-8", told, "all", not failures))
    tables = {"Solved; factorisations, median and most": _all_stresses(numbers["stresses"], items, wanted), **tables}
    report = Report("robustness", numbers, verdicts, tables)
    if options.workers > 1:
        report.notes.append("Several processes ran at once: the times are not to be quoted.")
    report.write(options, {})
    if _plots.available():
        report.files.append(_plot(options, items, stresses, wanted))
    return report


def _all_stresses(found: dict[str, Any], items: Items, wanted: tuple[str, ...]) -> tuple[list[str], list[list[str]]]:
    """One table of all stresses; UNSOLVABLE are not among what is solved, has no solution, or is there."""
    rows = []
    for stress, families in found.items():
        runs = [one for family in wanted for one in items[stress, family]]
        runs = [one for one in runs if one["key"].split("/")[-1] not in UNSOLVABLE]
        solved = sum(solves(one, TOLERANCE) for one in runs)
        none = sum(one["none"] and not solves(one, TOLERANCE) for one in runs)
        told = f"{solved} of {len(runs)}"
        row = [stress, told + (f"; {none} proven to have no solution" if none else "")]
        for family in wanted:
            count = families[family]["factorizations"]
            row.append(f"{count['median']:.0f}, {count['max']:.0f}")
        rows.append(row)
    return ["variant", "solved", *wanted], rows


def _plot(options: Options, items: Any, stresses: tuple[str, ...], wanted: tuple[str, ...]) -> Any:
    figure, axes = _plots.figure(1, 2, 5.2, 3.6)
    for k, stress in enumerate(stresses):
        color = f"C{k}"
        runs = [one for family in wanted for one in items[stress, family]]
        for axis, key in zip(axes[0], ("relative", "factorizations"), strict=True):
            values = np.sort([np.inf if one[key] is None else max(one[key], 1e-17) for one in runs])
            share = (np.arange(len(values)) + 1) / len(values)
            axis.step(values, share, where="post", color=color, label=stress, linewidth=1.2)
            axis.set_xscale("log")
    axes[0][0].axvline(TOLERANCE, color="black", linewidth=0.6, linestyle=":")
    axes[0][0].set_xlabel("relative certificate")
    axes[0][1].set_xlabel("factorisations")
    axes[0][0].set_ylabel("share of problems")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    return _plots.save(figure, options.output / "robustness.png")
