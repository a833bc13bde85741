"""The `racines` command, put together from the commands of the four packages."""

import os
import sys
from importlib.metadata import version
from typing import Annotated

import typer

import racines_data.cli.card
import racines_data.cli.data
import racines_data.cli.export
import racines_data.cli.hub
import racines_data.cli.importing
import racines_data.cli.phantom
import racines_envs.cli.agents
import racines_envs.cli.drive
import racines_envs.cli.explain
import racines_envs.cli.export
import racines_models.cli.commands
import racines_models.cli.export
from racines_data.errors import RacinesError
from racines_leaderboard.cli import audit as cli_audit
from racines_leaderboard.cli import board as commands
from racines_leaderboard.cli import determinism as cli_determinism
from racines_leaderboard.cli import studio as cli_studio
from racines_leaderboard.cli import submit as cli_submit
from racines_leaderboard.cli.expert import expert

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
app.add_typer(racines_data.cli.phantom.phantom, name="phantom")
app.add_typer(train, name="train")
app.add_typer(evaluate, name="eval")
app.add_typer(racines_models.cli.export.export, name="export")
racines_models.cli.commands.register(train, evaluate)
racines_envs.cli.agents.register(train, evaluate)
racines_envs.cli.drive.register(app)
racines_envs.cli.explain.register(app)
racines_envs.cli.export.register(racines_models.cli.export.export)
commands.register(app)
app.add_typer(expert, name="expert")
cli_submit.register(app)
cli_audit.register(app)
cli_determinism.register(app)
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
