from __future__ import annotations

from typing import Annotated

import typer

import signorini
from signorini.cli import experiment, solve

app = typer.Typer(help="Frictional contact problems, solved and certified.", no_args_is_help=True, add_completion=False)
app.command(name="solve")(solve.solve)
app.add_typer(experiment.app, name="experiment")


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
    app()
