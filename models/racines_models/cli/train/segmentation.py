"""The command `racines train segmentation`. Heavy imports stand inside, so that --help is quick."""

from pathlib import Path

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_models.cli.device import Device


def train_segmentation(
    data: opt.Data = opt.DATA,
    config: opt.Config = "patients",
    out: opt.Out = Path("models/runs/segmentation"),
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train the segmentation judge, which outlines chambers and walls; report on test patients.

    Settings: section `segmentation` of the params file. The dataset's frames have masks.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_training
    from racines_models.judges.segmentation import training as segmentation_training
    from racines_models.judges.segmentation.frames import MaskSet
    from racines_models.judges.segmentation.model import SegmentationConfig
    from racines_models.protocol import Run

    values = read_settings(params, profile)
    settings = fill(SegmentationConfig, section(values, "segmentation"), "segmentation")
    run = Run(out, seed_of(values, seed), device, resume, progress=not as_json)
    frames = MaskSet.of(open_store(data, config))
    metrics = segmentation_training.train_segmentation(frames, settings, run)
    show_training("segmentation judge", out, metrics, as_json)
