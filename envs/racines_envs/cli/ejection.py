"""The command `racines study ejection`. Heavy imports stand inside: --help is instant."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_envs.cli.settings import Agent
from racines_envs.cli.study import SCORES
from racines_models.cli.device import OneDevice
from racines_models.published.places import WEIGHTS, published

JUDGES = (
    Path("models/runs/segmentation"),
    WEIGHTS / "phantom-patients/segmentation",
)
"""Where the segmentation judge is looked for: trained here, or published."""


def ejection(
    agent: Agent,
    split: opt.OneSplit = None,
    patients: Annotated[int | None, typer.Option(min=1, help="Patients of the split.")] = None,
    starts: opt.Starts = None,
    segmentation: Annotated[
        Path | None, typer.Option(help="Folder of the segmentation judge.")
    ] = None,
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
    """Measure the ejection fraction at the four-chamber view that an agent finds in beating hearts.

    The probe is held for a beat where the agent ended, whether it was there or not; the
    segmentation judge outlines, the method of disks gives volumes. Beside it the same with true
    outlines, and at the pose of the planner, who is told the truth: so the error falls into view,
    segmentation and geometry. The report goes to envs/runs/scores/<run>-ejection.json, a picture
    beside it.
    """
    from racines_data.config import fill, section
    from racines_data.files import write_atomic, write_json
    from racines_data.progress import progress_bar
    from racines_data.tables import console_table
    from racines_envs.evaluation.agent_specs import find_trained
    from racines_envs.studies.ejection import EjectionConfig, draw_ejection, study_ejection
    from racines_models.cli.output import tell
    from racines_models.judges.segmentation.model import SegmentationJudge

    values = read_settings(params, profile)
    entry = find_trained(values, agent, run=run)
    chosen: dict[str, Any] = given(
        split=split, patients=patients, starts=starts, seed=seed, device=device
    ) | overrides(settings)
    config = fill(EjectionConfig, section(values, "ejection") | chosen, "ejection")
    out = out or SCORES / f"{entry.name}-ejection.json"
    opt.check_ending(out, ".json")
    parts = out.with_suffix(".parts.json")
    trained = (each for each in map(published, JUDGES) if (each / "config.json").is_file())
    judge = SegmentationJudge.load(segmentation or next(trained, JUDGES[0]), config.device)
    with progress_bar(not as_json, "patients") as bar:
        task = bar.add_task(entry.name, total=config.patients)
        report, measured, truth = study_ejection(
            entry.agent, run or entry.trained, config, judge, entry.name,
            lambda count: bar.advance(task, count), parts, force,
        )  # fmt: skip
    write_json(out, report)
    picture = out.with_suffix(".png")
    write_atomic(picture, draw_ejection(report, measured, truth))
    parts.unlink(missing_ok=True)
    head = ("pose, outlines", "figure", "bias", "limits of agreement", "correlation", "n")
    rows = [row for title, told in report["agreement"].items() for row in _rows(title, told)]
    errors = ", ".join(
        f"{name} {value:.1f}" for name, value in report["errors"].items() if value is not None
    )
    found = f"{100 * report['found_and_declared']:.0f} % found and declared"
    shown = f"{found}; mean absolute error of the ejection fraction: {errors}"
    if axis := report["foreshortening"]["agent"].get("bias"):
        shown += f"; long axis in the agent's plane: {100 + axis['value']:.0f} % of the true one"
    table = console_table(head, rows, f"{entry.name} on {config.view}", right=2)
    tell(report, as_json, table, shown, f"written: {out}, {picture}")


def _rows(title: str, told: dict[str, Any]) -> list[tuple[str, ...]]:
    rows = []
    for name, each in told.items():
        n = f"{each['patients']}" + (f", {each['not_seen']} not seen" if each["not_seen"] else "")
        n += f", {each['impossible']} impossible" if each["impossible"] else ""
        if "bias" not in each:
            rows.append((title, name.replace("_", " "), "-", "-", "-", n))
            continue
        value = {key: each[key]["value"] for key in
                 ("bias", "lower_limit", "upper_limit", "correlation")}  # fmt: skip
        limits = f"{value['lower_limit']:+.0f} to {value['upper_limit']:+.0f}"
        bias = f"{value['bias']:+.1f} {each['bias']['unit']}"
        rows.append((title, name.replace("_", " "), bias, limits, f"{value['correlation']:.2f}", n))
    return rows
