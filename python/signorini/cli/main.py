from __future__ import annotations

import errno
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

import signorini
from signorini.cli import _streams, check, experiment, picture, run, solve, view

app = typer.Typer(
    help="Robots and contact, simulated; every step certified.", no_args_is_help=True, add_completion=False
)
app.command(name="run")(run.run)
app.command(name="check")(check.check)
app.command(name="replay")(run.replay)
app.command(name="view")(view.view)
app.command(name="picture")(picture.picture)
app.command(name="video")(picture.video)
app.command(name="scenes")(run.list_scenes)
app.command(name="solve")(solve.solve)
app.add_typer(experiment.app, name="experiment")


class _Command(TyperCommand):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuses empty arguments, such as "$UNSET" in a shell: as a Path, that is the working directory."""
        given, _, _ = self.make_parser(ctx).parse_args(args=list(args))
        parameter: Any
        for parameter in self.params:
            value = given.get(parameter.name)
            if "" in (value if isinstance(value, (list, tuple)) else [value]):
                raise typer.BadParameter("is empty", ctx, parameter)
        return super().parse_args(ctx, args)


for _info in (*app.registered_commands, *experiment.app.registered_commands):
    _info.cls = _Command


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"signorini {signorini.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    _streams.guard()
    try:
        try:
            app()
        except SystemExit:
            sys.stdout.flush()  # a full disk is told here, not by the interpreter after its end
            raise
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            raise
        print(f"error: output: {error.strerror}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or the interpreter fails once more at its end
        sys.exit(2)
