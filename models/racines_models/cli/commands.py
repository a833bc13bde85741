"""What this package adds to the verbs `racines train`, `racines eval` and `racines data`."""

import typer

from racines_data.cli.data import data


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add the commands for graders and generators, and those that use them on a dataset."""
    from racines_models.cli import conditioning as cli_conditioning
    from racines_models.cli import data as cli_data
    from racines_models.cli import export as cli_export
    from racines_models.cli import floor as cli_floor
    from racines_models.cli import gallery as cli_gallery
    from racines_models.cli import generators as cli_generators
    from racines_models.cli import grader as cli_grader
    from racines_models.cli import pose as cli_pose
    from racines_models.cli import publish as cli_publish
    from racines_models.cli import realism as cli_realism
    from racines_models.cli import scores as cli_scores

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
