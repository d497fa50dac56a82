"""signorini view: a recording as a web page, or as one HTML file."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

import signorini
from signorini.cli._output import check_outputs, printer, refuse_idle, report

if TYPE_CHECKING:
    from signorini.view.looks import Looks

Port = Annotated[int, typer.Option(min=0, max=65535, help="Of the web page; 0 takes a free one.")]
Host = Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 lets everybody in.")]
NoOpen = Annotated[bool, typer.Option("--no-open", help="Do not open a browser.")]
NoShadows = Annotated[bool, typer.Option("--no-shadows", help="No shadows: faster without a graphics card.")]


def view(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="RECORDING", help="What `run --record` wrote.")],
    port: Port = 8080,
    host: Host = "127.0.0.1",
    no_open: NoOpen = False,
    no_shadows: NoShadows = False,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write one HTML file that needs no server, and stop.")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="With --html: frames a second, in (0, 240]; default: 30.", show_default=False)
    ] = None,
) -> None:
    """Show a recording on a web page, to everybody who opens it; Ctrl-C ends.

    Exit status: 0 when all is well, 2 on bad input.
    """
    errors = printer(stderr=True)
    try:
        from signorini import recording
        from signorini.view import viewer

        if html is None:
            refuse_idle(context, "without --html", "--fps")
        else:
            refuse_idle(context, "with --html", "--port", "--host", "--no-open")
        check_outputs({"--html": html}, [file])
        held = recording.read(file)
        looks = looks_of(file, held)
        if html is not None:
            with Progress(
                TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
                console=errors, transient=True,
            ) as progress:  # fmt: skip
                task = progress.add_task("frames", total=1.0)
                size = viewer.write_html(
                    held, looks, html, fps=30.0 if fps is None else fps, shadows=not no_shadows,
                    progress=lambda share: progress.update(task, completed=share),
                )  # fmt: skip
            print(f"{html}: {size / 1e6:.1f} MB")
            return
        page = viewer.view(held, looks, file.name, host=host, port=port, shadows=not no_shadows)
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        report(errors, error)
        raise typer.Exit(2) from None
    with page:
        announce(page.url, no_open)
        page.play()
        try:
            page.serve()
        except KeyboardInterrupt:
            print()


def looks_of(file: Path, held: signorini.recording.Recording) -> Looks:
    """Of version 1, which has no meshes: of the world that was recorded."""
    from signorini.view.looks import Looks

    return held.looks or Looks.of(_world_of(file, held))


def _world_of(file: Path, held: signorini.recording.Recording) -> signorini.World:
    from signorini.cli.run import load_source

    try:
        return load_source(held.source)[0]
    except (signorini.InvalidInputError, OSError, ImportError) as error:
        raise signorini.InvalidInputError(
            f"{file}: is of version 1, which holds no meshes, and what it was made from cannot be read: {error}"
        ) from None


def announce(url: str, no_open: bool) -> None:
    print(f"{url} (Ctrl-C ends)", flush=True)
    somebody_looks = sys.platform in ("darwin", "win32") or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ
    if not no_open and somebody_looks and "SSH_CONNECTION" not in os.environ:
        webbrowser.open(url)
