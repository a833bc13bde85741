"""How a generator is told the pose, four ways: raw Euler or continuous, at the input or throughout.

One method, four trainings that differ in nothing but `conditioning` and `injection`, judged on the
same validation frames; the test split is left alone.
"""

import dataclasses
from itertools import product
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.manifest import scale_known
from racines_data.store.frames import FrameStore
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.pose.training import pose_errors
from racines_models.networks.layers import INJECTIONS, MODES
from racines_models.protocol import Generator, Run
from racines_models.sample import Sample, draw, take_sample
from racines_models.scores import metrics

SCHEMA = "racines.conditioning-ablation/1"


def run_ablation(
    cls: type[Generator],
    config: Any,
    store: FrameStore,
    run: Run,
    frames: int = 500,
    pose: PoseRegressor | None = None,
) -> dict[str, Any]:
    """Train all four and write `conditioning.json` into `run.folder`; each has a folder there.

    A variant whose training is finished is not trained again: its model is read and judged, on so
    many validation frames. `config`, with keys `conditioning` and `injection`, is what the four
    have in common; a pose regressor adds the pose error of the drawn images.
    """
    missing = {"conditioning", "injection"} - {f.name for f in dataclasses.fields(config)}
    if missing:
        raise RacinesError(f"{cls.name} has no {' and '.join(sorted(missing))} to vary")
    sample = take_sample(store, "validation", frames)
    rows = []
    for conditioning, injection in product(MODES, INJECTIONS):
        keys = {"conditioning": conditioning, "injection": injection}
        name = f"{conditioning}-{injection}"
        of_variant = dataclasses.replace(run, folder=run.folder / name)
        generator = _trained(cls, dataclasses.replace(config, **keys), store, of_variant)
        rows.append({"name": name, **keys, **judge(generator, sample, run.seed, pose)})
    content = {
        "schema": SCHEMA,
        "generator": cls.name,
        "data": {key: store.manifest.get(key) for key in ("source", "version", "digest")},
        "seed": run.seed,
        "config": dataclasses.asdict(config),
        "split": "validation",
        "n": len(sample.trajectory),
        "sample": sample.digest,
        "variants": rows,
    }
    write_json(run.folder / "conditioning.json", content)
    return content


def _trained(cls: type[Generator], config: Any, store: FrameStore, run: Run) -> Generator:
    if (run.folder / "metrics.json").is_file():
        found = cls.load(run.folder, run.device)
        wanted = cls(config).card.config
        if (found.card.config, found.card.seed) == (wanted, run.seed) and (
            found.card.data["digest"] == store.manifest.get("digest")
        ):
            return found
    generator = cls(config)
    generator.fit(store, run)
    return generator


def judge(
    generator: Generator, sample: Sample, seed: int, pose: PoseRegressor | None = None
) -> dict[str, float]:
    """Return how well drawn images fit the frames of their poses.

    Returns:
        Means of `psnr` (dB) and `ssim`; `own_frame`, the share of drawn images that are nearer, in
        mean square, to the frame of their pose than to another of the sample, half of it away
        (0.5: the pose is ignored); with a regressor also the medians `pose_error_mm` and
        `pose_error_deg`.
    """
    drawn, truth = draw(generator, sample.frames, seed), sample.frames.images
    other = truth.roll(len(truth) // 2, 0)
    own, apart = ((drawn.float() - x.float()).square().mean((1, 2)) for x in (truth, other))
    figures = {
        "psnr": float(metrics.psnr(drawn, truth).mean()),
        "ssim": float(metrics.ssim(drawn, truth).mean()),
        "own_frame": float((own < apart).double().mean()),
    }
    if pose is not None:
        millimetres, degrees = pose_errors(pose.predict(drawn), sample.frames.parameters)
        if scale_known(generator.card.data):
            figures["pose_error_mm"] = float(millimetres.median())
        figures["pose_error_deg"] = float(degrees.median())
    return figures
