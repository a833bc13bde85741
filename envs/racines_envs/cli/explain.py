"""The command `racines explain`."""

from pathlib import Path
from typing import Annotated, Any

import typer


def register(app: typer.Typer) -> None:
    """Add the command to the root."""
    app.command("explain")(explain)


def explain(
    agent: Annotated[str, typer.Argument(help="Registered agent, or module:Class.")],
    view: Annotated[str | None, typer.Option(help="Target view.")] = None,
    starts: Annotated[int | None, typer.Option(help="Episodes, from the fixed starts.")] = None,
    every: Annotated[int | None, typer.Option(help="Explain every n-th step's image.")] = None,
    frames: Annotated[int | None, typer.Option(help="Most images an episode; 0: all.")] = None,
    steps: Annotated[int | None, typer.Option(help="Points of the integral.")] = None,
    random_maps: Annotated[int | None, typer.Option(help="Random maps of each kind.")] = None,
    backend: Annotated[str | None, typer.Option(help="phantom, generator or replay.")] = None,
    generator: Annotated[str | None, typer.Option(help="Generator: name or run folder.")] = None,
    data: Annotated[str | None, typer.Option(help="Dataset folder, to replay.")] = None,
    reward: Annotated[str | None, typer.Option(help="paper, oracle or shaped.")] = None,
    grader: Annotated[
        str | None, typer.Option(help="Grader to explain beside it: run folder.")
    ] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.")] = None,
    seed: Annotated[int | None, typer.Option(help="Names the start set.")] = None,
    run_dir: Annotated[Path | None, typer.Option(help="The policy; envs/runs/<run>.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; envs/runs/explain/<run>.")
    ] = None,
    pictures: Annotated[int, typer.Option(help="Episodes that are drawn.")] = 4,
    params: Annotated[
        Path | None, typer.Option(help="Settings; ./params.yaml if it is there.")
    ] = None,
    profile: Annotated[str | None, typer.Option(help="Packaged settings.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the scores as JSON.")] = False,
) -> None:
    """Show what in the images moved an agent, with scores; options override the settings."""
    import json

    from racines_data.config import fill, section
    from racines_envs.cli.settings import given, phantom_config, read_settings
    from racines_envs.evaluation.agent_specs import RUNS
    from racines_envs.evaluation.entries import find_entry
    from racines_envs.explain.run import ExplainConfig, write_explanation
    from racines_envs.explain.run import explain as explain_agent

    settings = read_settings(params, profile)
    entry = find_entry(settings, agent)
    chosen = given(view=entry.view) | given(
        view=view, starts=starts, every=every, frames=frames, steps=steps, backend=backend,
        data=data,
        random_maps=random_maps, generator=generator, reward=reward, grader=grader,
        device=device, seed=seed,
    )  # fmt: skip
    config = fill(ExplainConfig, section(settings, "explain") | chosen, "explain")
    place = run_dir or entry.folder
    result = explain_agent(entry.agent, place, config, phantom_config(settings))
    folder = out or RUNS / "explain" / entry.name
    write_explanation(result, folder, pictures)
    if as_json:
        typer.echo(json.dumps(result.scores, indent=2))
    else:
        _show(result.scores)
        typer.echo(f"written: {folder}")


def _show(scores: dict[str, Any]) -> None:
    """Print the figures as a table."""
    from rich.console import Console

    from racines_data.tables import console_table

    rows = []
    for what, metrics in scores["metrics"].items():
        for name, figure in metrics.items():
            value, low, high = (
                "–" if figure[key] is None else f"{figure[key]:.3g}"
                for key in ("value", "low", "high")
            )
            rows.append((what, name, value, f"{low} – {high}"))
    title = f"{scores['agent']}: {scores['images']} images"
    Console().print(console_table(("of", "figure", "value", "95 %"), rows, title, right=2))
