"""signorini run, replay, scenes: simulate a scene or a robot file, certify every step, record it."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

import signorini
from signorini._hardest import Hardest
from signorini.cli._output import check_folder, check_outputs, finite, printer, refuse_idle, report, write_json
from signorini.cli.picture import SIZE, Shots, Size
from signorini.cli.solve import Law, Solver
from signorini.cli.view import NoOpen, NoShadows, Port, announce

if TYPE_CHECKING:
    from signorini.view.viewer import LiveViewer

BLOCK = 50  # steps between two looks at the progress bar
Source = dict[str, Any]


def load_source(source: Source) -> tuple[signorini.World, Any, Any]:
    """World, q and v at the start, from what a recording keeps of where they came from."""
    if "scene" in source:
        from signorini import scenes

        known, scene, options = scenes.worlds(), source["scene"], source.get("options", {})
        if not isinstance(scene, str) or scene not in known:
            raise signorini.InvalidInputError(f"scene: there is no {scene!r}; there are {', '.join(known)}")
        if not isinstance(options, dict):
            raise signorini.InvalidInputError(f"options: is {options!r}, must be values by name")
        return known[scene](**options)
    if "file" not in source:
        raise signorini.InvalidInputError(f"source: is {source!r}, must name a scene or a file")
    world = signorini.load(
        source["file"], ground=source.get("ground", False), floating_base=source.get("floating_base")
    )
    return world, world.initial_q, np.zeros(world.num_v)


def controller_of(source: Source, simulator: signorini.Simulator, start: Any) -> Callable[[], None] | None:
    """What drives the scene of a source, if anything does: called before every step."""
    from signorini import scenes

    scene = scenes.worlds().get(source.get("scene", ""))
    if scene is None or scene.controller is None:
        return None
    return scene.controller(simulator, scenes.Start(*start), source.get("options", {}))


def _source(scene: str, ground: bool, floating: bool | None, options: list[str]) -> Source:
    if Path(scene).suffix or Path(scene).exists():
        if not Path(scene).is_file():
            what = "is no file" if Path(scene).exists() else "there is no such file, nor a scene of that name"
            raise signorini.InvalidInputError(f"{scene}: {what}")
        if options:
            raise signorini.InvalidInputError("option: is for scenes, not for files")
        floor = "touching" if ground else False
        return {"file": str(Path(scene).resolve()), "ground": floor, "floating_base": floating}
    if ground or floating is not None:
        name = "ground" if ground else "floating/--fixed"
        raise signorini.InvalidInputError(f"--{name}: is for files, not for scenes")
    values: dict[str, Any] = {}
    for option in options:
        key, equals, text = option.partition("=")
        if not equals:
            raise signorini.InvalidInputError(f"option: is {option!r}, must be NAME=VALUE")
        try:
            values[key.replace("-", "_")] = int(text) if text.lstrip("+-").isdigit() else float(text)
        except ValueError:
            raise signorini.InvalidInputError(f"option: {key} is {text!r}, must be a number") from None
    return {"scene": scene, "options": values}


def run(
    context: typer.Context,
    scene: Annotated[
        str,
        typer.Argument(metavar="SCENE|FILE", help="A scene of `signorini scenes`, or a robot file (URDF, MJCF, SDF)."),
    ],
    duration: Annotated[
        float | None, typer.Option(help="Simulated time in s, in (0, 1e6]; default: the scene's own; of files, 2 s.")
    ] = None,
    dt: Annotated[float, typer.Option(help="Time step in s, in [1e-6, 0.1].")] = 1e-3,
    ground: Annotated[
        bool, typer.Option("--ground", help="Files: add a floor that the lowest point just touches.")
    ] = False,
    floating: Annotated[
        bool | None,
        typer.Option(
            "--floating/--fixed", help="URDF, SDF files: free or fixed base; default: fixed (URDF), the file's (SDF)."
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Of the scene (docs/scenes.md); may be given several times."),
    ] = None,
    law: Annotated[Law, typer.Option(help="Signorini and Coulomb (ncp), or its convex relaxation (ccp).")] = Law.NCP,
    solver: Annotated[Solver, typer.Option(help="The method; auto chooses.")] = Solver.AUTO,
    tolerance: Annotated[float, typer.Option(help="On the certificate of each step, in (0, 1).")] = 1e-6,
    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Keep states and certificates (HDF5).")] = None,
    contacts_every: Annotated[
        int | None,
        typer.Option(metavar="STEPS", help="With --record: contacts of every so many, at least 1; default: 10 ms."),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show it on a web page while it runs.")] = False,
    port: Port = 8080,
    no_open: NoOpen = False,
    no_shadows: NoShadows = False,
    hardest: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Keep the problems of the 10 hardest steps (FCLIB).")
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the last state.")] = None,
    picture_time: Annotated[float | None, typer.Option(help="... or the one at this time in s.")] = None,
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Make a film.")] = None,
    size: Size = SIZE,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE|-", help="Write JSON to FILE, or to standard output.")
    ] = None,
) -> None:
    """Simulate and certify every step.

    Exit status: 0 when every step was solved, 1 when one was not, 2 on bad input.
    """
    errors = printer(stderr=True)
    try:
        source = _source(scene, ground, floating, option or [])
        if record is None:
            refuse_idle(context, "without --record", "--contacts-every")
        if not view:
            refuse_idle(context, "without --view", "--port", "--no-open", "--no-shadows")
        if picture is None:
            refuse_idle(context, "without --picture", "--picture-time")
            if video is None:
                refuse_idle(context, "without --picture or --video", "--size")
        check_outputs(
            {"--record": record, "--picture": picture, "--video": video, "--json": json_file},
            [Path(source["file"])] if "file" in source else [],
        )
        if hardest is not None:
            check_folder("--hardest", hardest)
        start = world, q, v = load_source(source)
        simulator = signorini.Simulator(world, time_step=dt, law=law.value, solver=solver.value, tolerance=tolerance)
        simulator.state.q, simulator.state.v = q, v
        controller = controller_of(source, simulator, start)
        length = _default_duration(source) if duration is None else duration
        if not 0.0 < length <= 1e6:
            raise signorini.InvalidInputError(f"duration: is {length}, must be in (0, 1e6] s")
        for warning in world.warnings:
            errors.print(f"warning: {warning}", style="yellow", soft_wrap=True)
        kept = Hardest(simulator) if hardest is not None else None
        steps = max(1, round(length / dt))
        drawn = picture is not None or video is not None
        shots = Shots(simulator, steps, picture, picture_time, video, size) if drawn else None
        with _page(simulator, scene, port, no_open, not no_shadows) if view else contextlib.nullcontext() as page:
            result = simulate(
                simulator, scene, steps, source, record, errors, kept, controller,
                page=page, contacts_every=contacts_every, shots=shots,
            )  # fmt: skip
            if shots is not None:
                shots.write(errors)
            if page is not None:
                _stay(page)
        files, left_out = kept.write(hardest, scene) if kept is not None and hardest is not None else ([], 0)
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None
    failed = json_file is not None and not write_json(json_file, result, errors)
    if json_file != "-":
        print_result(result)
        if record is not None:
            print(f"recorded in {record}")
        for drawing in (picture, video):
            if drawing is not None:
                print(f"drawn in {drawing}")
        if files:
            print(f"hardest steps: {len(files)} files in {hardest}")
    if left_out:
        errors.print(f"warning: {left_out} of the hardest steps have joint friction, which FCLIB files cannot hold")
    if failed:
        raise typer.Exit(2)
    raise typer.Exit(0 if result["solver"]["unsolved"] == 0 else 1)


@contextlib.contextmanager
def _page(simulator: signorini.Simulator, title: str, port: int, no_open: bool, shadows: bool) -> Iterator[LiveViewer]:
    from signorini.view.viewer import LiveViewer

    with LiveViewer(simulator, title, port=port, shadows=shadows) as page:
        announce(page.url, no_open)
        page.play()
        yield page


def _stay(page: LiveViewer) -> None:
    """The run is over; its page stays until Ctrl-C."""
    page.finish()
    with contextlib.suppress(KeyboardInterrupt):
        page.serve()


def _default_duration(source: Source) -> float:
    if "scene" not in source:
        return 2.0
    from signorini import scenes

    return scenes.worlds()[source["scene"]].duration


def simulate(
    simulator: signorini.Simulator,
    name: str,
    num_steps: int,
    source: Source,
    record: Path | None,
    errors: Console,
    hardest: Hardest | None = None,
    controller: Callable[[], None] | None = None,
    *,
    page: LiveViewer | None = None,
    contacts_every: int | None = None,
    shots: Shots | None = None,
) -> dict[str, Any]:
    """Runs with a progress bar and, if asked, a recording and a page; returns what --json writes.

    With a page, Ctrl-C ends the run early and nothing else; without, it is raised as ever.
    """
    from signorini import recording

    recorder = recording.Recorder(record, simulator, source, contacts_every) if record is not None else None
    energy = simulator.energy.total
    traces = []
    start = time.perf_counter()
    done = 0
    try:
        with (
            _stoppable() as check_stopped,
            Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TimeRemainingColumn(),
                console=errors,
                transient=True,
            ) as progress,
        ):
            task = progress.add_task(name, total=num_steps)
            while done < num_steps:
                check_stopped()
                most = min(BLOCK, num_steps - done)
                if shots is not None:
                    most = min(most, shots.steps_to_next(done))
                count = most if page is None else page.allow(most)
                if hardest is not None:
                    hardest.watch()
                traces.append((recorder or simulator).run(count, controller=controller))
                if hardest is not None:
                    hardest.add(traces[-1])
                done += count
                if shots is not None:
                    shots.look(done)
                if page is not None:
                    page.add(traces[-1])
                progress.advance(task, count)
    except BaseException as error:
        if recorder is not None:
            recorder.close(complete=False)
        if page is None or not traces or not isinstance(error, KeyboardInterrupt):
            raise
        page.stop()
    if recorder is not None and done == num_steps:
        recorder.close()
    num_steps = done
    elapsed = time.perf_counter() - start

    def all_of(field: str) -> Any:
        return np.concatenate([getattr(trace, field) for trace in traces])

    seconds, relative, contacts = all_of("seconds"), all_of("relative"), all_of("num_contacts")
    p50, p99, p99_9 = 1e6 * np.percentile(seconds, [50.0, 99.0, 99.9])
    return {
        "scene": name,
        "dt": simulator.settings.time_step,
        "steps": num_steps,
        "seconds": elapsed,
        "steps_per_second": num_steps / float(seconds.sum()),
        "step_time_us": {"p50": float(p50), "p99": float(p99), "p99_9": float(p99_9)},
        "contacts": {"mean": float(contacts.mean()), "max": int(contacts.max())},
        "solver": {
            "iterations_mean": float(all_of("iterations").mean()),
            "factorizations_mean": float(all_of("factorizations").mean()),
            "unsolved": int(num_steps - all_of("solved").sum()),
        },
        "certificate": {"worst_relative": finite(relative.max()), "mean_relative": finite(relative.mean())},
        "physics": {
            "max_penetration_m": float(all_of("penetration").max()),
            "energy_initial_J": finite(energy),
            "energy_final_J": finite(simulator.energy.total),
        },
        "state_hash": simulator.state_hash,
    }


@contextlib.contextmanager
def _stoppable() -> Iterator[Callable[[], None]]:
    """SIGTERM ends a run as Ctrl-C does: files are closed. Yields a check that raises again what a library's callback
    swallowed."""
    asked = False

    def interrupt(number: int, frame: Any) -> None:
        nonlocal asked
        asked = True
        raise KeyboardInterrupt

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    signals = (signal.SIGINT, signal.SIGTERM)
    try:
        before = [signal.signal(number, interrupt) for number in signals]
    except ValueError:  # not the main thread, where signals do not arrive
        yield check
        return
    try:
        yield check
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)


def print_result(result: dict[str, Any]) -> None:
    table = Table(title=result["scene"], show_header=False)
    table.add_column()
    table.add_column(justify="right")
    times, solver, certificate, physics = (result[key] for key in ("step_time_us", "solver", "certificate", "physics"))
    rows = {
        "steps of [ms]": f"{result['steps']} of {1e3 * result['dt']:g}",
        "steps a second": f"{result['steps_per_second']:.0f}",
        "step time p50, p99, p99.9 [us]": f"{times['p50']:.0f}, {times['p99']:.0f}, {times['p99_9']:.0f}",
        "contacts mean, max": f"{result['contacts']['mean']:.1f}, {result['contacts']['max']}",
        "factorisations a step": f"{solver['factorizations_mean']:.2f}",
        "steps not solved": str(solver["unsolved"]),
        "certificate worst, mean": f"{certificate['worst_relative']:.1e}, {certificate['mean_relative']:.1e}"
        if certificate["worst_relative"] is not None
        else "not finite",
        "deepest penetration [m]": f"{physics['max_penetration_m']:.1e}",
        "energy at start, end [J]": f"{physics['energy_initial_J']:.6g}, {physics['energy_final_J']:.6g}",
        "state": result["state_hash"],
    }
    for key, value in rows.items():
        table.add_row(key, value)
    printer().print(table)


def replay(
    file: Annotated[Path, typer.Argument(metavar="RECORDING", help="What `run --record` wrote.")],
    verify: Annotated[
        bool, typer.Option("--verify", help="Simulate again and compare every state bit for bit.")
    ] = False,
) -> None:
    """Show what a recording holds, or run it again.

    Exit status: 0 when all is well, 1 when --verify finds a difference, 2 on bad input.
    """
    from signorini import recording

    errors = printer(stderr=True)
    try:
        held = recording.read(file)
        name = held.source.get("scene") or held.source.get("file") or "of unknown origin"
        how = "complete" if held.complete else "interrupted"
        print(f"{file}: {name}, {held.num_steps} steps of {1e3 * held.settings.time_step:g} ms, {how}")
        print(f"worst certificate {held.relative.max(initial=0.0):.1e}, state {held.state_hash or 'unknown'}")
        if not verify:
            return
        world, _, _ = load_source(held.source)
        try:
            different = recording.replay(held, signorini.Simulator(world, held.settings))
        except signorini.InvalidInputError as error:
            raise signorini.InvalidInputError(f"{file}: {error}") from None
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None
    if different is None:
        print("every state the same, bit for bit")
        return
    where = f"state after step {different}" if different >= 0 else "state at the start"
    report(errors, f"{'hash of the last state' if different == held.num_steps else where} differs")
    raise typer.Exit(1)


def list_scenes() -> None:
    """List the built-in scenes."""
    from signorini import scenes

    table = Table()
    for column in ("scene", "duration [s]", "what happens", "from"):
        table.add_column(column)
    for scene in scenes.worlds().values():
        table.add_row(scene.name, f"{scene.duration:g}", scene.description, scene.source)
    printer().print(table)
