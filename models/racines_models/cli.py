"""What this package adds to the verbs `racines train` and `racines eval`."""

import typer


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add the commands for graders and generators."""
    from racines_models import cli_generators, cli_scores

    cli_generators.register(train)
    cli_scores.register(train, evaluate)
