"""The command `racines train motion`. Heavy imports stand inside, so that --help is instant."""

from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_data.errors import RacinesError
from racines_models.cli.device import Device


def train_motion(
    name: Annotated[str, typer.Argument(help="mean-motion, pair-cnn, or module:Class.")],
    data: opt.Data = opt.DATA,
    config: opt.Config = "patients",
    out: opt.OwnOut = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train what estimates the probe's motion between frames, on the train split's sweeps.

    Settings: section motions.NAME of the params file. It goes to models/runs/motion/NAME.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.cli.output import metrics_table, tell
    from racines_models.protocol import Run
    from racines_models.trackerless.protocol import estimator_class, run_folder
    from racines_models.trackerless.sweeps import SweepSet
    from racines_models.training.sets import train_seeds

    cls = estimator_class(name)
    if not cls.trained:
        raise RacinesError(f"{cls.name} is not trained: racines eval motion {name}")
    values = read_settings(params, profile)
    settings = fill(cls.Config, section(values, ("motions", cls.name)), f"motions.{cls.name}")
    folder = run_folder(cls.name, out)
    run = Run(folder, seed_of(values, seed), device, resume, progress=not as_json)
    sweeps = SweepSet(open_store(data, config))
    repeats = getattr(getattr(settings, "training", None), "repeats", 1)
    metrics = train_seeds(lambda one: cls(settings).fit(sweeps, one), run, repeats)
    tables = []
    if "metrics" in metrics:
        title = f"{cls.name}, {metrics['split']} split"
        tables.append(metrics_table(title, metrics["metrics"]))
    tell({"out": str(folder)} | metrics, as_json, *tables, f"{folder}: trained")
