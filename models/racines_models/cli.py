"""What this package adds to the verbs `racines train`, `racines eval` and `racines data`."""

import typer

from racines_data.cli import data


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add the commands for graders and generators, and those that use them on a dataset."""
    from racines_models import (
        cli_conditioning,
        cli_data,
        cli_export,
        cli_floor,
        cli_gallery,
        cli_generators,
        cli_grader,
        cli_pose,
        cli_publish,
        cli_realism,
        cli_scores,
    )

    cli_generators.register(train)
    cli_scores.register(train, evaluate)
    cli_grader.register(train, evaluate)
    cli_pose.register(train)
    cli_gallery.register(evaluate)
    cli_floor.register(evaluate)
    cli_realism.register(evaluate)
    cli_conditioning.register(evaluate)
    cli_data.register(data)
    cli_publish.register(cli_export.export)
