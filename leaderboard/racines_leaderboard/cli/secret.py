"""The commands `racines board commit-secret` and `reveal`: rounds of fresh draws."""

import datetime
import secrets
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.terminal import say, say_json

Named = Annotated[str, typer.Argument(help="Name of the board.")]


def commit_secret(
    board: Named,
    out: opt.OwnOutFile = None,
    results: opt.Results = opt.RESULTS,
    as_json: opt.AsJson = False,
) -> None:
    """Begin a round of fresh draws: draw a nonce of 256 bits and publish its SHA-256.

    The nonce goes to a private file outside the results, by default under ~/.local/share/racines;
    the commitment to secrets.json of the board. Nothing shows the nonce before reveal.
    """
    from racines_leaderboard.fresh import rounds

    private = rounds.commit(results, board, secrets.token_bytes(rounds.SIZE), today(), out)
    entry = rounds.read_history(results, board)[-1]
    if as_json:
        say_json(entry | {"private": str(private)}, indent=2)
        return
    say(f"Round {entry['round']} of {board}: commitment {entry['commitment']}")
    say(f"Written: {results / board / rounds.HISTORY}: publish it before anything is drawn.")
    say(f"The nonce: {private}: keep it, show it to nobody, never commit it.")


def reveal(
    board: Named,
    secret: opt.Secret = None,
    results: opt.Results = opt.RESULTS,
    as_json: opt.AsJson = False,
) -> None:
    """End the open round: check its nonce against the commitment and publish it.

    From then on anybody can draw the same, and nothing that is drawn later counts as secret.
    """
    from racines_leaderboard.fresh import rounds

    number = len(rounds.read_history(results, board))
    path = secret or rounds.default_file(board, max(number, 1))
    history = rounds.reveal(results, rounds.read_secret(path, results, board), today())
    entry = rounds.read_history(results, board)[-1]
    if as_json:
        say_json(entry, indent=2)
        return
    say(f"Round {entry['round']} of {board}: the nonce is in {history}. Publish that file.")
    say(f"Whoever wants to draw it again: racines leaderboard --recompute NAME --secret {history}")


def today() -> str:
    """Return the date, in UTC, as history and files of fresh draws write it."""
    return datetime.datetime.now(datetime.UTC).date().isoformat()
