"""The command `racines eval agent`. Heavy imports stand inside."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_data.errors import RacinesError
from racines_data.terminal import say, say_json
from racines_envs.cli.settings import (
    Agent,
    Env,
    Goal,
    Name,
    Tier,
    on_patients,
    on_tier,
    open_env,
    phantom_config,
)
from racines_envs.task.names import HEART_TIER, tier_of
from racines_models.cli.device import OneDevice


def evaluate_agent(
    agent: Agent,
    view: opt.View = None,
    tier: Tier = None,
    env: Env = None,
    goal: Goal = None,
    split: opt.OneSplit = None,
    patients: Annotated[int | None, typer.Option(min=1, help="Patients of the split.")] = None,
    starts: opt.Starts = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    data: opt.OtherData = None,
    reward: opt.Reward = None,
    grader: opt.Grader = None,
    device: OneDevice = None,
    seed: opt.StartSeed = None,
    name: Name = None,
    run: opt.Trained = None,
    out: opt.OwnOutFile = None,
    picture: Annotated[
        Path | None, typer.Option(help="Picture of trajectories; beside the scores, .png.")
    ] = None,
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    engine: opt.Engine = "local",
    address: opt.Address = None,
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Score an agent from fixed starts; options override the settings.

    All trainings of the run are scored, and published ones (envs/weights/<board>/<run>/seed-<n>)
    of the same settings where the run has none of that seed; of --run FOLDER, those in it.
    The policy is that of envs/runs/<run>, the scores go to envs/runs/scores/<run>.json. Where an
    option asks for another view, backend or start set than the settings do, the name says so:
    <run>-pl.json; so in --out, if that is a folder. Another result that is there stays, unless
    --force is given.
    With --tier patients or beating it acts on patients of --split, --starts times on each.
    With --env replay:FOLDER it acts in the recorded frames of a dataset, from starts of --split,
    the test split by default; --set then also takes the settings of the replay.
    """
    from racines_models.cli.device import spread

    if goal and not env:
        raise RacinesError("--goal needs --env replay:FOLDER")
    if env:
        if tier or patients or backend or generator or data:
            raise RacinesError(
                "--env replay has frames of its own: leave --tier, --patients, --backend, "
                "--generator and --data out"
            )
        chosen = given(
            split=split, goal=goal, starts=starts, reward=reward, grader=grader, seed=seed,
            device=device,
        )  # fmt: skip
        where = {"name": name, "run": run, "out": out, "force": force, "as_json": as_json}
        where |= {"opened": spread(engine, address, device)}
        given_ = chosen | overrides(settings)
        return _on_recordings(agent, env, view, given_, params, profile, picture, **where)
    task = on_tier(view, tier)
    if task is None and tier is None:
        task = _trained_for(agent, params, profile, name, run)
    if task is not None and tier_of(task) != HEART_TIER:
        chosen = given(
            view=task, split=split, patients=patients, starts=starts, reward=reward, seed=seed,
            device=device,
        )  # fmt: skip
        where = {"name": name, "run": run, "out": out, "force": force, "as_json": as_json}
        where |= {"opened": spread(engine, address, device)}
        return _on_patients(agent, chosen | overrides(settings), params, profile, **where)
    if split or patients:
        raise RacinesError("--split and --patients need --tier patients or beating")
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_trained, result_name
    from racines_envs.evaluation.run import (
        EvaluationConfig,
        evaluate,
        write_evaluation,
    )
    from racines_envs.evaluation.trainings import published_run
    from racines_envs.robots.arm import FREE
    from racines_models.cli.output import show_metrics
    from racines_models.provenance import check_name

    values = read_settings(params, profile)
    entry = find_trained(values, agent, name, run)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, backend=backend, generator=generator, reward=reward,
        data=data, grader=grader, device=device, seed=seed,
    ) | overrides(settings)  # fmt: skip
    stated = section(values, "evaluation")
    config = fill(EvaluationConfig, stated | chosen, "evaluation")
    usual = fill(EvaluationConfig, stated | given(view=entry.view), "evaluation")
    own = name or (out and not out.is_dir())
    label = entry.name if own else result_name(entry.name, config, usual)
    out = _result_file(out, entry.scores.with_name(f"{label}.json"))
    check_name(out, "agent", label, force)
    phantom, board = phantom_config(values), values.get("board")
    published = None if run else published_run(board, entry.name)
    own_board = board if config.robot == FREE else None  # boards are of free probes
    with spread(engine, address, config.device) as pool:
        result = evaluate(
            entry.agent, run or entry.trained, config, phantom, run=label, board=own_board,
            published=published, engine=pool,
        )  # fmt: skip
    write_evaluation(result, out, picture or out.with_suffix(".png"), force)
    if as_json:
        say_json(result.scores, indent=2)
    else:
        task = result.scores["task"]
        title = f"{result.scores['agent']} on {task['view']} ({task['observation']})"
        show_metrics(title, result.scores["metrics"])
        if several := result.scores.get("trainings"):
            say("trainings: " + ", ".join(map(_told, several)))
        say(f"written: {out}")


def _trained_for(
    agent: str, params: Path | None, profile: str | None, name: str | None, run: Path | None
) -> str | None:
    """Return the task on patients that a run was trained for; None for others."""
    from racines_envs.evaluation.agent_specs import find_trained

    return on_patients(find_trained(read_settings(params, profile), agent, name, run).view)


def _on_recordings(
    agent: str, env: str, view: str | None, chosen: dict[str, Any], params: Path | None,
    profile: str | None, picture: Path | None, *, name: str | None, run: Path | None,
    out: Path | None, force: bool, as_json: bool, opened: Any,
) -> None:  # fmt: skip
    """Score an agent in recorded frames alone; settings are those of `evaluation` and `replay`."""
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_trained, plain_name
    from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
    from racines_envs.robots.arm import FREE
    from racines_models.cli.output import show_metrics
    from racines_models.provenance import check_name

    values = read_settings(params, profile)
    entry = find_trained(values, agent, name, run)
    chosen = {"split": "test"} | section(values, "replay").of("split") | chosen
    where_to = view or (None if "goal" in chosen else entry.view)
    world, rest, label = open_env(env, values, where_to, chosen, chosen.get("device"))
    entry = entry if name else replace(entry, name=f"{entry.name}-{label}")
    # What the settings say of a phantom, its view and its grader is not of these frames.
    stated = section(values, "evaluation").of("starts", "seeds", "resamples", "latency", "pictured")
    own = {"view": world.aim.view, "backend": "replay"}
    config = fill(EvaluationConfig, stated | rest | own, "evaluation")
    carried = f"-{config.robot}" if config.robot != FREE else ""
    label = entry.name if name else plain_name(f"{entry.name}-{world.settings.split}{carried}")
    out = _result_file(out, entry.scores.with_name(f"{label}.json"))
    check_name(out, "agent", label, force)
    with opened as pool:
        result = evaluate(entry.agent, run or entry.trained, config, world, run=label, engine=pool)
    write_evaluation(result, out, picture or out.with_suffix(".png"), force)
    if as_json:
        say_json(result.scores, indent=2)
    else:
        task, count = result.scores["task"], len(world.start_frames)
        title = f"{label}: {task['view']} from {count} frames of {world.settings.split}"
        show_metrics(title, result.scores["metrics"])
        say(f"written: {out}")


def _on_patients(
    agent: str, chosen: dict[str, Any], params: Path | None, profile: str | None, *,
    name: str | None, run: Path | None, out: Path | None, force: bool, as_json: bool, opened: Any,
) -> None:  # fmt: skip
    """Score an agent on patients, whose settings are the section `evaluation_patients`."""
    from racines_data.config import fill, section
    from racines_envs.evaluation.agent_specs import find_trained, plain_name
    from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients, row_name
    from racines_envs.evaluation.run import write_evaluation
    from racines_envs.robots.arm import FREE
    from racines_models.cli.output import show_metrics
    from racines_models.provenance import check_name

    values = read_settings(params, profile)
    entry, stated = find_trained(values, agent, name, run), section(values, "evaluation_patients")
    config = fill(PatientsConfig, stated | chosen, "evaluation_patients")
    board, tier = values.get("board"), tier_of(config.view)
    label = plain_name(f"{entry.name}-{config.view}-{config.split}")
    apart = [Path(config.phantom).name] if config.phantom else []
    apart += [plain_name(config.robot)] if config.robot != FREE else []
    if apart:  # a world of one's own, or an arm: no row of a board
        board, label = None, "-".join([label, *apart])
    elif tier in values.get("patient_boards", ()):
        board = tier
        # From the board's own starts it is a row; others are told by all that makes them.
        usual = fill(PatientsConfig, stated | {"view": config.view}, "evaluation_patients")
        if all(getattr(config, key) == getattr(usual, key) for key in SAME):
            label = row_name(entry.name, config.view)
    label = name or label
    out = _result_file(out, entry.scores.with_name(f"{label}.json"))
    check_name(out, "agent", label, force)
    folder = run or entry.trained
    with opened as pool:
        made = {"run": label, "board": board, "engine": pool}
        result = evaluate_patients(entry.agent, folder, config, **made)
    write_evaluation(result, out, None, force)
    if as_json:
        say_json(result.scores, indent=2)
    else:
        title = f"{label}: {config.patients} patients, {config.starts} starts each"
        show_metrics(title, result.scores["metrics"])
        say(f"written: {out}")


SAME = ("split", "patients", "starts", "seed", "reward")
"""Settings that decide a score on patients."""


def _result_file(out: Path | None, usual: Path) -> Path:
    """Return the file to write, before any work: in a folder under the usual name."""
    if out is None:
        return usual
    if out.is_dir():
        return out / usual.name
    opt.check_ending(out, ".json")
    return out


def _told(training: dict[str, Any]) -> str:
    return f"seed {training['seed']}" + (" (published)" if training["published"] else "")
