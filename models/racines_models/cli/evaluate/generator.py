"""The command `racines eval generator`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, read_settings
from racines_data.errors import RacinesError
from racines_models.cli.device import Device


def eval_generator(
    name: Annotated[
        str, typer.Argument(help="A registered generator, module:Class, FILE.onnx or FILE.parquet.")
    ],
    tier: opt.Tier = None,
    patients: opt.Patients = None,
    data: opt.Data = opt.DATA,
    run: opt.Trained = None,
    grader: opt.Grader = None,
    no_grader: opt.NoGrader = False,
    pose: opt.Pose = None,
    no_pose: opt.NoPose = False,
    out: opt.Out = Path("models/runs/scores"),
    split: opt.OneSplit = None,
    samples: opt.Samples = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    engine: opt.Engine = "local",
    address: opt.Address = None,
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Score a generator on held-out poses; write NAME.json and a picture NAME.png.

    NAME.parquet has the figures of every frame, from which those in NAME.json follow.
    Another result that is there stays, unless --force is given; the same may be written again.
    Judges are those of the settings, models/runs/grader and models/runs/pose by default; a pose
    regressor that is not there is left out. Published trainings of the board count as the run's
    (models/weights/<board>/NAME/seed-<n>); of --run FOLDER, those in it.
    With --tier patients it is shown a scout of each of --patients of the split, adapts if it can,
    and draws poses at stated distances from it; judges are those of patients.
    """
    from racines_models.registry import on_patients

    if on_patients(tier):
        from racines_models.cli.evaluate.on_patients import evaluate_on_patients

        vain = {
            "--data": data != opt.DATA, "--grader": grader, "--no-grader": no_grader,
            "--no-pose": no_pose, "--samples": samples,
        }  # fmt: skip
        for option in (option for option, there in vain.items() if there):
            raise RacinesError(f"{option} is not for --tier patients: leave it out")
        chosen = given(split=split, patients=patients, pose=pose)
        return evaluate_on_patients(
            name, chosen, read_settings(params, profile), run=run, out=out, device=device,
            engine=engine, address=address, force=force, as_json=as_json,
        )  # fmt: skip
    if patients:
        raise RacinesError("--patients needs --tier patients")
    from racines_data.config import fill, section
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.cli.device import spread
    from racines_models.cli.output import metrics_table, tell
    from racines_models.judges.grader.model import Grader
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.pictures import pick_columns, write_strip
    from racines_models.published.places import WEIGHTS, of_weights
    from racines_models.registry import is_file, open_runs, run_folder, weights_of
    from racines_models.scores.scoring import ScoresConfig, score, take_turns
    from racines_models.statistics import write_scores
    from racines_models.training.published import published_seeds

    values = read_settings(params, profile)
    settings = section(values, "scores") | given(split=split, samples=samples)
    config = fill(ScoresConfig, settings, "scores")
    store = open_store(data)
    grader = of_weights(grader or Path(config.grader))
    if not no_grader and not grader.is_dir():
        raise RacinesError(
            f"{grader}: no grader; run: racines train grader, or give --grader "
            f"{WEIGHTS / 'grader'}, the published one, or --no-grader"
        )
    judge = None if no_grader else Grader.load(grader, device)
    further: list[Path] = []
    if run is None and not is_file(name):
        further = published_seeds(values.get("board"), run_folder(name))
    runs: Any = open_runs(name, run, further, device=device, store=store, split=config.split)
    title: str = runs[0].name
    written = out / f"{title}.json"
    if Path(name).resolve() == written.with_suffix(".parquet").resolve():
        raise RacinesError(f"{name}: the scores would replace it: write elsewhere with --out")
    usual = of_weights(Path(config.pose))
    pose = None if no_pose else of_weights(pose) if pose else (usual if usual.is_dir() else None)
    regressor = None if pose is None else PoseRegressor.load(pose, device)
    total = min(config.samples, len(store.split_indices(config.split)))
    total *= 1 + 2 * len(take_turns(runs, config.seeds))
    counter = image_counter(f"scoring {title}", total, hidden=as_json)
    with spread(engine, address, device) as pool, counter as advance:
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
            engine=pool,
        )
    content: dict[str, Any] = {**scores.content, "weights": weights_of(name, run, further) or None}
    content["dataset"]["board"] = values.get("board")
    content = write_scores(written, content, scores.evidence, force)
    frames = scores.sample.frames
    columns = pick_columns(frames.views, frames.grades, len(store.labels) - 1)
    write_strip(out / f"{title}.png", [frames.images[columns], scores.images[columns]])
    table = metrics_table(f"{title}, {config.split} split", content["metrics"])
    tell(content, as_json, table, f"{written}, .parquet, .png")
