"""The command `racines train grader`. Heavy imports stand inside, so that --help is instant."""

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_models.cli.device import Device


def train_grader(
    data: opt.Data = opt.DATA,
    config: opt.Config = "frames",
    out: opt.Out = opt.GRADER,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train the grader: views first, then grades; report on the test split."""
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_training
    from racines_models.judges.grader import training as grader_training
    from racines_models.judges.grader.model import grader_of
    from racines_models.protocol import Run

    values = read_settings(params, profile)
    kind, stated = grader_of(section(values, "grader"))
    settings = fill(kind.Config, stated, "grader")
    run = Run(out, seed_of(values, seed), device, resume, progress=not as_json)
    metrics = grader_training.train_grader(open_store(data, config), settings, run, kind)
    show_training("grader", out, metrics, as_json)
