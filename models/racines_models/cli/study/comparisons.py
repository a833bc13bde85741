"""Commands: study ablation, conditioning, floor, leakage. Heavy imports stand inside."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_data.errors import RacinesError
from racines_models.cli.device import Device
from racines_models.cli.study.realism import Real, no_real, realism_settings


def ablation(
    real: Real = None,
    hearts: Annotated[int, typer.Option(min=1, help="Hearts 1 … of the population.")] = 12,
    poses: Annotated[int, typer.Option(min=2, help="Poses of each heart.")] = 8,
    variant: Annotated[
        list[str] | None, typer.Option(help="Only this variant; repeat for several.")
    ] = None,
    out: opt.Report = Path("models/runs/ablation"),
    into: Annotated[
        Path | None, typer.Option(help="Report of study realism that takes the list up.")
    ] = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Measure what each part of the phantom brings: KID to real frames without it.

    A report that is there goes on: the rows it has are kept.
    """
    from racines_data.files import write_atomic
    from racines_data.phantom import PhantomConfig
    from racines_data.progress import image_counter
    from racines_data.tables import console_table
    from racines_models.cli.output import ranged, tell
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.ablation import run as study
    from racines_models.studies.realism.report import read_real

    config, path = realism_settings(real, None, params, profile)
    if path is None:
        raise RacinesError(no_real(path))
    frames, variants = read_real(path), study.pick_variants(variant)
    setting = study.Setting(PhantomConfig(), study.AblationConfig(hearts, poses), config)
    total = 2 * len(variants) * hearts * poses + min(len(set(frames.patient)), 2 * config.frames)
    with image_counter("ablation", total, as_json) as advance:
        extractor, report = InceptionFeatures(device), out.with_suffix(".json")
        content = study.ablate(frames, variants, setting, extractor, report, advance)
    write_atomic(out.with_suffix(".png"), study.draw_ablation(content))
    if into is not None:
        study.merge_into(into, content)
    rows, changed = [], "{change:+.4f} ({change_low:+.4f} to {change_high:+.4f})"
    for row in (content["base"], *content["ablation"]):
        change = changed.format(**row) if "change" in row else ""
        rows.append((row["name"], ranged({"value": row["kid"], **row}), change))
    head = ("variant", "KID (range over splits)", "change (range over the same splits)")
    title = f"{content['view']}, {content['n']} frames a set, {content['splits']} splits"
    written = f"{out}.json, {out}.png" + (f"; list in {into}" if into else "")
    tell(content, as_json, console_table(head, rows, title), written)


def conditioning(
    name: Annotated[str, typer.Argument(help="A generator with conditioning and injection.")],
    data: opt.Data = opt.DATA,
    out: opt.OwnOut = None,
    images: Annotated[
        int | None, typer.Option(min=1, help="Training images of each variant; default: params'.")
    ] = None,
    frames: Annotated[int, typer.Option(min=2, help="Validation frames that judge.")] = 500,
    pose: opt.Pose = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Train a generator four ways (Euler or continuous, concat or norm) and compare them.

    A pose regressor adds the error of the poses; all goes to models/runs/conditioning-NAME.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_data.tables import console_table
    from racines_models.cli.output import tell
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.protocol import Run
    from racines_models.registry import generator_class
    from racines_models.studies.conditioning import run_ablation

    cls, values = generator_class(name), read_settings(params, profile)
    settings = section(values, ("generators", cls.name))
    config: Any = fill(cls.Config, settings, f"generators.{cls.name}")
    if images is not None:
        config = replace(config, training=replace(config.training, images=images))
    regressor = PoseRegressor.load(pose, device) if pose else None
    out = out or Path("models/runs") / f"conditioning-{cls.name}"
    run = Run(out, seed_of(values, seed), device, progress=not as_json)
    content = run_ablation(cls, config, open_store(data), run, frames, regressor)
    title = f"{content['generator']}, {content['n']} {content['split']} frames"
    figures = [key for key, value in content["variants"][0].items() if isinstance(value, float)]
    rows = [
        (row["conditioning"], row["injection"], *(f"{row[figure]:.4g}" for figure in figures))
        for row in content["variants"]
    ]
    head = ("conditioning", "injection", *figures)
    tell(content, as_json, console_table(head, rows, title, right=2))


def floor(
    data: opt.Data = opt.DATA,
    out: opt.Report = Path("models/runs/floor"),
    sizes: Annotated[
        list[int] | None,
        typer.Option("--n", min=2, help="Frames of each half; repeat.  [default: 128 … 1024]"),
    ] = None,
    splits: Annotated[int, typer.Option(min=1, help="Random halvings.")] = 10,
    split: opt.Split = "test",
    seed: opt.DrawSeed = 0,
    grader: opt.Grader = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps features.")] = Path(
        "models/runs/scores/reference"
    ),
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Compare true frames with true frames: the FID and KID that a perfect generator would have.

    Two halves of a split that share no trajectory, at several n; by the features of Inception and
    of the grader, that of models/runs/grader if it is there.
    """
    from racines_data.files import write_atomic, write_json
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.cli.output import ranged, tell
    from racines_models.judges.grader.model import Grader
    from racines_models.scores.features import Extractor, GraderFeatures, InceptionFeatures
    from racines_models.studies.floor import FloorConfig, draw_floor, frames_needed, measure_floor

    extractors: dict[str, Extractor] = {"inception": InceptionFeatures(device)}
    grader = grader or (opt.GRADER if opt.GRADER.is_dir() else None)
    if grader is not None:
        extractors["grader"] = GraderFeatures(Grader.load(grader, device))
    config = FloorConfig(tuple(sizes or FloorConfig.sizes), splits, split, seed)
    store = open_store(data)
    total = len(frames_needed(store, config).trajectory)
    with image_counter("truth against truth", total, hidden=as_json) as advance:
        content = measure_floor(store, extractors, config, cache, advance)
    write_atomic(out.with_suffix(".png"), draw_floor(content))
    write_json(out.with_suffix(".json"), content)
    lines = [
        f"{name}, n = {row['n']}: FID {ranged(row['fid'])}, KID {ranged(row['kid'])}"
        for name, rows in content["rows"].items()
        for row in rows
    ]
    tell(content, as_json, *lines, f"{out}.json, {out}.png")


def leakage(
    root: opt.Root = None,
    out: opt.Report = Path("models/runs/leakage"),
    config: opt.Config = "frames",
    samples: Annotated[int, typer.Option(min=2, help="Test frames looked up.")] = 2000,
    seed: opt.DrawSeed = 0,
    as_json: opt.AsJson = False,
) -> None:
    """Audit each held-out trajectory for leaks, and score a random split of frames beside ours.

    Exit 1 if a trajectory of validation or test has frames of an earlier split, as they are or
    mirrored, re-encoded or under noise, beyond the limits that the report states.
    """
    from racines_data.errors import RacinesError
    from racines_data.files import write_json
    from racines_data.manifest import default_root
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_data.tables import console_table
    from racines_data.validate.leaks import check_patients
    from racines_models.cli.output import ranged, tell
    from racines_models.pictures import pick_columns, write_strip
    from racines_models.studies.leakage import LeakageConfig, measure_leakage

    store = open_store(default_root(root), config)
    check_patients(store)
    total = 2 * min(samples, len(store.split_indices("test")))
    held = store.manifest.get("held_out_session")
    if held is not None:
        total += min(samples, store.manifest["counts"]["sessions"][held])
    with image_counter("leakage", total, hidden=as_json) as advance:
        result = measure_leakage(store, LeakageConfig(samples, seed), advance)
    content, found = result.content, result.retrievals
    frames = found["trajectory"].sample.frames
    columns = pick_columns(frames.views, frames.grades)
    rows = [frames.images, found["trajectory"].images, found["frame"].images]
    write_strip(out.with_suffix(".png"), [images[columns] for images in rows])
    write_json(out.with_suffix(".json"), content)

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    splits = content["splits"].values()
    table = (
        ("test frames", *(f"{each['ssim']['n']}" for each in splits)),
        ("frames to look up", *(f"{each['train']}" for each in splits)),
        ("SSIM", *(ranged(each["ssim"]) for each in splits)),
        ("PSNR, dB", *(ranged(each["psnr"]) for each in splits)),
        ("median mm away", *(number(each["position_mm"]) for each in splits)),
        ("median degrees away", *(number(each["rotation_deg"]) for each in splits)),
        ("median s away", *(number(each["seconds"]) for each in splits)),
        ("of the same sweep", *(f"{each['same_trajectory']:.1%}" for each in splits)),
    )
    gain = ", ".join(f"{name.upper()} {ranged(each)}" for name, each in content["gain"].items())
    tell(
        content,
        as_json,
        console_table(("split by", *content["splits"]), table, "nearest-pose retrieval"),
        f"what the split by frame adds: {gain}",
        _leak_table(content["leaks"]),
        f"{out}.json, {out}.png (truth; retrieved by trajectory split; by frame split)",
    )
    if leaking := content["leaks"]["leaking"]:
        several = f"{len(leaking)} held-out trajectories leak" if leaking[1:] else "a leak"
        raise RacinesError(
            f"{several}: {', '.join(leaking[:8])}{', …' if leaking[8:] else ''}; take them, or "
            "what they were copied from, out of the dataset"
        )


def _leak_table(leaks: dict[str, Any], most: int = 10) -> Any:
    """Return the held-out trajectories that are most like an earlier one, as a table."""
    from racines_data.tables import console_table

    order = sorted(leaks["trajectories"], key=lambda row: (-row["leaks"], -row["beside"]))
    rows = [
        (
            row["trajectory"],
            row["split"],
            f"{row['exact']}",
            f"{row['copies']:.0%}",
            f"{row['beside']:.0%}",
            row["source"],
            "leaks" if row["leaks"] else "",
        )
        for row in order[:most]
    ]
    limits = leaks["limits"]
    head = ("trajectory", "split", "exact", "copies", "beside", "most like")
    title = (
        f"{len(leaks['leaking'])} of {len(order)} held-out trajectories leak (limits: no exact "
        f"copy, copies {limits['copies']:.0%}, beside {limits['beside']:.0%}); the nearest:"
    )
    return console_table((*head, ""), rows, title)
