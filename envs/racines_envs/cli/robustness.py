"""The command `racines eval robustness`. Heavy imports stand inside: --help is instant."""

from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_envs.cli.settings import Agent, Tier, on_tier
from racines_envs.cli.study import SCORES
from racines_models.cli.device import OneDevice


def evaluate_robustness(
    agent: Agent,
    view: opt.View = None,
    tier: Tier = "patients",
    split: opt.OneSplit = None,
    patients: Annotated[int | None, typer.Option(min=1, help="Patients of the split.")] = None,
    starts: opt.Starts = None,
    run: opt.Trained = None,
    out: opt.OwnOutFile = None,
    device: OneDevice = None,
    seed: opt.StartSeed = None,
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Let an agent act on patients with something wrong: haze, ribs, a slipping probe and more.

    From the same starts on the same patients: with nothing wrong, under each disturbance at three
    strengths, and under all of them. Told is the share found and declared, and its change, paired
    by patient. The report goes to envs/runs/scores/<run>-robustness.json, a picture beside it; a
    command that was killed goes on. --force starts anew where another study's report is. Some of
    the disturbances alone: --set "disturbances=[haze, slip]".
    """
    from racines_data.config import fill, section
    from racines_data.files import write_atomic
    from racines_data.progress import progress_bar
    from racines_data.tables import console_table
    from racines_envs.evaluation.agent_specs import find_trained
    from racines_envs.studies.robustness.figures import draw_robustness
    from racines_envs.studies.robustness.run import (
        RobustnessConfig,
        conditions,
        evaluate_robustness,
    )
    from racines_models.cli.output import tell

    values = read_settings(params, profile)
    entry = find_trained(values, agent, run=run)
    chosen: dict[str, Any] = given(
        view=on_tier(view or "A4C", tier), split=split, patients=patients, starts=starts,
        seed=seed, device=device,
    ) | overrides(settings)  # fmt: skip
    config = fill(RobustnessConfig, section(values, "robustness") | chosen, "robustness")
    out = out or SCORES / f"{entry.name}-robustness.json"
    opt.check_ending(out, ".json")
    with progress_bar(not as_json, "conditions") as bar:
        task = bar.add_task(entry.name, total=len(conditions(config)))
        folder = run or entry.trained
        found = evaluate_robustness(
            entry.agent, folder, config, out, entry.name, lambda _: bar.advance(task), force
        )
    write_atomic(out.with_suffix(".png"), draw_robustness(found))
    rows = [_row(title, told) for title, told in found["conditions"].items()]
    head = ("condition", "found and declared", "95 % interval", "change", "95 % interval")
    table = console_table(head, rows, f"{entry.name} on {config.view}")
    tell(found, as_json, table, f"written: {out}, {out.with_suffix('.png')}")


def _row(title: str, told: dict[str, Any]) -> tuple[str, ...]:
    share, change = told["metrics"]["success_declared"], told.get("change")
    return (title, *_percent(share), *(_percent(change, "+") if change else ("-", "-")))


def _percent(figure: dict[str, Any], sign: str = "") -> tuple[str, str]:
    value, low, high = (figure[key] for key in ("value", "low", "high"))
    between = "-" if low is None else f"{100 * low:{sign}.0f} to {100 * high:{sign}.0f}"
    return f"{100 * value:{sign}.0f} %", between
