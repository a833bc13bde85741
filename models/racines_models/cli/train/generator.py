"""The command `racines train generator`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import read_settings, seed_of
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from racines_models.protocol import Run


def train_generator(
    name: Annotated[str, typer.Argument(help="A registered generator, or module:Class.")],
    tier: opt.Tier = None,
    data: opt.Data = opt.DATA,
    out: opt.OwnOut = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    processes: Annotated[
        int, typer.Option(min=1, help="Processes on this machine that share each batch.")
    ] = 1,
    resume: opt.Resume = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train a generator on the train split; leaves model, config, metrics and samples.

    With --tier patients it learns from scouts of train patients, which are drawn on the way and
    kept in models/runs/scouts; the model goes to models/runs/patients/NAME.
    """
    from racines_data.config import section
    from racines_data.errors import RacinesError
    from racines_models.cli.output import tell
    from racines_models.protocol import Run
    from racines_models.registry import generator_class, on_patients, run_folder

    cls = generator_class(name)
    values = read_settings(params, profile)
    of_patients = on_patients(tier)
    if of_patients and processes > 1:
        raise RacinesError(
            "--processes: on patients a generator trains in one process: leave it out"
        )
    if of_patients and data != opt.DATA:
        raise RacinesError("--data is not for --tier patients: leave it out")
    where = ("patient_generators" if of_patients else "generators", cls.name)
    scouts = section(values, "scouts") if of_patients else None
    folder = out or run_folder(name, tier=tier)
    run = Run(folder, seed_of(values, seed), device, resume, progress=not as_json)
    metrics = _started(processes, name, section(values, where), data, run, scouts)
    if metrics is not None:
        tell({"out": str(folder), **metrics}, as_json, f"{folder}: {_words(metrics)}")


def _started(processes: int, *fit: Any) -> dict[str, Any] | None:
    """Return the metrics, or None in a process whose word is not needed."""
    from racines_models.training.processes import in_processes, is_main_process, leave

    if processes > 1:
        return in_processes(processes, _fit, *fit)
    try:
        metrics = _fit(*fit)
        return metrics if is_main_process() else None
    finally:
        leave()


def _fit(
    name: str, settings: dict[str, Any], data: Path, run: "Run", scouts: dict[str, Any] | None
) -> dict[str, Any]:
    from racines_data.config import fill
    from racines_data.progress import progress_bar
    from racines_data.store.frames import open_store
    from racines_data.store.scouts import FOLDER, ScoutsConfig, ScoutStore
    from racines_models.registry import generator_class
    from racines_models.training.checkpoint import train_seeds

    cls = generator_class(name)
    section = "generators" if scouts is None else "patient_generators"
    config = fill(cls.Config, settings, f"{section}.{cls.name}")
    if scouts is None:
        store = open_store(data)
    else:
        wanted = fill(ScoutsConfig, scouts, "scouts")
        with progress_bar(run.progress, "patients") as bar:
            task = bar.add_task("scouts", total=wanted.count)
            store = ScoutStore(FOLDER, wanted, lambda some: bar.advance(task, some))
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    return train_seeds(lambda one: cls(config).fit(store, one), run, repeats)


def _words(metrics: dict[str, Any]) -> str:
    parts = [f"{k} {v:,}" for k, v in metrics.items() if not isinstance(v, dict | str)]
    if validation := metrics.get("validation"):
        parts.append("PSNR {psnr:.2f} dB on {n} {split} frames".format(**validation))
    return ", ".join(parts)
