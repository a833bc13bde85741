"""Commands: `racines train agent` and `racines eval agent`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_envs.cli.settings import given, phantom_config, read_settings

AgentOrRun = "Registered agent, module:Class, or a run of the section agents."
Name = Annotated[str | None, typer.Option(help="What to call the run; as the agent, or its entry.")]
Params = Annotated[Path | None, typer.Option(help="Settings; ./params.yaml if it is there.")]
Profile = Annotated[
    str | None,
    typer.Option(help="Packaged settings: smoke, default, reference, paper or abdomen."),
]


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add the agent commands to the shared verbs."""
    from racines_envs.cli import encoder as cli_encoder
    from racines_envs.cli import evaluate as cli_eval
    from racines_envs.cli import forces as cli_forces
    from racines_envs.cli import speed as cli_speed

    cli_encoder.register(train)
    train.command("agent")(train_agent)
    evaluate.command("agent")(evaluate_agent)
    cli_eval.register(evaluate)
    cli_forces.register(evaluate)
    cli_speed.register(evaluate)


def train_agent(
    agent: Annotated[str, typer.Argument(help=AgentOrRun)] = "ppo",
    view: Annotated[str | None, typer.Option(help="Target view.")] = None,
    observation: Annotated[str | None, typer.Option(help="image, params or multimodal.")] = None,
    reward: Annotated[str | None, typer.Option(help="paper, oracle or shaped.")] = None,
    backend: Annotated[str | None, typer.Option(help="phantom or generator.")] = None,
    generator: Annotated[str | None, typer.Option(help="Generator: name or run folder.")] = None,
    grader: Annotated[str | None, typer.Option(help="Grader: run folder.")] = None,
    encoder: Annotated[
        str | None, typer.Option(help="What looks at images: a folder, or pose.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Dataset folder, for what learns from it.")
    ] = None,
    frames: Annotated[int | None, typer.Option(help="Environment steps.")] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the training.")] = None,
    name: Name = None,
    run_dir: Annotated[Path | None, typer.Option(help="Where to write; envs/runs/<run>.")] = None,
    resume: Annotated[
        bool | None,
        typer.Option("--resume/--fresh", help="Continue a run, or start anew; else as it fits."),
    ] = None,
    params: Params = None,
    profile: Profile = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the metrics as JSON.")] = False,
) -> None:
    """Train an agent; options override the settings."""
    from racines_data.config import fill
    from racines_envs.agents import agent_class
    from racines_envs.evaluation.entries import find_entry

    settings = read_settings(params, profile)
    entry = find_entry(settings, agent, name)
    chosen = given(
        view=view, observation=observation, reward=reward, backend=backend, generator=generator,
        grader=grader, encoder=encoder, frames=frames, device=device,
    )  # fmt: skip
    cls = agent_class(entry.agent)
    config: Any = fill(cls.Config, entry.settings | chosen, entry.where)
    folder = run_dir or entry.folder
    cls.train(
        config,
        folder,
        seed=settings.get("seed", 0) if seed is None else seed,
        phantom=phantom_config(settings),
        data=data,
        resume=resume,
        progress=not as_json,
    )
    metrics = (folder / "metrics.json").read_text()
    typer.echo(metrics if as_json else f"settings, metrics and policy, if any, are in {folder}")


def evaluate_agent(
    agent: Annotated[str, typer.Argument(help=AgentOrRun)],
    view: Annotated[str | None, typer.Option(help="Target view.")] = None,
    starts: Annotated[int | None, typer.Option(help="Episodes from each start set.")] = None,
    backend: Annotated[str | None, typer.Option(help="phantom, generator or replay.")] = None,
    generator: Annotated[str | None, typer.Option(help="Generator: name or run folder.")] = None,
    data: Annotated[str | None, typer.Option(help="Dataset folder, to replay.")] = None,
    reward: Annotated[str | None, typer.Option(help="paper, oracle or shaped.")] = None,
    grader: Annotated[str | None, typer.Option(help="Grader: run folder.")] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.")] = None,
    seed: Annotated[int | None, typer.Option(help="Names one start set, not three.")] = None,
    latency: Annotated[
        int | None, typer.Option(help="Decisions to time one at a time; 0 for none.")
    ] = None,
    name: Name = None,
    run_dir: Annotated[Path | None, typer.Option(help="The policy; envs/runs/<run>.")] = None,
    scores: Annotated[
        Path | None, typer.Option(help="Scores file; envs/runs/scores/<run>.json.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Picture of trajectories; beside the scores, .png.")
    ] = None,
    params: Params = None,
    profile: Profile = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the scores as JSON.")] = False,
) -> None:
    """Score an agent from fixed starts; options override the settings."""
    import json

    from racines_data.config import fill, section
    from racines_envs.evaluation.entries import find_entry
    from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation

    settings = read_settings(params, profile)
    entry = find_entry(settings, agent, name)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, backend=backend, generator=generator, reward=reward,
        data=data, grader=grader, device=device, seed=seed, latency=latency,
    )  # fmt: skip
    config = fill(EvaluationConfig, section(settings, "evaluation") | chosen, "evaluation")
    result = evaluate(
        entry.agent,
        run_dir or entry.folder,
        config,
        phantom_config(settings),
        run=entry.name,
        board=settings.get("board"),
    )
    out = scores or entry.scores
    write_evaluation(result, out, picture or out.with_suffix(".png"))
    if as_json:
        typer.echo(json.dumps(result.scores, indent=2))
    else:
        _show(result.scores, out)


def _show(scores: dict[str, Any], path: Path) -> None:
    """Print the figures as a table."""
    from rich.console import Console

    from racines_data.tables import console_table

    task = scores["task"]
    rows = []
    for name, figure in scores["metrics"].items():
        value, low, high = (_number(figure[key]) for key in ("value", "low", "high"))
        rows.append((name, value, f"{low} – {high}", str(figure["n"])))
    title = f"{scores['agent']} on {task['view']} ({task['observation']})"
    Console().print(console_table(("figure", "value", "95 %", "n"), rows, title))
    typer.echo(f"written: {path}")


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
