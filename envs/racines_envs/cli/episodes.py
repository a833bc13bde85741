"""The commands `racines drive`, `replay`, `explain` and `export …`. Heavy imports stand inside."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import check_ending, given, overrides, read_settings
from racines_data.errors import RacinesError
from racines_data.terminal import say, say_json
from racines_envs.cli.settings import Agent, on_patients, on_tier, phantom_config
from racines_envs.task.names import HEART_TIER, tier_of
from racines_models.cli.device import OneDevice


def drive(
    view: opt.View = "SC",
    anatomy: Annotated[str | None, typer.Option(help="Whose view; the heart's.")] = None,
    backend: opt.Backend = "phantom",
    generator: opt.Generator = None,
    data: opt.OtherData = None,
    reward: opt.Reward = "oracle",
    grader: opt.Grader = None,
    seed: opt.DrawSeed = 0,
    png: Annotated[
        Path | None, typer.Option(help="Renew this file with the picture after every key.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write each episode there, as JSONL and GIF.")
    ] = None,
    keys: Annotated[
        str | None, typer.Option(help="Press these keys and stop; needs no terminal.")
    ] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Drive the probe from the keyboard; the keys stand under the picture."""
    from racines_envs.driving.keyboard import Drive, Terminal, run
    from racines_envs.worlds.making import make_core

    terminal = Terminal() if keys is None else None  # refused before anything is made
    settings = given(
        view=view, backend=backend, generator=generator, data=data, reward=reward,
        grader=grader, anatomy=anatomy,
    )  # fmt: skip
    core = make_core(**settings, observation="image")
    session = Drive(core, seed, png, record)
    if terminal is None:
        run(session, keys or "")
    else:
        with terminal:
            run(session, terminal.keys(), terminal.show)
    if as_json:
        info = {name: value[0].item() for name, value in core.info().items()}
        say_json(info, indent=2)
    else:
        for line in session.words()[:-3]:
            say(line)


def replay(
    recording: Annotated[Path, typer.Argument(help="An episode's JSONL file.")],
    as_json: opt.AsJson = False,
) -> None:
    """Run a recorded episode again; exit 1 if its poses do not repeat."""
    from racines_envs.recordings.episodes import rerun

    done = rerun(recording)
    text = f"{recording}: {done.steps} steps repeat within {done.position_error:.1e} m and "
    text += f"{done.rotation_error:.1e} rad"
    if as_json:
        say_json(asdict(done), indent=2)
    else:
        say(text)


def explain(
    agent: Agent,
    view: opt.View = None,
    starts: opt.Starts = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    data: opt.OtherData = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    device: OneDevice = None,
    seed: opt.StartSeed = None,
    run: opt.Trained = None,
    out: opt.OwnOut = None,
    pictures: Annotated[int, typer.Option(help="Episodes that are drawn.")] = 4,
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Show what in the images moved an agent, with scores; options override the settings.

    A grader is explained beside it. The result goes to envs/runs/explain/<run>, or --out.
    """
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import RUNS, find_trained
    from racines_envs.explain.run import ExplainConfig, write_explanation
    from racines_envs.explain.run import explain as explain_agent
    from racines_models.cli.output import show_metrics

    values = read_settings(params, profile)
    entry = find_trained(values, agent, run=run)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, backend=backend, data=data, generator=generator, reward=reward,
        grader=grader, device=device, seed=seed,
    ) | overrides(settings)  # fmt: skip
    config = fill(ExplainConfig, section(values, "explain") | chosen, "explain")
    result = explain_agent(entry.agent, run or entry.trained, config, phantom_config(values))
    folder = out or RUNS / "explain" / entry.name
    write_explanation(result, folder, pictures)
    if as_json:
        say_json(result.scores, indent=2)
    else:
        name, images = result.scores["agent"], result.scores["images"]
        for what, metrics in result.scores["metrics"].items():
            show_metrics(f"{name}, {what}: {images} images", metrics)
        say(f"written: {folder}")


def export_agent(
    run: Annotated[Path, typer.Argument(help="Folder that a training left, envs/runs/NAME.")],
    out: opt.OutFile,
    as_json: opt.AsJson = False,
) -> None:
    """Write a trained policy as one ONNX file, its frozen encoder inside."""
    from racines_envs.agents.onnx.policy import export_run

    check_ending(out, ".onnx")
    made = export_run(run, out)
    line = f"{out}: {made['bytes']:,} bytes, opset {made['opset']}, sees {made['observation']}"
    if as_json:
        say_json(made)
    else:
        say(line)


def export_envhub(
    tasks: Annotated[list[str], typer.Argument(help="Views or tasks, e.g. SC PL-beating.")],
    out: opt.Out,
    format: Annotated[
        str, typer.Option(help="What policies see and do: lerobot-rgb or lerobot-task.")
    ] = "lerobot-rgb",
    settings: opt.Set = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write a folder that LeRobot loads tasks from (EnvHub), to evaluate policies in them.

    --set robot=ur5e lets an arm carry the probe, as in exports of sweeps that were drawn for one.
    """
    from racines_data.config import fill
    from racines_envs.apis.lerobot.envhub import HubConfig, write_envhub

    config = fill(HubConfig, overrides(settings), "envhub")
    made = write_envhub(out, tasks, format, config.robot)
    if as_json:
        say_json(made)
    else:
        say(f"{out}: {', '.join(made['tasks'])} as {format}; the README.md has the commands")


def export_trace(
    agent: Annotated[str, typer.Argument(help="Registered agent, module:Class or FILE.onnx.")],
    out: opt.OutFile,
    view: opt.View = None,
    tier: opt.Tier = None,
    split: opt.OneSplit = None,
    patients: opt.Patients = None,
    starts: opt.Starts = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    seed: opt.StartSeed = None,
    run: opt.Trained = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write the actions that an agent takes from the fixed starts, for others to take again.

    With --tier patients or beating the starts are those on patients of --split.
    """
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_trained
    from racines_envs.evaluation.patients import PatientsConfig, record_on_patients
    from racines_envs.evaluation.run import EvaluationConfig, record_trace

    check_ending(out, ".json")
    settings = read_settings(params, profile)
    entry = find_trained(settings, agent, run=run)
    task = on_tier(view, tier)
    if task is None and tier is None:
        task = on_patients(entry.view)
    chosen = given(view=task, starts=starts, reward=reward, seed=seed)
    folder = run or entry.trained
    if task is not None and tier_of(task) != HEART_TIER:
        if grader:
            raise RacinesError("--grader judges the one heart: leave it out")
        stated = section(settings, "evaluation_patients")
        chosen |= given(split=split, patients=patients)
        asked = fill(PatientsConfig, stated | chosen, "evaluation_patients")
        made = record_on_patients(entry.agent, folder, asked, out)
    else:
        if split or patients:
            raise RacinesError("--split and --patients need --tier patients or beating")
        chosen = given(view=entry.view) | chosen | given(grader=grader)
        config = fill(EvaluationConfig, section(settings, "evaluation") | chosen, "evaluation")
        made = record_trace(entry.agent, folder, config, out, phantom_config(settings))
    line = f"{out}: {made['episodes']:,} episodes, {made['steps']:,} steps"
    if as_json:
        say_json(made)
    else:
        say(line)
