"""The command `racines study downstream`. Heavy imports stand inside: --help is instant."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings

FOLDER = Path("envs/runs/downstream")
AT_ONCE = 2.0
"""Seconds that a study waits for another in its folder."""
Points = Annotated[
    list[str] | None,
    typer.Argument(
        help="Who draws: truth, truth:blur=4, a generator, NAME:RUN FOLDER, LABEL=any of these.  "
        "[default: the settings']"
    ),
]


def downstream(
    points: Points = None,
    workers: opt.Workers = None,
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    out: opt.Out = FOLDER,
    as_json: opt.AsJson = False,
) -> None:
    """Teach servos in generators' images of train patients, and hold them beside the metrics.

    Each point draws the same frames of the same train patients; a small servo learns from them and
    is judged on patients that nobody has seen. Beside stand the board's metrics of the point's
    images, and how well their ranks agree with those of the servos. Writes downstream.json, .md
    and .png into OUT, and a file a point, so that a study that was killed goes on; points that are
    added later are measured alone.
    """
    from dataclasses import asdict

    from racines_data.config import fill, section
    from racines_data.files import locked, write_atomic, write_json
    from racines_data.progress import progress_bar
    from racines_data.tables import console_table
    from racines_envs.studies.downstream import figures
    from racines_envs.studies.downstream.config import DownstreamConfig
    from racines_envs.studies.downstream.correlation import OUTCOMES, add_scores, correlations
    from racines_envs.studies.downstream.run import measure_points, steps_of
    from racines_models.cli.device import spread
    from racines_models.cli.output import tell
    from racines_models.provenance import code_version, environment

    values = read_settings(params, profile)
    chosen: dict[str, Any] = given(points=tuple(points) if points else None) | overrides(settings)
    config = fill(DownstreamConfig, section(values, "downstream") | chosen, "downstream")
    # Two studies in one folder would measure the same points, each half.
    with (
        locked(out, AT_ONCE),
        spread("local", None, workers=workers) as pool,
        progress_bar(not as_json, "points") as bar,
    ):
        task = bar.add_task("patients and points", total=steps_of(config))
        rows = measure_points(config, out, pool, lambda _: bar.advance(task))
    add_scores(rows, config.anchors)
    document = {
        "schema": "racines.downstream/1", "settings": asdict(config), "points": rows,
        "correlations": correlations(rows), "note": figures.NOTE,
        "code": code_version(), "environment": environment("cpu"),
    }  # fmt: skip
    write_json(out / "downstream.json", document)
    write_atomic(out / "downstream.png", figures.draw_downstream(document))
    write_atomic(out / "downstream.md", figures.page(document))
    few = figures.NARROW
    tables = [console_table(figures.heads(few), figures.point_rows(document, few), "points")]
    heads = ("metric", *figures.groups_of(document))
    tables += [
        console_table(heads, figures.correlation_rows(document, outcome), f"ρ with {outcome}")
        for outcome in OUTCOMES
        if document["correlations"]
    ]
    tell(document, as_json, *tables, f"written: {out}/downstream.json, .md, .png")
