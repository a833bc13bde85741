"""A command of ours, called in the process and folder of a test."""

from typer.testing import CliRunner

from racines_leaderboard.cli.command import app


def racines(*words: str, code: int = 0) -> str:
    """Run `racines` with these words, which has to end with a code; return what it printed."""
    done = CliRunner().invoke(app, list(words), catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.stdout
