"""The command `racines study rewards`. Heavy imports stand inside, so that --help is instant."""

from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, read_settings
from racines_envs.cli.settings import Agents, phantom_config
from racines_envs.cli.study.lists import SCORES, Seeds, integers, listed, publish
from racines_models.cli.device import OneDevice


def reward_audit(
    agents: Annotated[list[str], typer.Argument(help=Agents)],
    view: opt.View = None,
    starts: opt.Starts = None,
    seeds: Seeds = None,
    rewards: Annotated[
        str | None, typer.Option(help="oracle, paper, shaped: those to settle, comma-separated.")
    ] = None,
    grader: opt.Grader = None,
    device: OneDevice = None,
    out: opt.OutFile = SCORES / "rewards.json",
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Hold what agents earn, under every reward and termination rule, beside what they reach.

    Writes OUT, and a picture and a table beside it. `paper` needs a grader.
    """
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_runs
    from racines_envs.studies import rewards as work

    settings = read_settings(params, profile)
    chosen = given(
        view=view, starts=starts, seeds=integers(seeds), grader=grader, device=device,
        rewards=tuple(listed([rewards])) if rewards else None,
    )  # fmt: skip
    config = fill(work.RewardReportConfig, section(settings, "rewards") | chosen, "rewards")
    runs = find_runs(listed(agents))
    content, episodes = work.reward_report(runs, config, phantom_config(settings))
    table = work.reward_markdown(content)
    work.draw_returns(episodes, content["view"], out.with_suffix(".png"))
    publish(content, table, out, as_json)
