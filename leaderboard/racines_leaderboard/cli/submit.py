"""The command `racines submit`."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.terminal import say, say_json


def submit(
    source: Annotated[Path, typer.Argument(help="The submission.yaml, or the folder with it.")],
    out: opt.Out = opt.SUBMISSIONS,
    data: opt.Data = opt.DATA,
    force: opt.Force = False,
    fetch: Annotated[
        bool, typer.Option("--fetch", help="Fetch the artefacts that are at a URL.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Check it where it lies; nothing is copied.")
    ] = False,
    new: Annotated[
        bool, typer.Option("--new", help="Write a submission.yaml to fill in, and stop.")
    ] = False,
    recompute: Annotated[
        bool, typer.Option("--recompute", help="Then score it again, into the board of --params.")
    ] = False,
    secret: opt.Secret = None,
    params: opt.Params = None,
    no_grader: opt.NoGrader = False,
    results: opt.Results = opt.RESULTS,
    unconfined: opt.Unconfined = False,
    track: Annotated[
        str,
        typer.Option(help="With --new: generators, agents, motion, or patient-, turn-, tracked-…."),
    ] = "generators",
    as_json: opt.AsJson = False,
) -> None:
    """Check a submission, try the contract on it, and put it in its place.

    No code of its maker's is run, nothing half-written. Whether images follow their poses shows
    where the dataset that it names is at --data. With --recompute it is scored again at once, with
    --secret also on fresh draws, as `racines leaderboard --recompute` does.
    """
    if new:
        from racines_leaderboard.submissions.template import write_template

        written = write_template(source, track)
        if as_json:
            return say_json({"written": str(written)})
        return say(f"written: {written}: fill it in, then: racines submit")
    if check and (force or fetch):
        raise typer.BadParameter("--check copies nothing: leave out --force and --fetch")
    if check and recompute:
        raise typer.BadParameter("--check copies nothing: score it again without it")
    if secret is not None and not recompute:
        raise typer.BadParameter("--secret goes with --recompute")
    from racines_data.errors import RacinesError

    if not source.exists() and not source.is_symlink():
        raise RacinesError(f"{source}: no such file or folder: give that of submission.yaml")
    from racines_leaderboard.submissions.confined.session import Limits
    from racines_leaderboard.submissions.document import KINDS, rescored
    from racines_leaderboard.submissions.intake import look_at, take_in

    limits = Limits(unconfined=unconfined)
    if check:
        taken = look_at(source, out, limits, data)
    else:
        taken = take_in(source, out, replace=force, fetching=fetch, limits=limits, data=data)
    document, again = taken.document, rescored(taken.document)
    if recompute:
        from racines_leaderboard.cli.board import score_again

        name = f"{document['track']}/{document['name']}"
        score_again([name], None, params, data, no_grader, results, out, unconfined, force, secret)
    if as_json:
        told = {"folder": str(taken.folder), "rescored": [each["path"] for each in again]}
        probed = {"held": sorted(taken.probed.held), "untold": taken.probed.untold}
        told = document | told | {"remote": list(taken.remote), "contract": probed}
        say_json(told, indent=2)
        return
    say(f"{taken.folder}: sound ({document['name']}, {document['track']}).")
    for name in taken.remote:
        say(f"Left at its URL and not looked into: {name}; --fetch takes it in.")
    if taken.probed.held:
        say(f"Contract: {', '.join(sorted(taken.probed.held))} hold.")
    for clause, reason in taken.probed.untold.items():
        say(f"Contract, not tried: {clause}: {reason}.")
    if again:
        what = ", ".join(f"{each['path']} ({KINDS[each['kind']].told})" for each in again)
        say(f"Scored again: {what}.")
        place = f"{document['track']}/{document['name']}"
        if not recompute:
            step = f"submit {source}" if check else f"leaderboard --recompute {place}"
            say(f"Next: racines {step}")
    else:
        say(
            "Nothing here can be scored again: scores stay self-reported until it is trained again."
        )
        say("Next: racines leaderboard --collect FOLDER_OF_SCORES")
