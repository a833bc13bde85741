"""Commands: `racines eval transfer`, `racines eval rewards` and `racines eval curves`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_envs.cli.settings import Device, given, phantom_config, read_settings

SCORES = Path("envs/runs/scores")
Agents = "Names or run folders, comma-separated or given again; LABEL=RUN names one."

Starts = Annotated[int | None, typer.Option(help="Episodes from each start set.")]
Seeds = Annotated[str | None, typer.Option(help="Start sets, comma-separated: 0,1,2.")]
View = Annotated[str | None, typer.Option(help="Target view; that of the agents by default.")]
Params = Annotated[Path | None, typer.Option(help="Settings; ./params.yaml if it is there.")]
Profile = Annotated[str | None, typer.Option(help="Packaged settings.")]
Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]


def register(evaluate: typer.Typer) -> None:
    """Add the commands that compare agents to `racines eval`."""
    evaluate.command("transfer")(transfer)
    evaluate.command("rewards")(rewards)
    evaluate.command("curves")(curves)


def transfer(
    agents: Annotated[list[str], typer.Option(help=Agents)],
    backends: Annotated[
        list[str],
        typer.Option(help="phantom, generator:<name, folder or FILE.onnx>, replay:<dataset>."),
    ],
    view: View = None,
    starts: Starts = None,
    seeds: Seeds = None,
    device: Device = None,
    out: Annotated[
        Path, typer.Option(help="JSON; the heat map and the table go beside it.")
    ] = SCORES / "transfer.json",
    params: Params = None,
    profile: Profile = None,
    as_json: Json = False,
) -> None:
    """Run agents in every backend, judged by the phantom's truth; rank correlation of backends."""
    from racines_data.config import fill, section
    from racines_data.files import write_atomic, write_json
    from racines_envs.evaluation.agent_specs import find_runs
    from racines_envs.studies.transfer import run as work
    from racines_envs.studies.transfer.pages import draw_transfer, transfer_markdown

    settings = read_settings(params, profile)
    chosen = given(view=view, starts=starts, seeds=integers(seeds), device=device)
    config = fill(work.TransferConfig, section(settings, "transfer") | chosen, "transfer")
    runs = find_runs(_listed(agents))
    content = work.transfer(runs, _listed(backends), config, phantom_config(settings))
    table = transfer_markdown(content)
    draw_transfer(content, out.with_suffix(".png"))
    write_atomic(out.with_suffix(".md"), table)
    write_json(out, content)
    _say(content, table, out, as_json)


def rewards(
    agents: Annotated[list[str], typer.Argument(help=Agents)],
    view: View = None,
    starts: Starts = None,
    seeds: Seeds = None,
    reward: Annotated[
        str | None, typer.Option(help="oracle, paper, shaped: those to settle, comma-separated.")
    ] = None,
    grader: Annotated[
        str | None, typer.Option(help="Grader for `paper`: run folder; models/runs/grader.")
    ] = None,
    device: Device = None,
    out: Annotated[
        Path, typer.Option(help="JSON; the picture and the table go beside it.")
    ] = SCORES / "rewards.json",
    params: Params = None,
    profile: Profile = None,
    as_json: Json = False,
) -> None:
    """Hold what agents earn, under every reward and termination rule, beside what they reach."""
    from racines_data.config import fill, section
    from racines_data.files import write_atomic, write_json
    from racines_envs.evaluation.agent_specs import find_runs
    from racines_envs.studies.rewards import report as work
    from racines_envs.studies.rewards.pages import draw_returns, reward_markdown

    settings = read_settings(params, profile)
    chosen = given(
        view=view, starts=starts, seeds=integers(seeds), grader=grader, device=device,
        rewards=tuple(_listed([reward])) if reward else None,
    )  # fmt: skip
    config = fill(work.RewardReportConfig, section(settings, "rewards") | chosen, "rewards")
    runs = find_runs(_listed(agents))
    content, episodes = work.reward_report(runs, config, phantom_config(settings))
    table = reward_markdown(content)
    draw_returns(episodes, content["view"], out.with_suffix(".png"))
    write_atomic(out.with_suffix(".md"), table)
    write_json(out, content)
    _say(content, table, out, as_json)


def curves(
    runs: Annotated[
        list[str], typer.Argument(help="Run folders; LABEL=RUN joins seeds under one label.")
    ],
    paper: Annotated[
        bool, typer.Option("--paper/--no-paper", help="Draw the paper's levels.")
    ] = True,
    out: Annotated[Path, typer.Option(help="The picture.")] = SCORES / "curves.png",
    as_json: Json = False,
) -> None:
    """Draw success, steps and return of validations against environment steps."""
    import json

    from racines_envs.studies.curves import draw_curves, read_curves

    content = read_curves(_listed(runs))
    draw_curves(content, out, paper)
    typer.echo(json.dumps(content) if as_json else f"written: {out}")


def _listed(values: list[str]) -> list[str]:
    """Return the words of lists that are separated by commas."""
    return [word for value in values for word in value.split(",") if word]


def integers(text: str | None) -> tuple[int, ...] | None:
    """Return the integers of a list; what is none is bad usage."""
    try:
        return None if text is None else tuple(int(word) for word in _listed([text]))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r}: give integers, comma-separated") from error


def _say(content: dict[str, Any], table: str, out: Path, as_json: bool) -> None:
    import json

    if as_json:
        typer.echo(json.dumps(content, indent=2))
    else:
        typer.echo(table)
        typer.echo(f"written: {out}, {out.with_suffix('.png').name}, {out.with_suffix('.md').name}")
