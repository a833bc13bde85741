"""The command `racines study coverage`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given
from racines_models.cli.device import Device


def coverage(
    generator: Annotated[
        str, typer.Argument(help="A trained generator, best of several trainings.")
    ] = "vae-gan",
    against: Annotated[str, typer.Option(help="Another, for differences.")] = "cgan",
    data: opt.Data = opt.DATA,
    runs: opt.Runs = Path("models/weights"),
    scores: Annotated[
        Path, typer.Option(help="Folder of the scores of mean-image and noise-ceiling.")
    ] = Path("models/runs/scores"),
    pose: opt.Pose = Path("models/weights/pose"),
    out: opt.Report = Path("models/runs/coverage"),
    table: Annotated[
        Path | None, typer.Option(help="Also write the table that intervals are printed with.")
    ] = None,
    units: Annotated[
        list[int] | None,
        typer.Option(min=3, help="Trajectories of a study; repeat.  [default: 6, 12, 30, 140]"),
    ] = None,
    studies: Annotated[int | None, typer.Option(min=2, help="Of each size.")] = None,
    set_studies: Annotated[int | None, typer.Option(min=2, help="The same, for FID, KID.")] = None,
    frames: Annotated[int | None, typer.Option(min=4, help="Frames of the population.")] = None,
    embedded: Annotated[int | None, typer.Option(min=4, help="Those with features.")] = None,
    seed: opt.DrawSeed = 0,
    cache: Annotated[Path, typer.Option(help="Folder that keeps figures and studies.")] = Path(
        "models/runs/scores/reference"
    ),
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Count how often intervals hold the value that they are of, in studies drawn by simulation.

    Studies are trajectories of the dataset, drawn with replacement, with the figures of two trained
    generators. A killed run goes on: the studies it has are kept.
    """
    import time

    from racines_data.files import write_atomic, write_json
    from racines_data.progress import progress_bar
    from racines_data.store.frames import open_store
    from racines_data.tables import console_table
    from racines_models.cli.output import tell
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.provenance import dataset_card
    from racines_models.registry import generator_class, open_runs, weights_of
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.coverage import run as study
    from racines_models.studies.coverage.population import images_drawn, measure
    from racines_models.studies.coverage.simulation import CoverageConfig, Simulation

    began = time.perf_counter()
    chosen: Any = given(
        studies=studies,
        set_studies=set_studies,
        frames=frames,
        embedded=embedded,
        units=tuple(units) if units else None,
    )
    config = CoverageConfig(**chosen, seed=seed)
    store, anchors = open_store(data), study.read_anchors(scores)
    folders = {name: runs / generator_class(name).name for name in (generator, against)}
    first, second = (open_runs(name, folder, device=device) for name, folder in folders.items())
    weights = {name: weights_of(name, folder) for name, folder in folders.items()}
    extractor = InceptionFeatures(device)
    regressor = PoseRegressor.load(pose or Path("models/weights/pose"), device)
    size = config.frames, config.embedded
    with progress_bar(not as_json) as bar:
        task = bar.add_task("images", total=images_drawn(store, size, len(first) + len(second)))
        population = measure(
            store, first, second, extractor, regressor, size, [weights], cache,
            lambda count: bar.advance(task, count),
        )  # fmt: skip
        population = population.project(config.dimensions, seed)
        simulation = Simulation(population, config, anchors)
        drawn = bar.add_task("studies", total=sum(cell[-1] for cell in study.cells(config)))
        kept = study.rows_file(cache, population, config, anchors)
        rows = study.simulate(simulation, kept, lambda count: bar.advance(drawn, count))
    content = study.report(simulation, rows, dataset_card(store), weights, began)
    write_atomic(out.with_suffix(".png"), study.draw_coverage(content))
    write_json(out.with_suffix(".json"), content)
    if table is not None:
        write_json(table, content["levels"])
    shown = [
        (
            row["kind"],
            f"{row['units']}",
            f"{row['trainings']}",
            f"{row['coverage']:.1%} ({row['low']:.1%} to {row['high']:.1%})",
            f"{row['n']}",
        )
        for row in content["rows"]
    ]
    head = ("interval of", "units", "trainings", "coverage (95 % interval)", "studies")
    tell(content, as_json, console_table(head, shown, "coverage"), f"{out}.json, {out}.png")
