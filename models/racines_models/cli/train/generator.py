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
    """Train a generator on the train split; leaves model, config, metrics and samples."""
    from racines_data.config import section
    from racines_models.cli.output import tell
    from racines_models.protocol import Run
    from racines_models.registry import generator_class

    cls = generator_class(name)
    values = read_settings(params, profile)
    settings = section(values, ("generators", cls.name))
    folder = out or Path("models/runs") / cls.name
    run = Run(folder, seed_of(values, seed), device, resume, progress=not as_json)
    metrics = _started(processes, name, settings, data, run)
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


def _fit(name: str, settings: dict[str, Any], data: Path, run: "Run") -> dict[str, Any]:
    from racines_data.config import fill
    from racines_data.store.frames import open_store
    from racines_models.registry import generator_class
    from racines_models.training.checkpoint import train_seeds

    cls, store = generator_class(name), open_store(data)
    config = fill(cls.Config, settings, f"generators.{cls.name}")
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    return train_seeds(lambda one: cls(config).fit(store, one), run, repeats)


def _words(metrics: dict[str, Any]) -> str:
    parts = [f"{k} {v:,}" for k, v in metrics.items() if not isinstance(v, dict | str)]
    if validation := metrics.get("validation"):
        parts.append("PSNR {psnr:.2f} dB on {n} {split} frames".format(**validation))
    return ", ".join(parts)
