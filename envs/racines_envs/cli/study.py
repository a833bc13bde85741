"""The commands `racines study …` on agents. Heavy imports stand inside: --help is instant."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_data.terminal import say, say_json, say_page
from racines_envs.cli.settings import phantom_config
from racines_models.cli.device import OneDevice

SCORES = Path("envs/runs/scores")
_AGENTS = "Names or run folders, comma-separated or given again; LABEL=RUN names one."
Seeds = Annotated[str | None, typer.Option(help="Start sets, comma-separated: 0,1,2.")]


def curves(
    runs: Annotated[
        list[str], typer.Argument(help="Run folders; LABEL=RUN joins seeds under one label.")
    ],
    paper: Annotated[
        bool, typer.Option("--paper/--no-paper", help="Draw the paper's levels.")
    ] = True,
    out: opt.OutFile = SCORES / "curves.png",
    as_json: opt.AsJson = False,
) -> None:
    """Draw success, steps and return of validations against environment steps."""
    from racines_envs.studies.curves import draw_curves, read_curves

    content = read_curves(_listed(runs))
    draw_curves(content, out, paper)
    if as_json:
        say_json(content)
    else:
        say(f"written: {out}")


def forces(
    data: opt.Data = opt.DATA,
    split: opt.Split = "test",
    out: opt.OutFile = SCORES / "forces.json",
    as_json: opt.AsJson = False,
) -> None:
    """Fit forces on the train split and tell their errors on trajectories not seen."""
    from racines_data.errors import RacinesError
    from racines_data.files import write_json
    from racines_data.store.frames import open_store
    from racines_envs.worlds.forces import force_report, forces_markdown

    if split == "train":
        raise RacinesError("--split train: the forces are fitted on it; choose validation or test")
    report = force_report(open_store(data), split=split)
    write_json(out, report)
    if as_json:
        say_json(report, indent=2)
        return
    say_page(forces_markdown(report))
    say(f"held out: {report['frames'][split]} frames of split {split}; written: {out}")


def reward_audit(
    agents: Annotated[list[str], typer.Argument(help=_AGENTS)],
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
        view=view, starts=starts, seeds=_integers(seeds), grader=grader, device=device,
        rewards=tuple(_listed([rewards])) if rewards else None,
    )  # fmt: skip
    config = fill(work.RewardReportConfig, section(settings, "rewards") | chosen, "rewards")
    runs = find_runs(_listed(agents))
    content, episodes = work.reward_report(runs, config, phantom_config(settings))
    work.draw_returns(episodes, content["view"], out.with_suffix(".png"))
    _publish(content, work.reward_markdown(content), out, as_json)


def transfer(
    agents: Annotated[list[str], typer.Option(help=_AGENTS)],
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
    chosen = given(view=view, starts=starts, seeds=_integers(seeds), device=device)
    config = fill(work.TransferConfig, section(settings, "transfer") | chosen, "transfer")
    runs = find_runs(_listed(agents))
    content = work.transfer(runs, _listed(backends), config, phantom_config(settings))
    work.draw_transfer(content, out.with_suffix(".png"))
    _publish(content, work.transfer_markdown(content), out, as_json)


def speed(
    view: opt.View = None,
    observation: opt.Observation = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    num_envs: Annotated[
        str | None, typer.Option(help="Batch sizes, comma-separated; 1,64.")
    ] = None,
    settings: opt.Set = None,
    threads: Annotated[int | None, typer.Option(help="CPU threads; PyTorch's default.")] = None,
    device: OneDevice = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Time an environment: steps a second, and where the time of a step goes."""
    import torch

    from racines_data.config import fill
    from racines_envs.studies.step_profile import SpeedConfig, step_speed
    from racines_envs.task.names import HEART_TIER, tier_of

    values = read_settings(params, profile)
    chosen = given(
        view=view, observation=observation, reward=reward, grader=grader, backend=backend,
        generator=generator, num_envs=_integers(num_envs), device=device,
    ) | overrides(settings)  # fmt: skip
    if grader is not None and reward is None:
        chosen["reward"] = "paper"
    if threads is not None:
        if threads < 1:
            raise typer.BadParameter(f"{threads} threads: give 1 or more")
        torch.set_num_threads(threads)
    config = fill(SpeedConfig, chosen, "speed")
    phantom = phantom_config(values) if tier_of(config.view) == HEART_TIER else None
    content = step_speed(config, phantom)
    if as_json:
        say_json(content, indent=2)
    else:
        say_page(_speed_table(content))


def _speed_table(content: dict[str, Any]) -> str:
    """Return the figures as a Markdown table, and what the longest operations are."""
    from racines_data.tables import markdown_table
    from racines_envs.studies.step_profile import PHASES

    rows = [
        (run["num_envs"], f"{run['steps_per_second']:,.0f}")
        + tuple(f"{run['shares'][phase]:.0%}" for phase in PHASES)
        for run in content["runs"]
    ]
    lines = [markdown_table(("environments", "steps/s", *PHASES), rows, right=0)]
    for run in content["runs"]:
        named = ", ".join(f"{each['name']} {each['share']:.0%}" for each in run["operations"])
        lines.append(f"\nOperations at {run['num_envs']}: {named}")
    machine = content["machine"]
    lines.append(
        f"\n{content['view']}, {content['observation']}, reward {content['reward']}; "
        f"{machine['device']}, {machine['threads']} of {machine['cores']} cores, "
        f"torch {machine['torch']}"
    )
    return "\n".join(lines)


def _listed(values: list[str]) -> list[str]:
    """Return the words of lists that are separated by commas."""
    return [word for value in values for word in value.split(",") if word]


def _integers(text: str | None) -> tuple[int, ...] | None:
    """Return the integers of a list; what is none is bad usage."""
    try:
        return None if text is None else tuple(int(word) for word in _listed([text]))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r}: give integers, comma-separated") from error


def _publish(content: dict[str, Any], table: str, out: Path, as_json: bool) -> None:
    """Write a study and its table, and print it as JSON or as that table."""
    from racines_data.files import write_atomic, write_json

    write_atomic(out.with_suffix(".md"), table)
    write_json(out, content)
    if as_json:
        say_json(content, indent=2)
    else:
        say_page(table)
        say(f"written: {out}, {out.with_suffix('.png').name}, {out.with_suffix('.md').name}")
