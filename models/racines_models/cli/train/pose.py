"""The command `racines train pose`. Heavy imports stand inside, so that --help is instant."""

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_models.cli.device import Device


def train_pose(
    data: opt.Data = opt.DATA,
    config: opt.Config = "frames",
    out: opt.Out = opt.POSE,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train the pose regressor, which reads the pose back from an image; report on the test split.

    Of patients it reads the pose about the heart. Settings: section `pose` of the params file.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_training
    from racines_models.judges.pose import training as pose_training
    from racines_models.judges.pose.regressor import PoseConfig
    from racines_models.protocol import Run

    values = read_settings(params, profile)
    settings = fill(PoseConfig, section(values, "pose"), "pose")
    run = Run(out, seed_of(values, seed), device, resume, progress=not as_json)
    metrics = pose_training.train_pose(open_store(data, config), settings, run)
    show_training("pose regressor", out, metrics, as_json)
