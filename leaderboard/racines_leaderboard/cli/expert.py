"""The commands `racines expert …`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_models.cli.scores import Device

if TYPE_CHECKING:
    from racines_data.store.frames import FrameStore
    from racines_leaderboard.expert.sample import System
    from racines_leaderboard.expert.session import Session

expert = typer.Typer(
    help="A blinded study: experts say which view an image shows, and how good it is.",
    no_args_is_help=True,
)
GRADER = Path("models/runs/grader")
KitFolder = Annotated[Path, typer.Argument(help="Folder of the kit.")]
Key = Annotated[
    Path | None, typer.Option(help="The key, where it was moved.  [default: KIT/key.json]")
]
Into = Annotated[
    Path | None, typer.Option(help="Folder of the ratings.  [default: KIT-ratings, beside KIT]")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the report as JSON.")]


@expert.command()
def sample(
    out: Annotated[Path, typer.Option(help="Folder of the kit; must not exist.")],
    generator: Annotated[
        list[str] | None,
        typer.Option(
            help="A registered generator, module:Class, FILE.onnx or FILE.parquet; NAME=FOLDER "
            "names its run. Repeatable."
        ),
    ] = None,
    truth: Annotated[bool, typer.Option("--truth", help="Show true frames as well.")] = False,
    data: Annotated[Path, typer.Option(help="Folder of the dataset.")] = Path("data/racines"),
    images: Annotated[int, typer.Option(min=1, help="Different images.")] = 400,
    repeats: Annotated[int, typer.Option(min=0, help="Images that are shown twice.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of the sample; no rater's business.")] = 0,
    split: Annotated[str, typer.Option(help="Split of the poses.")] = "test",
    grader: Annotated[
        Path | None,
        typer.Option(help=f"Grader whose opinion the key holds.  [default: {GRADER}, if there]"),
    ] = None,
    no_grader: Annotated[bool, typer.Option("--no-grader", help="Leave it out.")] = False,
    device: Device = "auto",
) -> None:
    """Draw images of stratified poses into a blinded kit."""
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_leaderboard.expert.sample import Study, System, make_kit
    from racines_leaderboard.records.names import TRUE_FRAMES
    from racines_models.judges.grader.model import Grader

    store = open_store(data)
    grader = None if no_grader else grader or (GRADER if GRADER.is_dir() else None)
    judge = None if grader is None else Grader.load(grader, device)
    systems = [_system(spec, store, split, device) for spec in generator or []]
    systems += [System(TRUE_FRAMES, None)] if truth else []
    study = Study(images, repeats, seed, split)
    with image_counter("drawing", images, hidden=False) as advance:
        kit = make_kit(out, store, systems, study, judge, advance)
    typer.echo(f"{out}: {images} images and {repeats} repeats, kit {kit.digest[:12]}.")
    typer.echo(f"Give raters {out}/kit.json and {out}/images; keep {out}/key.json from them.")


@expert.command()
def simulate(
    kit: KitFolder,
    error_view: Annotated[float, typer.Option(help="Share of wrong views.")] = 0.1,
    grade_sd: Annotated[float, typer.Option(help="Standard deviation of grades' errors.")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the errors.")] = 0,
    rater: Annotated[str | None, typer.Option(help="Name.  [default: simulated-SEED]")] = None,
    out: Into = None,
    key: Key = None,
) -> None:
    """Let a simulated rater of known error answer a kit."""
    from racines_leaderboard.expert import raters
    from racines_leaderboard.expert.kit import Kit

    opened = Kit.open(kit)
    known = raters.Simulated(error_view, grade_sd, seed)
    _told(raters.simulate(opened, opened.read_key(key), known, _folder(kit, out), rater))


@expert.command()
def oracle(
    kit: KitFolder,
    grader: Annotated[bool, typer.Option("--grader", help="Let the grader answer.")] = False,
    out: Into = None,
    key: Key = None,
) -> None:
    """Let the phantom's oracle, or the grader, answer a kit: a worked example, no expert's."""
    from racines_leaderboard.expert import raters
    from racines_leaderboard.expert.kit import Kit

    opened = Kit.open(kit)
    answer = raters.grader if grader else raters.oracle
    _told(answer(opened, opened.read_key(key), _folder(kit, out)))


@expert.command()
def score(
    kit: KitFolder,
    ratings: Annotated[list[Path], typer.Argument(help="Files of the ratings, one a rater.")],
    key: Key = None,
    partial: Annotated[bool, typer.Option("--partial", help="Take unfinished ratings.")] = False,
    resamples: Annotated[int, typer.Option(min=2, help="Of the bootstrap.")] = 1000,
    out: Annotated[Path | None, typer.Option(help="Folder of report.json, report.png.")] = None,
    board: Annotated[str | None, typer.Option(help="Put experts' agreement on this board.")] = None,
    results: Annotated[Path, typer.Option(help="Folder of the boards.")] = Path(
        "leaderboard/results"
    ),
    as_json: AsJson = False,
) -> None:
    """Compare ratings with the key, and raters with each other."""
    from rich.console import Console

    from racines_leaderboard.expert import score as scoring
    from racines_leaderboard.expert.kit import Kit
    from racines_leaderboard.expert.ratings import read_all
    from racines_leaderboard.expert.tables import show
    from racines_leaderboard.records.experts import publish
    from racines_leaderboard.records.schema import check

    opened = Kit.open(kit)
    opened.check_images()
    everyone = read_all(ratings, opened, partial)
    report = scoring.score(opened, opened.read_key(key), everyone, resamples)
    check(report, "expert-scores", "report")
    written = _write(out, report) if out is not None else []
    if board is not None:
        written += publish(report, results, board)
    if as_json:
        typer.echo(json.dumps(report, ensure_ascii=False))
        return
    show(report, Console())
    for path in written:
        typer.echo(str(path))


def _write(out: Path, report: dict[str, Any]) -> list[Path]:
    from racines_data.files import write_json
    from racines_leaderboard.expert.picture import write_picture

    write_json(out / "report.json", report)
    write_picture(out / "report.png", report)
    return [out / "report.json", out / "report.png"]


def _system(spec: str, store: "FrameStore", split: str, device: str) -> "System":
    from racines_leaderboard.expert.sample import System
    from racines_models.registry import open_generator, weights_of

    name, _, folder = spec.partition("=")
    run = Path(folder) if folder else None
    source: Any = open_generator(name, run, device, store=store, split=split)
    return System(source.name, source, weights_of(name, run) or None)


def _folder(kit: Path, out: Path | None) -> Path:
    return out or kit.parent / f"{kit.name}-ratings"


def _told(session: "Session") -> None:
    done = session.progress()
    typer.echo(f"{session.path}: {done.done} of {done.total} images, rater {session.rater}.")
    typer.echo(f"{session.kind}: not an expert's ratings ({session.about}).")
