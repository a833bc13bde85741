"""Commands: train grader, eval generator, realism. Heavy imports stand inside."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from racines_models.realism import RealFrames, RealismConfig
    from racines_models.scoring import Scores

Data = Annotated[Path, typer.Option(help="Folder of the dataset.")]
Params = Annotated[Path | None, typer.Option(help="Params file. Default: ./params.yaml.")]
Profile = Annotated[
    str | None, typer.Option(help="Packaged settings: smoke, default, paper or abdomen.")
]
Device = Annotated[str, typer.Option(help="cpu, cuda or auto.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print figures as JSON on stdout.")]
DATA = Path("data/racines")
GRADER = Path("models/runs/grader")


def register(train: typer.Typer, evaluate: typer.Typer) -> None:
    """Add `grader` to `racines train`, `generator` and `realism` to `racines eval`."""
    train.command("grader")(train_grader)
    evaluate.command("generator")(eval_generator)
    evaluate.command("realism")(realism)


def register_realism(app: typer.Typer) -> None:
    """Add `realism` to an app."""
    app.command("realism")(realism)


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
    from racines_data.store import open_store
    from racines_models import grader_training
    from racines_models.cli_output import show_metrics
    from racines_models.grader import GraderConfig
    from racines_models.protocol import Run

    values = _values(params, profile)
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
    name: Annotated[str, typer.Argument(help="A registered generator, or module:Class.")],
    data: Data = DATA,
    run: Annotated[
        Path | None, typer.Option(help="Folder of the trained run.  [default: models/runs/NAME]")
    ] = None,
    grader: Annotated[Path, typer.Option(help="Folder of the grader's run.")] = GRADER,
    no_grader: Annotated[
        bool, typer.Option("--no-grader", help="Leave out what needs a grader.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder of the scores.")] = Path("models/runs/scores"),
    split: Annotated[str | None, typer.Option(help="Split; default: scores.split.")] = None,
    samples: Annotated[int | None, typer.Option(min=2, help="Default: scores.samples.")] = None,
    params: Params = None,
    profile: Profile = None,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Score a trained generator on held-out poses; write NAME.json and a picture NAME.png."""
    from racines_data.config import fill, section
    from racines_data.store import open_store
    from racines_models.cli_output import progress_bar, show_metrics
    from racines_models.grader import Grader
    from racines_models.provenance import weights_sha256
    from racines_models.registry import generator_class, load_generator
    from racines_models.scoring import ScoresConfig, score

    values = _values(params, profile)
    settings = section(values, "scores")
    settings |= {k: v for k, v in (("split", split), ("samples", samples)) if v is not None}
    config = fill(ScoresConfig, settings, "scores")
    store, device, title = open_store(data), _device(device), generator_class(name).name
    folder = run or Path("models/runs") / title
    if not no_grader and not grader.is_dir():
        raise RacinesError(f"{grader}: no grader; run: racines train grader, or give --no-grader")
    judge = None if no_grader else Grader.load(grader, device)
    total = min(config.samples, len(store.split_indices(config.split)))
    total *= 1 + 2 * len(config.seeds)
    with progress_bar(f"scoring {title}", total, hidden=as_json) as advance:
        scores = score(
            load_generator(name, folder, device),
            store,
            config,
            title,
            grader=judge,
            cache=out / "reference",
            device=device,
            progress=advance,
        )
    content: dict[str, Any] = {**scores.content, "weights": weights_sha256(folder) or None}
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


def realism(
    real: Annotated[
        Path | None, typer.Option(help="Parquet of real frames. Default: realism.real.")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=2, help="Default: realism.frames.")] = None,
    data: Data = DATA,
    out: Annotated[Path, typer.Option(help="Writes OUT.json and OUT.png.")] = Path(
        "models/runs/realism"
    ),
    optional: Annotated[
        bool, typer.Option("--optional", help="Without real frames, say so and exit 0.")
    ] = False,
    params: Params = None,
    profile: Profile = None,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Hold the phantom's A4C frames beside real ones: figures, and one picture."""
    from racines_data.config import fill, section
    from racines_models.cli_output import show_realism
    from racines_models.realism import RealismConfig, read_real

    settings = section(_values(params, profile), "realism")
    if frames is not None:
        settings["frames"] = frames
    config = fill(RealismConfig, settings, "realism")
    path = real or (Path(config.real) if config.real else None)
    if path is None or (optional and not path.is_file()):
        _without_real(path, out, optional)
        return
    content = _realism(read_real(path), data, config, out, _device(device), hidden=as_json)
    if as_json:
        typer.echo(json.dumps(content))
        return
    show_realism(content)
    typer.echo(f"{out}.json, {out}.png (above real, below phantom)")


def _without_real(path: Path | None, out: Path, optional: bool) -> None:
    from racines_data.files import write_json

    told = f"{path}: no such file" if path else "no real frames named"
    told = f"{told}; give --real PATH.parquet (docs/scores.md): THE PHANTOM IS NOT COMPARED"
    if not optional:
        raise RacinesError(told)
    typer.echo(f"racines: {told}", err=True)
    write_json(out.with_suffix(".json"), {"schema": "racines.realism/1", "compared": False})


def _realism(
    real: "RealFrames", data: Path, config: "RealismConfig", out: Path, device: str, hidden: bool
) -> dict[str, Any]:
    import torch

    from racines_data.files import write_json
    from racines_data.store import open_store
    from racines_models.cli_output import progress_bar
    from racines_models.inception import InceptionFeatures
    from racines_models.pictures import COLUMNS, write_strip
    from racines_models.realism import compare_with_real

    total = min(len(real.images), 2 * config.frames) + config.frames
    with progress_bar("realism", total, hidden) as advance:
        extractor = InceptionFeatures(device)
        result = compare_with_real(real, open_store(data), config, extractor, advance)
    rows = []
    for images in (result.real, result.phantom):
        count = min(COLUMNS, len(result.phantom))
        rows.append(images[(2 * torch.arange(count) + 1) * len(images) // (2 * count)])
    write_strip(out.with_suffix(".png"), rows)
    write_json(out.with_suffix(".json"), result.content)
    return result.content


def _values(params: Path | None, profile: str | None) -> dict[str, Any]:
    from racines_data.config import read_params

    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    return read_params(params, profile)


def _device(device: str) -> str:
    import torch

    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    return device


def _named(views: dict[str, Any]) -> dict[str, Any]:
    return {f"view_accuracy, {name}": metric for name, metric in views.items()}
