"""The command `racines studio`."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.extras import needed
from racines_data.terminal import say, say_json
from racines_models.cli.device import Device


def studio(
    host: Annotated[
        str,
        typer.Option(
            help="Address to listen at; 0.0.0.0, with --allow-host, lets other machines in."
        ),
    ] = "127.0.0.1",
    allow_host: Annotated[
        list[str] | None,
        typer.Option(help="A name that it may be asked for by, beside localhost; repeatable."),
    ] = None,
    framed_by: Annotated[
        list[str] | None,
        typer.Option(help="Origin of a page that may show it in a frame; repeatable."),
    ] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to listen at.")] = 7860,
    tab: Annotated[
        list[str] | None, typer.Option(help="Show this tab; repeatable.  [default: all]")
    ] = None,
    data: opt.Data = opt.DATA,
    results: opt.Results = opt.RESULTS,
    submissions: opt.Submissions = opt.SUBMISSIONS,
    weights: Annotated[Path, typer.Option(help="Published weights.")] = Path("models/weights"),
    runs: opt.Runs = Path("models/runs"),
    agents: Annotated[Path, typer.Option(help="Trained agents.")] = Path("envs/runs"),
    policies: Annotated[Path, typer.Option(help="Published agents.")] = Path("envs/weights"),
    kits: Annotated[Path, typer.Option(help="Folder of expert kits.")] = Path("study"),
    seed: opt.DrawSeed = 0,
    device: Device = "cpu",
    max_sessions: Annotated[
        int, typer.Option(min=1, max=10_000, help="Visitors whose state is kept.")
    ] = 200,
    as_json: opt.AsJson = False,
) -> None:
    """Show the boards, the study and the data in a browser, on this machine alone by default."""
    from racines_leaderboard.studio.parts import Place

    needed("gradio", "the Studio")
    from racines_leaderboard.studio.app import serve

    place = Place(
        data, results, submissions, weights, runs, agents, kits, seed, device,
        max_sessions, policies,
    )  # fmt: skip
    address = f"http://{host}:{port}"
    if as_json:
        say_json({"address": address})
    else:
        say(f"RACINES Studio: {address} (Ctrl-C stops it)")
    serve(place, host, port, tab, hosts=allow_host or (), framed_by=framed_by or ())
