"""The commands `racines expert …`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from racines_data.cli import options as opt
from racines_data.terminal import console, say, say_json
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from racines_data.store.frames import FrameStore
    from racines_leaderboard.expert.sample import System

KitFolder = Annotated[Path, typer.Argument(help="Folder of the kit.")]
Key = Annotated[
    Path | None, typer.Option(help="The key, where it was moved.  [default: KIT/key.json]")
]


def sample(
    out: opt.Out,
    generator: Annotated[
        list[str] | None,
        typer.Option(
            help="A registered generator, module:Class, FILE.onnx or FILE.parquet; NAME=FOLDER "
            "names its run. Repeatable."
        ),
    ] = None,
    truth: Annotated[bool, typer.Option("--truth", help="Show true frames as well.")] = False,
    data: opt.Data = opt.DATA,
    images: Annotated[int, typer.Option(min=1, help="Different images.")] = 400,
    repeats: Annotated[int, typer.Option(min=0, help="Images that are shown twice.")] = 40,
    seed: opt.DrawSeed = 0,
    split: opt.Split = "test",
    grader: opt.Grader = None,
    no_grader: opt.NoGrader = False,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Draw images of stratified poses into a blinded kit, a folder that must not exist.

    The key holds the opinion of a grader: that of models/runs/grader, if it is there.
    """
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_leaderboard.expert.sample import Study, System, make_kit
    from racines_leaderboard.records.experts import TRUE_FRAMES
    from racines_models.judges.grader.model import Grader

    store = open_store(data)
    grader = None if no_grader else grader or (opt.GRADER if opt.GRADER.is_dir() else None)
    judge = None if grader is None else Grader.load(grader, device)
    systems = [_system(spec, store, split, device) for spec in generator or []]
    systems += [System(TRUE_FRAMES, None)] if truth else []
    study = Study(images, repeats, seed, split)
    with image_counter("drawing", images, hidden=False) as advance:
        kit = make_kit(out, store, systems, study, judge, advance)
    if as_json:
        told = {"out": str(out), "images": images, "repeats": repeats, "digest": kit.digest}
        return say_json(told)
    say(f"{out}: {images} images and {repeats} repeats, kit {kit.digest[:12]}.")
    say(f"Give raters {out}/kit.json and {out}/images; keep {out}/key.json from them.")


def rate(
    kit: KitFolder,
    by: Annotated[
        Literal["simulated", "oracle", "grader"],
        typer.Option(help="Who answers: a rater of known error, the phantom's oracle, the grader."),
    ] = "oracle",
    error_view: Annotated[float, typer.Option(help="Simulated: share of wrong views.")] = 0.1,
    grade_sd: Annotated[
        float, typer.Option(help="Simulated: standard deviation of the grades' errors.")
    ] = 1.0,
    seed: opt.DrawSeed = 0,
    rater: Annotated[
        str | None, typer.Option(help="Simulated: name.  [default: simulated-SEED]")
    ] = None,
    out: opt.OwnOut = None,
    key: Key = None,
    as_json: opt.AsJson = False,
) -> None:
    """Let a program answer a kit, into KIT-ratings or --out: a worked example, no expert's."""
    from racines_leaderboard.expert import raters
    from racines_leaderboard.expert.kit import Kit

    opened = Kit.open(kit)
    folder, truth = out or kit.parent / f"{kit.name}-ratings", opened.read_key(key)
    if by == "simulated":
        known = raters.Simulated(error_view, grade_sd, seed)
        session = raters.simulate(opened, truth, known, folder, rater)
    else:
        session = (raters.grader if by == "grader" else raters.oracle)(opened, truth, folder)
    done = session.progress()
    if as_json:
        told = {"ratings": str(session.path), "done": done.done, "total": done.total}
        return say_json(told | {"rater": session.rater, "kind": session.kind})
    say(f"{session.path}: {done.done} of {done.total} images, rater {session.rater}.")
    say(f"{session.kind}: not an expert's ratings ({session.about}).")


def score(
    kit: KitFolder,
    ratings: Annotated[list[Path], typer.Argument(help="Files of the ratings, one a rater.")],
    key: Key = None,
    partial: Annotated[bool, typer.Option("--partial", help="Take unfinished ratings.")] = False,
    resamples: Annotated[int, typer.Option(min=2, help="Of the bootstrap.")] = 1000,
    out: opt.OwnOut = None,
    board: Annotated[str | None, typer.Option(help="Put experts' agreement on this board.")] = None,
    results: opt.Results = opt.RESULTS,
    as_json: opt.AsJson = False,
) -> None:
    """Compare ratings with the key, and raters with each other.

    With --out, report.json and report.png are written.
    """
    from racines_data.files import write_json
    from racines_leaderboard.expert import score as scoring
    from racines_leaderboard.expert.kit import Kit
    from racines_leaderboard.expert.ratings import read_all
    from racines_leaderboard.records.experts import publish
    from racines_leaderboard.records.schema import check

    opened = Kit.open(kit)
    opened.check_images()
    everyone = read_all(ratings, opened, partial)
    report = scoring.score(opened, opened.read_key(key), everyone, resamples)
    check(report, "expert-scores", "report")
    written = []
    if out is not None:
        written = [out / "report.json", out / "report.png"]
        write_json(written[0], report)
        scoring.write_picture(written[1], report)
    if board is not None:
        written += publish(report, results, board)
    if as_json:
        say_json(report)
        return
    scoring.show(report, console())
    for path in written:
        say(str(path))


def _system(spec: str, store: "FrameStore", split: str, device: str) -> "System":
    from racines_leaderboard.expert.sample import System
    from racines_models.registry import open_generator, weights_of

    name, _, folder = spec.partition("=")
    run = Path(folder) if folder else None
    source: Any = open_generator(name, run, device, store=store, split=split)
    return System(source.name, source, weights_of(name, run) or None)
