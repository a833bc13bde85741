"""The `racines` command, put together from the commands of the four packages."""

import os
import sys
from importlib.metadata import version
from typing import Annotated

import typer

import racines_data.cli
import racines_data.cli_card
import racines_data.cli_export
import racines_data.cli_hub
import racines_data.cli_import
import racines_data.cli_phantom
import racines_envs.cli
import racines_envs.cli_drive
import racines_envs.cli_explain
import racines_envs.cli_export
import racines_models.cli
import racines_models.cli_export
from racines_data.errors import RacinesError
from racines_leaderboard import cli_studio, cli_submit, commands
from racines_leaderboard.expert.cli import expert

app = typer.Typer(
    help="RACINES, the open benchmark for robotic cardiac ultrasound. Not a medical device.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
train = typer.Typer(help="Train a grader, a generator or an agent.", no_args_is_help=True)
evaluate = typer.Typer(help="Score a generator or an agent.", no_args_is_help=True)

app.add_typer(racines_data.cli.data, name="data")
app.add_typer(racines_data.cli_phantom.phantom, name="phantom")
app.add_typer(train, name="train")
app.add_typer(evaluate, name="eval")
app.add_typer(racines_models.cli_export.export, name="export")
racines_models.cli.register(train, evaluate)
racines_envs.cli.register(train, evaluate)
racines_envs.cli_drive.register(app)
racines_envs.cli_explain.register(app)
racines_envs.cli_export.register(racines_models.cli_export.export)
commands.register(app)
app.add_typer(expert, name="expert")
cli_submit.register(app)
cli_studio.register(app)


@app.callback(invoke_without_command=True)
def root(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and stop.", is_eager=True)
    ] = False,
) -> None:
    """RACINES, the open benchmark for robotic cardiac ultrasound. Not a medical device."""
    if show_version:
        typer.echo(f"racines {version('racines')}")
        raise typer.Exit


def main() -> None:
    """Run the command; a refused input is one line on stderr and exit code 1."""
    # A plug-in named module:Class may stand in the current folder; last, so that it hides nothing.
    sys.path.append(os.getcwd())
    try:
        app()
    except RacinesError as error:
        print(f"racines: {error}", file=sys.stderr)
        raise SystemExit(1) from error
