"""signorini run, replay, scenes: simulate a scene or a robot file, certify every step, record it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

import signorini
from signorini._hardest import Hardest
from signorini.cli._output import finite, report, write_json
from signorini.cli.solve import Law, Solver

BLOCK = 50  # steps between two looks at the progress bar
Source = dict[str, Any]


def load_source(source: Source) -> tuple[signorini.World, Any, Any]:
    """World, q and v at the start, from what a recording keeps of where they came from."""
    if "scene" in source:
        from signorini import scenes

        known = scenes.worlds()
        if source["scene"] not in known:
            raise signorini.InvalidInputError(f"scene: there is no {source['scene']!r}; there are {', '.join(known)}")
        return known[source["scene"]](**source.get("options", {}))
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
            raise signorini.InvalidInputError(f"{scene}: there is no such file, nor a scene of that name")
        if options:
            raise signorini.InvalidInputError("option: is for scenes, not for files")
        return {"file": str(Path(scene).resolve()), "ground": ground, "floating_base": floating}
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
    scene: Annotated[str, typer.Argument(metavar="SCENE|FILE", help="A scene of `signorini scenes`, or a robot file.")],
    duration: Annotated[
        float | None, typer.Option(help="Simulated time [s]; default: the scene's own, files 2 s.")
    ] = None,
    dt: Annotated[float, typer.Option(help="Time step [s], in [1e-6, 0.1].")] = 1e-3,
    ground: Annotated[bool, typer.Option("--ground", help="Files: add a floor below z = 0.")] = False,
    floating: Annotated[
        bool | None, typer.Option("--floating/--fixed", help="URDF files: free or fixed base; default: fixed.")
    ] = None,
    option: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="Of a scene; again for more.")] = None,
    law: Annotated[Law, typer.Option(help="Signorini and Coulomb (ncp), or its convex relaxation (ccp).")] = Law.NCP,
    solver: Annotated[Solver, typer.Option(help="The method; auto chooses.")] = Solver.AUTO,
    tolerance: Annotated[float, typer.Option(help="On the relative residual of each step, in (0, 1).")] = 1e-6,
    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Keep states and certificates (HDF5).")] = None,
    hardest: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Keep the problems of the 10 hardest steps (FCLIB).")
    ] = None,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE|-", help="Write JSON to FILE, or to standard output.")
    ] = None,
) -> None:
    """Simulate and certify every step.

    Exit status: 0 when every step was solved, 1 when one was not, 2 on bad input.
    """
    errors = Console(stderr=True)
    try:
        source = _source(scene, ground, floating, option or [])
        start = world, q, v = load_source(source)
        simulator = signorini.Simulator(world, time_step=dt, law=law.value, solver=solver.value, tolerance=tolerance)
        simulator.state.q, simulator.state.v = q, v
        controller = controller_of(source, simulator, start)
        length = _default_duration(source) if duration is None else duration
        if not 0.0 < length <= 1e6:
            raise signorini.InvalidInputError(f"duration: is {length}, must be in (0, 1e6] s")
        for warning in world.warnings:
            errors.print(f"warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
        if hardest is not None:
            hardest.mkdir(parents=True, exist_ok=True)
        kept = Hardest(simulator) if hardest is not None else None
        result = simulate(simulator, scene, max(1, round(length / dt)), source, record, errors, kept, controller)
        files, left_out = kept.write(hardest, scene) if kept is not None and hardest is not None else ([], 0)
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None
    except TypeError as error:  # an option that the scene does not have
        report(errors, f"option: {error}")
        raise typer.Exit(2) from None
    failed = json_file is not None and not write_json(json_file, result, errors)
    if json_file != "-":
        print_result(result)
        if record is not None:
            print(f"recorded in {record}")
        if files:
            print(f"hardest steps: {len(files)} files in {hardest}")
    if left_out:
        errors.print(f"warning: {left_out} of the hardest steps have joint friction, which FCLIB files cannot hold")
    if failed:
        raise typer.Exit(2)
    raise typer.Exit(0 if result["solver"]["unsolved"] == 0 else 1)


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
) -> dict[str, Any]:
    """Runs with a progress bar and, if asked, a recording; returns what --json writes."""
    from signorini import recording

    recorder = recording.Recorder(record, simulator, source) if record is not None else None
    energy = simulator.energy.total
    traces = []
    start = time.perf_counter()
    try:
        with Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            console=errors,
            transient=True,
        ) as progress:
            task = progress.add_task(name, total=num_steps)
            for first in range(0, num_steps, BLOCK):
                count = min(BLOCK, num_steps - first)
                if hardest is not None:
                    hardest.watch()
                traces.append(simulator.run(count, controller=controller, keep_states=recorder is not None))
                if hardest is not None:
                    hardest.add(traces[-1])
                if recorder is not None:
                    recorder.add(traces[-1])
                progress.advance(task, count)
    except BaseException:
        if recorder is not None:
            recorder.close(complete=False)
        raise
    if recorder is not None:
        recorder.close()
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
    Console().print(table)


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")],
    verify: Annotated[
        bool, typer.Option("--verify", help="Simulate again and compare every state bit for bit.")
    ] = False,
) -> None:
    """Show what a recording holds, or run it again.

    Exit status: 0 when all is well, 1 when --verify finds a difference, 2 on bad input.
    """
    from signorini import recording

    errors = Console(stderr=True)
    try:
        held = recording.read(file)
        name = held.source.get("scene") or held.source.get("file")
        how = "complete" if held.complete else "interrupted"
        print(f"{file}: {name}, {held.num_steps} steps of {1e3 * held.settings.time_step:g} ms, {how}")
        print(f"worst certificate {held.relative.max(initial=0.0):.1e}, state {held.state_hash}")
        if not verify:
            return
        world, _, _ = load_source(held.source)
        different = recording.replay(held, signorini.Simulator(world, held.settings))
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None
    if different is None:
        print("every state the same, bit for bit")
        return
    report(errors, f"state after step {different} differs")
    raise typer.Exit(1)


def list_scenes() -> None:
    """List the built-in scenes."""
    from signorini import scenes

    table = Table()
    for column in ("scene", "duration [s]", "what happens", "from"):
        table.add_column(column)
    for scene in scenes.worlds().values():
        table.add_row(scene.name, f"{scene.duration:g}", scene.description, scene.source)
    Console().print(table)
