"""Commands: train grader, eval generator. Heavy imports stand inside."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from racines_models.scores.scoring import Scores

Data = Annotated[Path, typer.Option(help="Folder of the dataset.")]
Params = Annotated[Path | None, typer.Option(help="Params file. Default: ./params.yaml.")]
Profile = Annotated[
    str | None,
    typer.Option(help="Packaged settings: smoke, default, reference, paper or abdomen."),
]


def present(device: str | None) -> str | None:
    """Return what `--device` stands for; refused before anything else is looked at."""
    from racines_models.devices import resolve_device

    return None if device is None else resolve_device(device)


DEVICES = typer.Option(help="auto, cpu, cuda or cuda:N.", callback=present)
Device = Annotated[str, DEVICES]
AsJson = Annotated[bool, typer.Option("--json", help="Print figures as JSON on stdout.")]
DATA = Path("data/racines")
GRADER = Path("models/runs/grader")
POSE = Path("models/runs/pose")


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add `grader` to `racines train`, `generator` to `racines eval`."""
    train.command("grader")(train_grader)
    evaluate.command("generator")(eval_generator)


def train_grader(
    data: Data = DATA,
    out: Annotated[Path, typer.Option(help="Folder of the run.")] = GRADER,
    params: Params = None,
    profile: Profile = None,
    seed: Annotated[int | None, typer.Option(help="Seed; default: the params file's.")] = None,
    device: Device = "auto",
    resume: Annotated[
        bool | None,
        typer.Option(
            "--resume/--fresh",
            help="Continue a killed run, or start anew. Without either: continue if one is there.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train the grader: views first, then grades; report on the test trajectories."""
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_metrics
    from racines_models.judges.grader import training as grader_training
    from racines_models.judges.grader.model import GraderConfig
    from racines_models.protocol import Run

    values = read_values(params, profile)
    config = fill(GraderConfig, section(values, "grader"), "grader")
    chosen = values.get("seed", 0) if seed is None else seed
    run = Run(out, chosen, device, resume, progress=not as_json)
    metrics = grader_training.train_grader(open_store(data), config, run)
    if as_json:
        typer.echo(json.dumps({"out": str(out)} | metrics))
        return
    show_metrics(f"grader, {metrics['split']} split", metrics["metrics"] | _named(metrics["views"]))
    typer.echo(f"{out}: {metrics['training']['images_per_second']} images/s in training")


def eval_generator(
    name: Annotated[
        str, typer.Argument(help="A registered generator, module:Class, FILE.onnx or FILE.parquet.")
    ],
    data: Data = DATA,
    run: Annotated[
        Path | None, typer.Option(help="Folder of the trained run.  [default: models/runs/NAME]")
    ] = None,
    grader: Annotated[Path, typer.Option(help="Folder of the grader's run.")] = GRADER,
    no_grader: Annotated[
        bool, typer.Option("--no-grader", help="Leave out what needs a grader.")
    ] = False,
    pose: Annotated[
        Path | None,
        typer.Option(help=f"Folder of the pose regressor's run.  [default: {POSE}, if there]"),
    ] = None,
    no_pose: Annotated[
        bool, typer.Option("--no-pose", help="Leave out what needs a pose regressor.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder of the scores.")] = Path("models/runs/scores"),
    split: Annotated[str | None, typer.Option(help="Split; default: scores.split.")] = None,
    samples: Annotated[int | None, typer.Option(min=2, help="Default: scores.samples.")] = None,
    params: Params = None,
    profile: Profile = None,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Score a generator on held-out poses; write NAME.json and a picture NAME.png."""
    from racines_data.config import fill, section
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_metrics
    from racines_models.judges.grader.model import Grader
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.registry import open_runs, weights_of
    from racines_models.scores.scoring import ScoresConfig, score, take_turns

    values = read_values(params, profile)
    settings = section(values, "scores")
    settings |= {k: v for k, v in (("split", split), ("samples", samples)) if v is not None}
    config = fill(ScoresConfig, settings, "scores")
    store = open_store(data)
    if not no_grader and not grader.is_dir():
        raise RacinesError(f"{grader}: no grader; run: racines train grader, or give --no-grader")
    judge = None if no_grader else Grader.load(grader, device)
    runs: Any = open_runs(name, run, device=device, store=store, split=config.split)
    title: str = runs[0].name
    pose = None if no_pose else pose or (POSE if POSE.is_dir() else None)
    regressor = None if pose is None else PoseRegressor.load(pose, device)
    total = min(config.samples, len(store.split_indices(config.split)))
    total *= 1 + 2 * len(take_turns(runs, config.seeds))
    with image_counter(f"scoring {title}", total, hidden=as_json) as advance:
        scores = score(
            runs,
            store,
            config,
            title,
            grader=judge,
            pose=regressor,
            cache=out / "reference",
            device=device,
            progress=advance,
        )
    content: dict[str, Any] = {**scores.content, "weights": weights_of(name, run) or None}
    content["dataset"]["board"] = values.get("board")
    _write_scores(out, title, content, scores, len(store.labels) - 1)
    if as_json:
        typer.echo(json.dumps(content))
    else:
        show_metrics(f"{title}, {config.split} split", content["metrics"])
        typer.echo(f"{out / title}.json, {out / title}.png")


def _write_scores(
    out: Path, name: str, content: dict[str, Any], scores: "Scores", random: int
) -> None:
    from racines_data.files import write_json
    from racines_models.pictures import pick_columns, write_strip

    frames = scores.sample.frames
    columns = pick_columns(frames.views, frames.grades, random)
    write_strip(out / f"{name}.png", [frames.images[columns], scores.images[columns]])
    write_json(out / f"{name}.json", content)


def read_values(params: Path | None, profile: str | None) -> dict[str, Any]:
    """Return the settings of a command: the file's or profile's, else ./params.yaml's."""
    from racines_data.config import read_params

    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    return read_params(params, profile)


def _named(views: dict[str, Any]) -> dict[str, Any]:
    return {f"view_accuracy, {name}": metric for name, metric in views.items()}
