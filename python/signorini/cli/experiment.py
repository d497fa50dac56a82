"""signorini experiment: the paper's figures and tables, and our benchmarks."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

# One thread for every library underneath: times are compared. Set before any of them starts.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: E402
from rich.table import Table  # noqa: E402

from signorini.cli._output import check_folder, printer, report  # noqa: E402
from signorini.experiments import (  # noqa: E402
    DataMissingError,
    Options,
    Report,
    Verdict,
    _all,
    _page,
    _plots,
    data_directory,
)
from signorini.experiments._report import build_id, environment  # noqa: E402

app = typer.Typer(
    help="Run an experiment: its numbers as JSON and tables, a plot, and a verdict on each claim.\n\n"
    "Figures and tables are those of Carpentier, Le Lidec, Montaut 2024. Exit status: 0, or 2 on bad input.",
    short_help="Run an experiment: its numbers as JSON and tables, a plot, and a verdict on each claim.",
    no_args_is_help=True,
)

Output = Annotated[
    Path, typer.Option(metavar="DIR", help="Folder for the results; made when missing.", file_okay=False)
]
Data = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Holds one folder of problem files (FCLIB) a family; default: the environment variable SIGNORINI_DATA.",
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="A sample, to see that all works.")]
Peers = Annotated[bool, typer.Option("--peers/--no-peers", help="Run other people's solvers where installed.")]
Every = Annotated[int | None, typer.Option(min=1, metavar="N", help="Take every N-th problem of a family.")]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Measure again what an earlier run into the same DIR has measured.")
]
Install = Annotated[
    bool, typer.Option("--install", help="Get engines that are missing from PyPI, each into its own environment.")
]
Family = Annotated[list[str] | None, typer.Option(help="Only this family; may be given several times.")]


def _run(experiment: Callable[[Options], Report], options: Options, write_problems: Path | None = None) -> None:
    console = printer()
    errors = printer(stderr=True)
    try:
        check_folder("--output", options.output)
        if write_problems is not None:
            check_folder("--write-problems", write_problems)
    except ValueError as error:
        report(errors, error)
        raise typer.Exit(2) from None
    with _bar(errors) as progress:
        task = progress.add_task("", total=None)
        options.progress = lambda done, total, what: progress.update(
            task, completed=done, total=total, description=what
        )
        try:
            result = experiment(options)
        except (DataMissingError, ValueError) as error:
            progress.stop()
            report(errors, error)
            raise typer.Exit(2) from None
    _show(console, result)


def _bar(errors: Console) -> Progress:
    return Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
        console=errors,
        transient=True,
    )


def _show(console: Console, report: Report) -> None:
    wide = console if console.is_terminal else printer(width=240)
    for title, (columns, rows) in report.tables.items():
        table = Table(title=title, title_justify="left")
        for k, column in enumerate(columns):
            table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        wide.print(table)
    for verdict in report.verdicts:
        style = {True: "green", False: "red", None: ""}[verdict.met]
        console.print(str(verdict), style=style, soft_wrap=True)
    for note in report.notes:
        console.print(f"note: {note}", soft_wrap=True)
    if not _plots.available():
        console.print("note: no plot, matplotlib is missing: pip install 'signorini[plots]'")
    for file in report.files:
        console.print(f"wrote {file}", soft_wrap=True)


@app.command()
def profiles(
    output: Output,
    data: Data = None,
    quick: Quick = False,
    with_peers: Peers = True,
    every: Every = None,
    fresh: Fresh = False,
    family: Family = None,
) -> None:
    """Fig. 7 and Table II: performance profiles of ours, the paper's ADMM, PGS and the peers at 1e-6."""
    from signorini.experiments import profiles as experiment

    _run(experiment.run, _options(output, data, quick, every, fresh, family, with_peers))


@app.command()
def updates(
    output: Output,
    data: Data = None,
    quick: Quick = False,
    every: Every = None,
    fresh: Fresh = False,
    family: Family = None,
) -> None:
    """Tables III and IV: Cholesky updates and times of the linear and spectral rules."""
    from signorini.experiments import updates as experiment

    _run(experiment.run, _options(output, data, quick, every, fresh, family))


@app.command()
def convergence(output: Output, quick: Quick = False) -> None:
    """Fig. 4: residuals by iteration on cubes and Talos, down to 1e-9."""
    from signorini.experiments import convergence as experiment

    _run(experiment.run, _options(output, None, quick, None, False, None))


@app.command()
def robustness(
    output: Output,
    data: Data = None,
    quick: Quick = False,
    every: Every = None,
    fresh: Fresh = False,
    family: Family = None,
    stress: Annotated[
        list[str] | None, typer.Option(help='Only this variant, such as "friction 3"; may be given several times.')
    ] = None,
    solver: Annotated[str, typer.Option(help="The method.")] = "auto",
    workers: Annotated[int, typer.Option(min=1, help="Processes; with several, times are not to be quoted.")] = 1,
) -> None:
    """All problems as they are and with other masses, compliance and friction, to a relative 1e-8."""
    from signorini.experiments import robustness as experiment

    options = _options(output, data, quick, every, fresh, family)
    options.workers = workers
    _run(lambda given: experiment.run(given, tuple(stress or ()), solver), options)


@app.command()
def peers(
    output: Output,
    data: Data = None,
    quick: Quick = False,
    every: Every = None,
    fresh: Fresh = False,
    family: Family = None,
) -> None:
    """Ours against Pinocchio's ADMM and the best of Siconos', in turns on one core."""
    from signorini.experiments import peers as experiment

    _run(experiment.run, _options(output, data, quick, every, fresh, family))


@app.command()
def scaling(output: Output, quick: Quick = False, fresh: Fresh = False) -> None:
    """Heaps of 100 to 10 000 contacts: time, memory and their growth."""
    from signorini.experiments import scaling as experiment

    _run(experiment.run, _options(output, None, quick, None, fresh, None))


@app.command()
def stepping(output: Output, quick: Quick = False) -> None:
    """Steps a second beside MuJoCo: humanoid and cubes, and Talos alone."""
    from signorini.experiments import stepping as experiment

    _run(experiment.run, _options(output, None, quick, None, False, None))


@app.command()
def scenes(output: Output, quick: Quick = False) -> None:
    """Every ready scene, heaps of up to 10 000 bodies too: steps a second, contacts, certificates, overlaps."""
    from signorini.experiments import scenes as experiment

    _run(experiment.run, _options(output, None, quick, None, False, None))


@app.command()
def simulators(
    output: Output,
    quick: Quick = False,
    install: Install = False,
    engine: Annotated[
        list[str] | None, typer.Option(help="Only ours and this engine; may be given several times.")
    ] = None,
    scene: Annotated[
        list[str] | None,
        typer.Option(help='Only this scene, or "trials", those with a known answer; may be given several times.'),
    ] = None,
    refine: Annotated[
        bool, typer.Option("--refine", help="With steps down to 1/32 ms too, ours and MuJoCo accurate.")
    ] = False,
) -> None:
    """Fig. 6: MuJoCo, Drake, Bullet and DART beside ours: steps a second, and what they are worth."""
    from signorini.experiments import simulators as experiment

    options = _options(output, None, quick, None, False, None)
    _run(lambda given: experiment.run(given, install, tuple(engine or ()), tuple(scene or ()), refine), options)


@app.command()
def inverse(output: Output, quick: Quick = False) -> None:
    """Fig. 8: UR5 slides along a wall, Talos pushes one; round trips, MuJoCo's inverse, times beside Pinocchio's."""
    from signorini.experiments import inverse as experiment

    _run(experiment.run, _options(output, None, quick, None, False, None))


@app.command()
def walking(output: Output, quick: Quick = False) -> None:
    """The quadruped Solo12 under model-predictive control, up a slope and over random steps."""
    from signorini.experiments import walking as experiment

    _run(experiment.run, _options(output, None, quick, None, False, None))


@app.command()
def models(output: Output, quick: Quick = False) -> None:
    """Table I: the same scenes under every contact model: creep, hop, force at a distance, overlap, energy, time."""
    from signorini.experiments import models as experiment

    _run(experiment.run, _options(output, None, quick, None, False, None))


@app.command()
def timings(
    output: Output,
    quick: Quick = False,
    with_peers: Peers = True,
    every: Every = None,
    write_problems: Annotated[
        Path | None, typer.Option(help="Also write the problems as FCLIB files into this folder.", file_okay=False)
    ] = None,
) -> None:
    """Fig. 5: time per step of four robot scenes, cold and warm: ours, ADMM, PGS, and SCS on the CCP, to 1e-4."""
    from signorini.experiments import timings as experiment

    options = _options(output, None, quick, every, False, None, with_peers)
    _run(lambda given: experiment.run(given, write_problems), options, write_problems)


@app.command("all")
def everything(
    output: Output,
    data: Data = None,
    quick: Quick = False,
    with_peers: Peers = True,
    skip: Annotated[
        list[str] | None, typer.Option(help="Leave this experiment out; may be given several times.")
    ] = None,
    fresh: Fresh = False,
    install: Install = False,
) -> None:
    """All of them, each in its own process, and one report page (report.html, report.md).

    Goes on where an interrupted run into DIR was. Exit status: 0 when all verdicts are met, 1 when one is not or an
    experiment failed, 2 on bad input.
    """
    console, errors = printer(), printer(stderr=True)
    known = _experiments()
    unknown = sorted(set(skip or ()) - set(known))
    wanted = {name: callback for name, callback in known.items() if name not in (skip or ())}
    needs_data = [name for name, callback in wanted.items() if "data" in inspect.signature(callback).parameters]
    try:
        if unknown:
            raise ValueError(f"--skip: is {unknown[0]!r}, must be one of {', '.join(known)}")
        check_folder("--output", output)
        folder = data_directory(data).resolve() if needs_data else None
    except DataMissingError as error:
        hint = " ".join(f"--skip {name}" for name in needs_data)
        report(errors, f"{error}; or leave out what reads them: {hint}")
        raise typer.Exit(2) from None
    except ValueError as error:
        report(errors, error)
        raise typer.Exit(2) from None
    given = {"--quick": quick, "--fresh": fresh, "--no-peers": not with_peers, "--install": install}
    commands = {name: _command(name, callback, output, folder, given) for name, callback in wanted.items()}
    surroundings = environment({})
    setting = {
        **{key: surroundings[key] for key in ("signorini", "processor")},
        "build": build_id(),
        "quick": quick,
        "peers": with_peers,
        "install": install,
        "data": folder,
    }
    runs = _all.Runs(commands, output, setting, fresh)
    with _bar(errors) as progress:
        task = progress.add_task("", total=len(commands))
        runs.progress = lambda done, total, what: progress.update(task, completed=done, total=total, description=what)
        outcomes = runs.run()
    about = {name: inspect.getdoc(callback) or "" for name, callback in wanted.items()}
    said = "a sample (--quick)" if quick else "all"
    files = _page.Page(outcomes, about, skip or (), said, surroundings, output).write()
    for outcome in outcomes:
        _tell(console, outcome)
    for file in files:
        console.print(f"wrote {file}", soft_wrap=True)
    if not all(outcome.met for outcome in outcomes):
        raise typer.Exit(1)


def _experiments() -> dict[str, Callable[..., None]]:
    """Every command here but `all`: what is added joins by itself."""
    found = {info.name or info.callback.__name__: info.callback for info in app.registered_commands if info.callback}
    found.pop("all")
    return found


def _command(
    name: str, callback: Callable[..., None], output: Path, data: Path | None, given: dict[str, bool]
) -> list[str]:
    """Its command line, with those options that it has."""
    parameters = inspect.signature(callback).parameters
    program = "from signorini.cli.main import main; main()"
    line = [sys.executable, "-c", program, "experiment", name, "--output", str(output)]
    if "data" in parameters and data is not None:
        line += ["--data", str(data)]
    owners = {"--quick": "quick", "--fresh": "fresh", "--no-peers": "with_peers", "--install": "install"}
    return line + [flag for flag, on in given.items() if on and owners[flag] in parameters]


def _tell(console: Console, outcome: _all.Outcome) -> None:
    """An experiment in a line, and its verdicts that are not met."""
    bad = [verdict for verdict in outcome.verdicts if verdict["met"] is False]
    what = f"{outcome.count(True)} met, {len(bad)} not, {outcome.count(None)} without a claim"
    if outcome.content is None:
        what = f"FAILED: {outcome.error}"
    when = ", by an earlier run" if outcome.earlier else ""
    console.print(
        f"{outcome.name} ({outcome.seconds:.0f} s{when}): {what}",
        style="green" if outcome.met else "red",
        soft_wrap=True,
    )
    for verdict in bad:
        console.print(f"    {Verdict(**verdict)}", style="red", soft_wrap=True)


def _options(
    output: Path,
    data: Path | None,
    quick: bool,
    every: int | None,
    fresh: bool,
    family: list[str] | None,
    with_peers: bool = True,
) -> Options:
    return Options(
        output=output,
        data=data,
        quick=quick,
        every=every,
        with_peers=with_peers,
        fresh=fresh,
        families=tuple(family or ()),
    )
