"""Ours against Pinocchio's ADMM at 1e-6 and against the best of Siconos at a relative 1e-8, in one run on one core."""

from __future__ import annotations

from typing import Any

import numpy as np

import signorini
from signorini.experiments import _paper, _plots
from signorini.experiments._data import data_directory, problem_files
from signorini.experiments._peers import taking_part
from signorini.experiments._report import Options, Report, RunLog, Verdict, build_id, summary
from signorini.experiments._runs import measure, ours, peer, solves

LOOSE, TIGHT = 1e-6, 1e-8
FASTER_THAN_PINOCCHIO, FASTER_THAN_SICONOS, TAIL = 3.0, 10.0, 20.0


def run(options: Options) -> Report:
    """On each problem in turns: ours (auto) at 1e-6 and 1e-8, Pinocchio's ADMM (spectral, lanczos_size 20, its own
    tolerances 1e-6), and Siconos' NSGS, NSN_AC and NSN_FB at 1e-8, of which the fastest that reaches it counts."""
    data = data_directory(options.data)
    wanted = options.families or tuple(_paper.FAMILIES)
    files = problem_files(data, wanted, options.step(25))
    entries, versions = taking_part(options)
    runners = [ours("ours 1e-6", tolerance=LOOSE), ours("ours 1e-8", tolerance=TIGHT)]
    pinocchio = [entry for entry in entries if entry.name == "pinocchio-admm"]
    siconos = [entry for entry in entries if entry.name.startswith("siconos-")]
    runners += [peer(entry, LOOSE, max_iterations=20000) for entry in pinocchio]
    runners += [peer(entry, TIGHT) for entry in siconos]
    setting = {"build": build_id(), "peers": versions, "tolerances": [LOOSE, TIGHT]}
    log = RunLog(options.output / "peers.runs.jsonl", setting, options.fresh)
    work = [(family, path) for family in wanted for path in files[family]]
    for done, (family, path) in enumerate(work):
        key = f"{family}/{path.stem}"
        options.progress(done, len(work), key)
        if key not in log:
            log.add(key, {"runs": measure(signorini.fclib.read(path), runners, 5)})
    options.progress(len(work), len(work), "")

    numbers: dict[str, Any] = {"tolerances": [LOOSE, TIGHT], "families": {}}
    tables: dict[str, tuple[list[str], list[list[str]]]] = {}
    verdicts: list[Verdict] = []
    for family in wanted:
        items = [log.items[f"{family}/{path.stem}"] for path in files[family]]
        for item in items:
            fine = [item["runs"][e.name] for e in siconos if solves(item["runs"][e.name], TIGHT)]
            item["runs"]["siconos best"] = min(fine, key=lambda one: one["seconds"]) if fine else None
        rows, solvers = [], {}
        names = [runner.name for runner in runners] + (["siconos best"] if siconos else [])
        for name in names:
            runs = [item["runs"][name] for item in items]
            known = [one for one in runs if one is not None]
            tolerance = LOOSE if name in ("ours 1e-6", "pinocchio-admm") else TIGHT
            milliseconds = summary([1e3 * one["seconds"] for one in known])
            relative = summary([one["relative"] for one in known])
            solved = sum(solves(one, tolerance) for one in known)
            solvers[name] = {
                "tolerance": tolerance,
                "solved": solved,
                "problems": len(runs),
                "milliseconds": milliseconds,
                "relative": relative,
                "factorizations": summary([o["factorizations"] for o in known if o["factorizations"] is not None]),
                "claimed": sum(one["claimed"] for one in known),
            }
            rows.append(
                [
                    name,
                    f"{solved} of {len(runs)}",
                    f"{milliseconds.get('median', np.nan):.3g}",
                    f"{milliseconds.get('q25', np.nan):.3g} - {milliseconds.get('q75', np.nan):.3g}",
                    f"{milliseconds.get('max', np.nan):.3g}",
                    f"{relative.get('median', np.nan):.1e}",
                    f"{relative.get('max', np.nan):.1e}",
                ]
            )
        numbers["families"][family] = {"problems": len(items), "solvers": solvers, "runs": items}
        columns = ["solver", "solved", "median ms", "quartiles", "max ms", "median cert.", "worst cert."]
        tables[f"{family}: {len(items)} problems"] = (columns, rows)
        verdicts += _verdicts(family, items, solvers, bool(pinocchio), bool(siconos))
        numbers["families"][family]["ratios"] = {v.claim: v.measured for v in verdicts if v.claim.startswith(family)}
    tables = {"Median ms (solved; median and worst certificate)": _all_families(numbers["families"]), **tables}
    report = Report("peers", numbers, verdicts, tables)
    report.write(options, versions)
    if _plots.available():
        report.files.append(_plot(options, numbers))
    return report


def _all_families(families: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """One table of all families, of Siconos' solvers the best of each problem, with ratios of median times."""
    rows = []
    for name in next(iter(families.values()))["solvers"]:
        if name.startswith("siconos-"):
            continue
        row = [name]
        for family in families.values():
            one = family["solvers"][name]
            time, relative = one["milliseconds"], one["relative"]
            known = f"; {relative['median']:.0e}, {relative['max']:.0e}" if relative["count"] else ""
            row.append(f"{time['median']:.2g} ({one['solved']}{known})" if time["count"] else "none")
        rows.append(row)
        beside = {"pinocchio-admm": "ours 1e-6", "siconos best": "ours 1e-8"}.get(name)
        if beside is not None:
            row = [f"{name} over {beside}, same problems"]
            for family in families.values():
                pairs = [(i["runs"][beside], i["runs"][name]) for i in family["runs"] if i["runs"][name]]
                row.append(f"{_ratio(pairs):.2g}" if pairs else "")
            rows.append(row)
    return ["solver", *(f"{name} ({family['problems']})" for name, family in families.items())], rows


def _verdicts(
    family: str, items: list[dict[str, Any]], solvers: dict[str, Any], pinocchio: bool, siconos: bool
) -> list[Verdict]:
    out = []
    mine = solvers["ours 1e-6"]
    if pinocchio:
        theirs = solvers["pinocchio-admm"]
        ratio = theirs["milliseconds"]["median"] / mine["milliseconds"]["median"]
        no_worse = (
            mine["relative"]["median"] <= theirs["relative"]["median"]
            and mine["relative"]["max"] <= theirs["relative"]["max"]
            and mine["solved"] >= theirs["solved"]
        )
        measured = (
            f"{ratio:.1f} times, certificates median {mine['relative']['median']:.0e} against "
            f"{theirs['relative']['median']:.0e}, worst {mine['relative']['max']:.0e} against "
            f"{theirs['relative']['max']:.0e}"
        )
        claim = f"{family}: median time shorter than Pinocchio's ADMM, at certificates no worse"
        out.append(
            Verdict(claim, measured, f"{FASTER_THAN_PINOCCHIO:g} times", ratio >= FASTER_THAN_PINOCCHIO and no_worse)
        )
    if siconos:
        both = [(i["runs"]["ours 1e-8"], i["runs"]["siconos best"]) for i in items if i["runs"]["siconos best"]]
        claim = f"{family}: median time shorter than the best of Siconos' at 1e-8"
        reference = f"{FASTER_THAN_SICONOS:g} times"
        if both:
            measured = f"{_ratio(both):.1f} times, on the {len(both)} of {len(items)} that one of its three solves"
            out.append(Verdict(claim, measured, reference, bool(_ratio(both) >= FASTER_THAN_SICONOS)))
            for name in sorted(name for name in solvers if name.startswith("siconos-")):
                pairs = [(i["runs"]["ours 1e-8"], i["runs"][name]) for i in items if solves(i["runs"][name], TIGHT)]
                said = f"{_ratio(pairs):.1f} times, on the {len(pairs)} of {len(items)} it solves" if pairs else "none"
                out.append(Verdict(f"{family}: median time shorter than {name}'s alone at 1e-8", said, reference))
        else:
            out.append(Verdict(claim, f"Siconos solves none of {len(items)}", reference, True))
    for name in ("ours 1e-6", "ours 1e-8"):
        milliseconds = solvers[name]["milliseconds"]
        tail = milliseconds["max"] / milliseconds["median"]
        slowest = max(items, key=lambda item: item["runs"][name]["seconds"])["key"].split("/")[-1]
        claim = f"{family}: {name}, slowest over median"
        out.append(Verdict(claim, f"{tail:.1f} times ({slowest})", f"{TAIL:g} times", tail <= TAIL))
    return out


def _ratio(pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> float:
    """Their median time over ours, of (ours, theirs)."""
    return float(np.median([b["seconds"] for _, b in pairs]) / np.median([a["seconds"] for a, _ in pairs]))


def _plot(options: Options, numbers: dict[str, Any]) -> Any:
    families = numbers["families"]
    figure, axes = _plots.figure(1, len(families), 4.4, 3.6)
    colors = {
        "ours 1e-6": _plots.COLORS["ours"],
        "ours 1e-8": "#e59866",
        "pinocchio-admm": _plots.COLORS["paper"],
        "siconos best": _plots.COLORS["other"],
    }
    for axis, (family, content) in zip(axes[0], families.items(), strict=True):
        for name, color in colors.items():
            runs = [item["runs"].get(name) for item in content["runs"]]
            points = [(1e3 * one["seconds"], one["relative"]) for one in runs if one and one["relative"] is not None]
            if points:
                x, y = np.array(points).T
                axis.loglog(x, np.maximum(y, 1e-16), "o", markersize=3, color=color, alpha=0.6, label=name)
        axis.set_xlabel("time [ms]")
        axis.set_title(f"{family} ({content['problems']} problems)", fontsize=10)
    axes[0][0].set_ylabel("relative certificate")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return _plots.save(figure, options.output / "peers.png")
