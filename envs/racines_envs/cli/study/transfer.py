"""The command `racines study transfer`. Heavy imports stand inside, so that --help is instant."""

from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, read_settings
from racines_envs.cli.settings import Agents, phantom_config
from racines_envs.cli.study.lists import SCORES, Seeds, integers, listed, publish
from racines_models.cli.device import OneDevice


def transfer(
    agents: Annotated[list[str], typer.Option(help=Agents)],
    backends: Annotated[
        list[str],
        typer.Option(help="phantom, generator:<name, folder or FILE.onnx>, replay:<dataset>."),
    ],
    view: opt.View = None,
    starts: opt.Starts = None,
    seeds: Seeds = None,
    device: OneDevice = None,
    out: opt.OutFile = SCORES / "transfer.json",
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Run agents in every backend, judged by the phantom's truth; rank correlation of backends.

    Writes OUT, and a heat map and a table beside it.
    """
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_runs
    from racines_envs.studies import transfer as work

    settings = read_settings(params, profile)
    chosen = given(view=view, starts=starts, seeds=integers(seeds), device=device)
    config = fill(work.TransferConfig, section(settings, "transfer") | chosen, "transfer")
    runs = find_runs(listed(agents))
    content = work.transfer(runs, listed(backends), config, phantom_config(settings))
    table = work.transfer_markdown(content)
    work.draw_transfer(content, out.with_suffix(".png"))
    publish(content, table, out, as_json)
