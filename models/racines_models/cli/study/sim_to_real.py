"""The command `racines study sim-to-real`. Heavy imports stand inside, so that --help is quick."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from racines_data.cli import options as opt
from racines_models.cli.device import Device
from racines_models.published.places import WEIGHTS, published

if TYPE_CHECKING:
    from rich.table import Table
    from torch import Tensor

JUDGES = Path("models/runs")
"""Where judges lie that are not named."""
PUBLISHED = WEIGHTS / "phantom-patients"
"""Where the published judges of patients lie."""
SCOUTS = JUDGES / "scores/reference"
"""Where scouts are kept that generators on patients are shown."""


def sim_to_real(
    real: Annotated[
        Path, typer.Option(help="Parquet of real A4C frames, a folder of real echo, or a dataset.")
    ],
    generators: Annotated[
        list[str] | None,
        typer.Argument(help="Generators trained on patients, whose A4C frames are held beside."),
    ] = None,
    grader: opt.Grader = None,
    segmentation: Annotated[
        Path | None, typer.Option(help="Folder of the segmentation judge's run.")
    ] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Parquet of the masks drawn on the real frames.")
    ] = None,
    no_grader: opt.NoGrader = False,
    out: opt.Report = Path("models/runs/sim-to-real"),
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Ask judges that saw simulated patients alone about real frames; nothing is chosen by them.

    The share of real A4C frames called A4C, beside that of the same frames upside down, scrambled
    and mirrored, of other views, and of planes turned away; Dice and ejection fraction against
    cardiologists. Judges that are not named are those in models/runs. Of an imported dataset: what
    its frames are called, KID to simulated patients, and motion read from images; by the published
    judges of patients. Of generators that are named: KID of what they draw of patients whom they
    never saw, beside that of the simulator's own frames of the same planes.
    """
    # What is not there, or cannot be compared, is told before anything is measured.
    opened = _opened(generators or [], device)
    if (real / "manifest.json").is_file():
        return _imported(real, opened, grader, no_grader, out, device, as_json)
    import numpy as np

    from racines_data.files import write_atomic, write_json
    from racines_data.progress import image_counter
    from racines_models.cli.output import tell
    from racines_models.judges.grader.model import Grader
    from racines_models.judges.segmentation.model import SegmentationJudge
    from racines_models.studies.realism.patients import list_of
    from racines_models.studies.sim_to_real.drawn import check_enough
    from racines_models.studies.sim_to_real.figures import draw
    from racines_models.studies.sim_to_real.frames import read_real_echo
    from racines_models.studies.sim_to_real.report import images_asked, measure, present

    at = None if no_grader else grader or _there("grader")
    outlines = segmentation or _there("segmentation")
    judge = Grader.load(at, device) if at else None
    outliner = SegmentationJudge.load(outlines, device) if outlines else None
    echo = read_real_echo(real, masks)
    lists = np.array([list_of(each) for each in echo.frames.patient])
    sets = {name: echo.frames.images[lists == name] for name in present(lists)}
    if opened.trained:
        check_enough(*map(len, sets.values()))
    total = images_asked(echo, judge is not None, outliner is not None)
    with image_counter("real frames", total, as_json) as advance:
        measured = measure(echo, judge, outliner, advance)
    if opened.trained:
        measured.content["drawn"] = _drawn(opened, sets, device, as_json)
    endings = draw(echo, measured, outliner)
    for ending, png in endings.items():
        write_atomic(out.with_name(f"{out.name}{ending}.png"), png)
    write_json(out.with_suffix(".json"), measured.content)
    written = ", ".join(f"{out}{ending}.png" for ending in endings)
    tables = [*_tables(measured.content), *_likenesses(measured.content)]
    tell(measured.content, as_json, *tables, f"{out}.json, {written}")


def _imported(
    root: Path, opened: "_Opened", grader: Path | None, no_grader: bool, out: Path, device: str,
    as_json: bool,
) -> None:  # fmt: skip
    """Measure a dataset, and write what came out with a sheet of what frames are called."""
    from racines_data.files import write_atomic, write_json
    from racines_data.store.frames import open_store
    from racines_data.tables import console_table
    from racines_models.cli.output import tell
    from racines_models.judges.grader.model import Grader
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.sim_to_real.drawn import check_enough
    from racines_models.studies.sim_to_real.imported import measure_imported
    from racines_models.studies.sim_to_real.imported_sheet import sheet, told_rows

    store = open_store(root)
    if opened.trained:
        check_enough(len(store.images))
    judge = None if no_grader else Grader.load(grader or published(PUBLISHED / "grader"), device)
    regressor = PoseRegressor.load(published(PUBLISHED / "pose"), device)
    measured = measure_imported(store, judge, regressor, InceptionFeatures(device))
    if opened.trained:
        sets = {"imported": measured.images}
        measured.content["drawn"] = _drawn(opened, sets, device, as_json)
    write_atomic(out.with_suffix(".png"), sheet(measured))
    write_json(out.with_suffix(".json"), measured.content)
    table = console_table(("of the imported set", "figure"), told_rows(measured.content))
    tables = [table, *_likenesses(measured.content)]
    tell(measured.content, as_json, *tables, f"{out}.json, {out}.png")


class _Opened(NamedTuple):
    """Generators on patients, by name."""

    trained: dict[str, list[Any]]
    """The trainings of each."""
    weights: dict[str, dict[str, str] | None]
    """SHA-256 of their files; None where nothing is trained."""


def _opened(names: list[str], device: str) -> _Opened:
    """Open generators that are named."""
    opened = _Opened({}, {})
    if not names:
        return opened
    from racines_data.errors import RacinesError
    from racines_models.registry import (
        PATIENTS,
        generator_class,
        is_file,
        weights_folder,
        weights_of,
    )
    from racines_models.scores.on_patients import open_for_patients
    from racines_models.training.published import published_seeds

    for spec in names:
        if is_file(spec):
            raise RacinesError(
                f"{spec}: a file cannot adapt to the patients that are drawn here: name a generator"
            )
        folder, name = weights_folder(spec), generator_class(spec).name
        further = published_seeds(PATIENTS, folder)
        opened.trained[name] = open_for_patients(spec, folder, further, device)
        there = (folder / "config.json").is_file()
        opened.weights[name] = weights_of(spec, folder, further) if there else None
    return opened


def _drawn(
    opened: _Opened, real: "dict[str, Tensor]", device: str, as_json: bool
) -> dict[str, Any]:
    """Return KID of what generators on patients draw to sets of real frames."""
    from racines_data.progress import progress_bar
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.sim_to_real.drawn import DrawnConfig, likeness, wanted

    trained = opened.trained
    config, extractor = DrawnConfig(), InceptionFeatures(device)
    with progress_bar(not as_json, "patients") as bar:
        task = bar.add_task("scouts", total=config.patients)
        shown = wanted(config, SCOUTS, lambda n: bar.advance(task, n))
        total = len(shown.row) * sum(map(len, trained.values()))
        task = bar.add_task("images drawn", total=total)
        told = likeness(trained, shown, real, extractor, progress=lambda n: bar.advance(task, n))
    told |= {"config": asdict(config), "weights": opened.weights, "extractor": extractor.settings}
    return told


def _there(name: str) -> Path | None:
    """Return the folder of a judge of that name, if one was trained here."""
    folder = JUDGES / name
    return folder if (folder / "config.json").is_file() else None


def _tables(content: dict[str, Any]) -> "list[Table]":
    """Return the tables of what was measured: who calls what A4C, and outlines."""
    from racines_data.tables import console_table

    tables = []
    if rows := _calls(content):
        head = ("frames", "called A4C", "95 % interval", "p ≥ 0.9", "n", "patients")
        tables.append(console_table(head, rows, "called A4C"))
    if rows := _outlines(content):
        head = ("patients", "figure", "value", "95 % interval", "n")
        tables.append(console_table(head, rows, "outlines, against cardiologists", right=2))
    return tables


def _likenesses(content: dict[str, Any]) -> "list[Table]":
    """Return the table of KID of what generators draw, the simulator's own frames first."""
    from racines_data.tables import console_table

    rows = []
    for name, sets in content.get("drawn", {}).get("kid", {}).items():
        for real, told in sets.items():
            low, high = told["low"], told["high"]
            between = "-" if low is None else f"{low:.3f} to {high:.3f}"
            trainings = str(told["settings"]["trainings"])
            rows.append((name, real, f"{told['value']:.3f}", between, str(told["n"]), trainings))
    head = ("drawn by", "real frames", "KID", "95 % interval", "n", "trainings")
    return [console_table(head, rows, "A4C of patients never seen")] if rows else []


def _calls(content: dict[str, Any]) -> list[tuple[str, ...]]:
    rows = []
    for name, controls in content.get("acceptance", {}).items():
        for control, told in controls.items():
            figure = told["called_a4c"]
            units = str(figure["settings"]["units"])
            sure = f"{told['surely_a4c']['value']:.1%}"
            rows.append((f"{name}, {control}", *_rate(figure), sure, str(figure["n"]), units))
    if "other_views" in content:
        figure = content["other_views"]["others_called_a4c"]
        rows.append(("other views", *_rate(figure), "-", str(figure["n"]), "not told"))
    for name, told in content.get("rotation", {}).get("sectors", {}).items():
        if told["frames"]:
            where = f"turned {told['from']:.0f}°-{told['to']:.0f}° ({name})"
            shares = (f"{told['called_a4c']:.1%}", "-", f"{told['surely_a4c']:.1%}")
            rows.append((where, *shares, str(told["frames"]), "1"))
    return rows


def _outlines(content: dict[str, Any]) -> list[tuple[str, ...]]:
    rows = []
    for name, figures in content.get("overlap", {}).items():
        volumes = content["volumes"][name]
        figures = dict(figures)
        for volume, told in volumes.items():
            name_of, less = volume.replace("_", " "), volume != "ejection_fraction"
            shown = ("bias", "correlation") if less else tuple(told)
            figures |= {
                f"{name_of}, {key}": told[key] for key in shown if "value" in _of(told.get(key))
            }
        for key, figure in figures.items():
            unit = f" {figure['unit']}" if figure.get("unit") else ""
            low, high = figure["low"], figure["high"]
            interval = "-" if low is None else f"{low:.3g} to {high:.3g}"
            rows.append((name, key, f"{figure['value']:.3g}{unit}", interval, str(figure["n"])))
        told = volumes["ejection_fraction"]
        left_out = f"{told['not_seen']} and {told['impossible']}"
        rows.append((name, "ejection fraction, not seen, impossible", left_out, "-", ""))
    return rows


def _of(figure: Any) -> dict[str, Any]:
    return figure if isinstance(figure, dict) else {}


def _rate(figure: dict[str, Any]) -> tuple[str, str]:
    """Return a share and its interval, per cent."""
    if figure["value"] is None:
        return "-", "-"
    low, high = figure["low"], figure["high"]
    return f"{figure['value']:.1%}", "-" if low is None else f"{low:.1%} to {high:.1%}"
