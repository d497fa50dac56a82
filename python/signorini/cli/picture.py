"""signorini picture, video: what recordings look like; and the same of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

import signorini
from signorini.cli._output import check_outputs, printer, report

if TYPE_CHECKING:
    from signorini.view.picture import Array, Forces, Stage
    from signorini.view.recorded import Recorded

SIZE = "1280x720"

File = Annotated[Path, typer.Argument(metavar="RECORDING", help="What `run --record` wrote.")]
Size = Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Pixels, each in [16, 4096]; of films even.")]
Collision = Annotated[bool, typer.Option("--collision", help="Draw what collides in place of what is seen.")]
ShowForces = Annotated[bool, typer.Option("--forces/--no-forces", help="Arrows for contact forces.")]


def parse_size(text: str, even: bool = False) -> tuple[int, int]:
    """(width, height) of "1280x720", or InvalidInputError."""
    from signorini.view.picture import checked_size

    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise signorini.InvalidInputError(f"size: is {text!r}, must be WIDTHxHEIGHT, as {SIZE}")
    return checked_size((int(width), int(height)), even)


def picture(
    file: File,
    output: Annotated[Path, typer.Argument(metavar="FILE.png", help="Where to write it.")],
    time: Annotated[float | None, typer.Option(help="Of the state, in s; default: the last.")] = None,
    size: Size = SIZE,
    collision: Collision = False,
    forces: ShowForces = True,
) -> None:
    """Draw one state of a recording.

    Exit status: 0, or 2 on bad input.
    """
    from signorini.view.picture import checked_suffix, write_png

    errors = printer(stderr=True)
    try:
        checked_suffix(output, ".png")
        check_outputs({"FILE.png": output}, [file])
        pixels = parse_size(size)
        shown = _recorded(file)
        row = shown.row(time)
        stage = shown.stage(collision=collision, size=pixels)
        arrows = shown.forces(row) if forces else None
        write_png(output, stage.draw(shown.q(row), arrows, camera=stage.camera([shown.q(row)])))
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None


def video(
    file: File,
    output: Annotated[Path, typer.Argument(metavar="FILE.mp4", help="Where to write it.")],
    fps: Annotated[float, typer.Option(help="Frames a second, in [1, 240].")] = 30.0,
    size: Size = SIZE,
    speed: Annotated[float, typer.Option(help="Simulated seconds a second, in [0.001, 1000].")] = 1.0,
    start: Annotated[float | None, typer.Option("--from", help="Simulated time in s; default: the start.")] = None,
    end: Annotated[float | None, typer.Option("--to", help="Simulated time in s; default: the end.")] = None,
    collision: Collision = False,
    forces: ShowForces = True,
) -> None:
    """Make a film of a recording: AV1 in an MP4 file.

    Exit status: 0, or 2 on bad input.
    """
    from signorini.view.picture import checked_suffix
    from signorini.view.recorded import interval
    from signorini.view.video import rows

    errors = printer(stderr=True)
    try:
        checked_suffix(output, ".mp4")
        check_outputs({"FILE.mp4": output}, [file])
        pixels = parse_size(size, even=True)
        shown = _recorded(file)
        first, length = interval(start, end, shown.duration)
        steps = [min(row, shown.row(None)) for row in rows(length, shown.time_step, fps, speed, first)]
        stage = shown.stage(collision=collision, size=pixels)
        arrows = [shown.forces(row) if forces else None for row in steps]
        _film(output, stage, [shown.q(row) for row in steps], arrows, fps, errors)
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None


def _recorded(file: Path) -> Recorded:
    from signorini import recording
    from signorini.cli.view import looks_of
    from signorini.view.recorded import Recorded

    held = recording.read(file)
    return Recorded(held, looks_of(file, held))


def _film(
    output: Path,
    stage: Stage,
    states: list[Array],
    forces: Sequence[Forces | None],
    fps: float,
    errors: Console,
) -> None:
    from signorini.view.video import film

    columns = (TextColumn("drawing"), BarColumn(), TextColumn("{task.completed}/{task.total}"), TimeRemainingColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        task = progress.add_task("", total=len(states))
        film(output, stage, states, forces, fps=fps, progress=lambda: progress.advance(task))


class Shots:
    """The states of a run that are to be drawn, and drawing them once it is over."""

    def __init__(
        self,
        simulator: signorini.Simulator,
        num_steps: int,
        picture: Path | None,
        picture_time: float | None,
        video: Path | None,
        size: str,
    ) -> None:
        """Raises InvalidInputError and ImportError before anything is simulated."""
        from signorini.view.picture import Stage, checked_suffix
        from signorini.view.video import FPS, rows

        self._simulator, self._picture, self._video = simulator, picture, video
        time_step = simulator.settings.time_step
        duration = num_steps * time_step
        if picture is not None:
            checked_suffix(picture, ".png")
        if video is not None:
            checked_suffix(video, ".mp4")
        if picture_time is not None and not 0.0 <= picture_time <= duration * (1.0 + 1e-9):
            raise signorini.InvalidInputError(f"picture-time: is {picture_time}, must be in [0, {duration:g}] s")
        self._stage = Stage.of_world(simulator.world, size=parse_size(size, even=video is not None))
        self._picture_row = num_steps if picture_time is None else min(num_steps, round(picture_time / time_step))
        self._rows = [min(num_steps, row) for row in rows(duration, time_step)] if video is not None else []
        self._fps = FPS
        self._wanted = {*self._rows, *([self._picture_row] if picture is not None else [])}
        self._states: dict[int, Array] = {}
        self._forces: dict[int, Forces] = {}
        self.look(0)

    def steps_to_next(self, done: int) -> int:
        """Until a state that is to be drawn."""
        return min((row - done for row in self._wanted if row > done), default=2**31)

    def look(self, done: int) -> None:
        """Keeps the state after this many steps, if it is to be drawn."""
        from signorini.view.picture import Forces

        if done in self._wanted:
            self._states[done] = self._simulator.state.q.copy()
            self._forces[done] = Forces.of(self._simulator.contacts)

    def write(self, errors: Console) -> None:
        """Draws them; of a run that ended early, what there is."""
        from signorini.view.picture import Forces, write_png

        if self._picture is not None:
            q, forces = self._states.get(self._picture_row), self._forces.get(self._picture_row)
            if q is None:
                q, forces = self._simulator.state.q, Forces.of(self._simulator.contacts)
            write_png(self._picture, self._stage.draw(q, forces, camera=self._stage.camera([q])))
        if self._video is not None:
            rows = [row for row in self._rows if row in self._states]
            states, forces_of_all = [self._states[row] for row in rows], [self._forces[row] for row in rows]
            _film(self._video, self._stage, states, forces_of_all, self._fps, errors)
