"""Time and memory against the number of contacts: generated heaps of 100 to 10 000."""

from __future__ import annotations

import multiprocessing
import resource
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

import signorini
from signorini.experiments import _plots
from signorini.experiments._report import Options, Report, RunLog, Verdict, build_id
from signorini.experiments._runs import record, solves

TOLERANCE = 1e-6
SIZES = (100, 215, 464, 1000, 2154, 4642, 10000)
QUICK_SIZES = (100, 316, 1000)
#: Title -> (layers, contacts a sphere) of signorini.scenes.pile.
SHAPES: dict[str, tuple[float | None, float]] = {
    "4 layers, poured": (4.0, 2.2),
    "as high as wide, poured": (None, 2.2),
    "4 layers, jammed": (4.0, 2.6),
}
MEMORY_LIMIT = 2.0  # GiB


def run(options: Options) -> Report:
    """Heaps of spheres (signorini.scenes.pile), shallow, deep and jammed, with ours (auto) at 1e-6.

    Each in a process of its own, whose peak memory is that of building and solving the problem. Three seeds, of which
    the median time counts.
    """
    sizes = QUICK_SIZES if options.quick else SIZES
    seeds = range(1 if options.quick else 3)
    log = RunLog(options.output / "scaling.runs.jsonl", {"build": build_id(), "tolerance": TOLERANCE}, options.fresh)
    work = [(shape, size, seed) for size in sizes for shape in SHAPES for seed in seeds]
    for done, (shape, size, seed) in enumerate(work):
        key = f"{shape}/{size}/{seed}"
        options.progress(done, len(work), f"{size} contacts, {shape}")
        if key not in log:
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                log.add(key, pool.submit(_solve, size, *SHAPES[shape], seed).result())
    options.progress(len(work), len(work), "")

    numbers: dict[str, Any] = {"tolerance": TOLERANCE, "shapes": {}}
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    verdicts: list[Verdict] = []
    for shape in SHAPES:
        rows, points = [], []
        for size in sizes:
            runs = [log.items[f"{shape}/{size}/{seed}"] for seed in seeds]
            seconds = float(np.median([one["seconds"] for one in runs]))
            solved = sum(solves(one, TOLERANCE) for one in runs)
            memory = max(one["peak_gib"] for one in runs)
            factorizations = float(np.median([one["factorizations"] for one in runs]))
            worst = max(np.inf if one["relative"] is None else one["relative"] for one in runs)
            points.append(
                {
                    "contacts": size,
                    "seconds": seconds,
                    "seconds_all": [one["seconds"] for one in runs],
                    "seconds_per_factorization": seconds / max(factorizations, 1.0),
                    "solved": solved,
                    "runs": len(runs),
                    "factorizations": factorizations,
                    "peak_gib": memory,
                    "worst_relative": worst,
                }
            )
            rows.append(
                [
                    str(size),
                    f"{solved} of {len(runs)}",
                    f"{seconds:.3g}",
                    f"{factorizations:.0f}",
                    f"{1e3 * seconds / max(factorizations, 1.0):.3g}",
                    f"{memory:.2f}",
                    f"{worst:.1e}",
                ]
            )
        n = np.array(sizes, dtype=float)
        times = np.array([point["seconds"] for point in points])
        slope = float(np.polyfit(np.log(n), np.log(times), 1)[0])
        reference = float(np.polyfit(np.log(n), np.log(n * np.log(n)), 1)[0])
        growth = float(times[-1] / times[0])
        allowed = float(n[-1] * np.log(n[-1]) / (n[0] * np.log(n[0])))
        numbers["shapes"][shape] = {
            "points": points,
            "slope": slope,
            "slope_of_n_log_n": reference,
            "growth": growth,
            "growth_of_n_log_n": allowed,
        }
        columns = ["contacts", "solved", "s", "factorisations", "ms each", "peak GiB", "worst cert."]
        tables[f"heap, {shape}"] = (columns, rows)
        most = max(point["peak_gib"] for point in points)
        unsolved = sum(point["runs"] - point["solved"] for point in points)
        verdicts += [
            Verdict(
                f"heap, {shape}: time grows no faster than n log n",
                f"{growth:.0f} times from {sizes[0]} to {sizes[-1]} contacts (slope {slope:.2f})",
                f"{allowed:.0f} times (slope {reference:.2f})",
                growth <= allowed,
            ),
            Verdict(f"heap, {shape}: all certified at 1e-6", f"{unsolved} not", "0", unsolved == 0),
            Verdict(f"heap, {shape}: peak memory", f"{most:.2f} GiB", f"{MEMORY_LIMIT:g} GiB", most < MEMORY_LIMIT),
        ]
    report = Report("scaling", numbers, verdicts, tables)
    report.write(options, {})
    if _plots.available():
        report.files.append(_plot(options, numbers))
    return report


def _solve(size: int, layers: float | None, contacts_per_sphere: float, seed: int) -> dict[str, Any]:
    from signorini import scenes

    problem = scenes.pile(size, seed, layers=layers, contacts_per_sphere=contacts_per_sphere)
    solution = signorini.solve(problem, tolerance=TOLERANCE)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {**record(solution), "peak_gib": peak / 2**30}


def _plot(options: Options, numbers: dict[str, Any]) -> Any:
    figure, axes = _plots.figure(1, 2, 4.6, 3.4)
    for k, (shape, content) in enumerate(numbers["shapes"].items()):
        n = np.array([point["contacts"] for point in content["points"]], dtype=float)
        seconds = np.array([point["seconds"] for point in content["points"]])
        axes[0][0].loglog(n, seconds, "o-", color=f"C{k}", label=f"{shape} (slope {content['slope']:.2f})")
        reference = n * np.log(n) * seconds[0] / (n[0] * np.log(n[0]))
        axes[0][0].loglog(n, reference, ":", color=f"C{k}", linewidth=0.9)
        axes[0][1].semilogx(n, [point["peak_gib"] for point in content["points"]], "o-", color=f"C{k}", label=shape)
    axes[0][0].set_ylabel("time to 1e-6 [s] (dotted: n log n)")
    axes[0][1].set_ylabel("peak memory [GiB]")
    for axis in axes[0]:
        axis.set_xlabel("contacts")
        axis.legend(fontsize=8)
    return _plots.save(figure, options.output / "scaling.png")
