"""What `racines eval generator --tier patients` does."""

from pathlib import Path
from typing import Any

from racines_data.config import fill, section


def evaluate_on_patients(
    name: str, chosen: dict[str, Any], values: dict[str, Any], *, run: Path | None, out: Path,
    device: str, engine: str, address: str | None, force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Score a generator on patients; write NAME.json, .parquet and .png, and tell the figures.

    Args:
        name: of a registered generator, `module:Class`, or a file of predictions.
        chosen: settings that the command line gives.
        values: all settings.
        run: folder of the run; None: that of the name, trained here or published.
        out: folder to write.
        device: where features are computed and images drawn.
        engine: who runs the tasks.
        address: of a Ray cluster.
        force: whether another result is replaced.
        as_json: whether figures are printed as JSON.
    """
    from racines_data.progress import progress_bar
    from racines_data.store.asked import AskedStore, asked_digest
    from racines_models.cli.device import spread
    from racines_models.cli.output import metrics_table, tell
    from racines_models.exchange.predictions.file import check_made_for, metadata_of
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.judges.segmentation.model import SegmentationJudge
    from racines_models.registry import (
        PATIENTS,
        generator_class,
        is_predictions,
        weights_folder,
        weights_of,
    )
    from racines_models.scores.adapted_sheet import write_adapted
    from racines_models.scores.features import InceptionFeatures
    from racines_models.scores.on_patients import (
        Judges,
        PatientScoresConfig,
        check_named,
        open_for_patients,
        score_on_patients,
    )
    from racines_models.statistics import write_scores
    from racines_models.training.published import published_seeds

    check_named(name)
    config = fill(PatientScoresConfig, section(values, "patient_scores") | chosen, "patient_scores")
    tier_board = PATIENTS if PATIENTS in values.get("patient_boards", ()) else None
    drawn_elsewhere = is_predictions(name)
    folder = run if drawn_elsewhere else weights_folder(name, run)
    further = published_seeds(tier_board, folder) if folder is not None and run is None else []
    generators: list[Any] = []
    # Before anybody is scanned: what is not there, or of others, is told at once.
    if drawn_elsewhere:
        recipe = asked_digest(config.split, config.patients, config.seed)
        check_made_for(Path(name), recipe, metadata_of(Path(name)))
    else:
        own = section(values, "patient_generators").get(generator_class(name).name)
        generators = open_for_patients(name, folder, further, device, own)
    pose = PoseRegressor.load(config.pose, device)
    outlines = SegmentationJudge.load(config.segmentation, device)
    judges = Judges(pose, outlines, InceptionFeatures(device))
    out = out / PATIENTS if out == Path("models/runs/scores") else out
    with spread(engine, address, device) as pool, progress_bar(not as_json, "patients") as bar:
        task = bar.add_task("scouts", total=config.patients)
        cache = Path("models/runs/scores/reference")
        asked = AskedStore(
            config.split, config.patients, config.seed, cache, lambda n: bar.advance(task, n), pool
        )
        if drawn_elsewhere:
            generators = open_for_patients(name, folder, asked=asked)
        title = generators[0].name if drawn_elsewhere else generator_class(name).name
        total = 2 * len(asked)
        drawn = bar.add_task(f"scoring {title}, images", total=total)
        scores = score_on_patients(
            generators, asked, config, title, judges, device, lambda n: bar.advance(drawn, n), pool
        )
    there = folder is None or (folder / "config.json").is_file()
    weights = weights_of(name, folder, further) if there else None
    content: dict[str, Any] = {**scores.content, "weights": weights or None}
    content["dataset"]["board"] = tier_board
    written = out / f"{title}.json"
    content = write_scores(written, content, scores.evidence, force)
    write_adapted(out / f"{title}.png", asked, {"drawn": scores.images})
    tables = [metrics_table(f"{title}, {config.split} patients", content["metrics"])]
    tables += [
        metrics_table(f"{title}, {stratum} from the scout", found)
        for stratum, found in content["by_stratum"].items()
    ]
    tell(content, as_json, *tables, f"{written}, .parquet, .png")
