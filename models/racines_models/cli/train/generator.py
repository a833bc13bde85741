"""The command `racines train generator`. Heavy imports stand inside, so that --help is instant."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import matching, read_settings, seed_of
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from racines_models.protocol import Run
    from racines_models.training.sets import Training


def train_generator(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="name",
            help="Registered generators, module:Class, or a pattern of the section's.",
        ),
    ],
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
    engine: opt.Engine = "local",
    address: opt.Address = None,
    workers: opt.Workers = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train generators on the train split; each leaves model, config, metrics and samples.

    With --tier patients they learn from scouts of train patients, which are drawn on the way and
    kept in models/runs/scouts; a model goes to models/runs/patients/NAME. With `repeats: N` in its
    training, N seeds: the first in that folder, seed n in its seed-<n>. Several names, or a
    pattern, are a set, each in a folder of its own, of --out too; one that was killed goes on.
    --workers N trains so many at a time, --engine ray on a cluster, in folders that all nodes see.
    """
    from racines_data.config import section
    from racines_data.errors import RacinesError
    from racines_models.cli.device import spread
    from racines_models.cli.output import tell_trained, told_of
    from racines_models.registry import on_patients
    from racines_models.training.sets import train_set

    values = read_settings(params, profile)
    of_patients = on_patients(tier)
    if of_patients and processes > 1:
        raise RacinesError(
            "--processes: on patients a generator trains in one process: leave it out"
        )
    if of_patients and data != opt.DATA:
        raise RacinesError("--data is not for --tier patients: leave it out")
    where = "patient_generators" if of_patients else "generators"
    chosen = matching(names, [*section(values, where)], where)
    scouts = section(values, "scouts") if of_patients else None
    several = len(chosen) > 1
    made = [
        _training(each, section(values, (where, _own(each))), data, scouts, tier,
                  out / _own(each) if out and several else out, seed_of(values, seed), device,
                  resume, not as_json)
        for each in chosen
    ]  # fmt: skip
    beside = engine != "local" or (workers or 1) > 1
    if processes > 1 and (several or beside):
        raise RacinesError("--processes: one generator, here: give one name, and neither --workers")
    with spread(engine, address, device if beside else None, workers) as pool:
        if pool is None and not several:
            metrics = _started(processes, made[0])
        else:
            metrics = train_set(made, pool, told_of(made))
    if metrics is not None:
        tell_trained(made, metrics, as_json, _words)


def _own(spec: str) -> str:
    from racines_models.registry import generator_class

    return generator_class(spec).name


@dataclass(frozen=True)
class _Fit:
    """Trains a generator on a dataset, or on scouts; both are opened where it trains."""

    spec: str
    config: Any
    data: Path
    scouts: Any | None

    def __call__(self, run: "Run") -> dict[str, Any]:
        from racines_data.progress import progress_bar
        from racines_data.store.frames import open_store
        from racines_data.store.scouts import FOLDER, ScoutStore
        from racines_models.registry import generator_class

        if self.scouts is None:
            store = open_store(self.data)
        else:
            with progress_bar(run.progress, "patients") as bar:
                task = bar.add_task("scouts", total=self.scouts.count)
                store = ScoutStore(FOLDER, self.scouts, lambda some: bar.advance(task, some))
        return generator_class(self.spec)(self.config).fit(store, run)


def _training(
    spec: str, settings: dict[str, Any], data: Path, scouts: dict[str, Any] | None,
    tier: str | None, out: Path | None, seed: int, device: str, resume: bool | None,
    progress: bool,
) -> "Training":  # fmt: skip
    from racines_data.config import fill
    from racines_data.store.scouts import ScoutsConfig
    from racines_models.protocol import Run
    from racines_models.registry import generator_class, run_folder
    from racines_models.training.sets import Training

    cls = generator_class(spec)
    section = "generators" if scouts is None else "patient_generators"
    config = fill(cls.Config, settings, f"{section}.{cls.name}")
    wanted = None if scouts is None else fill(ScoutsConfig, scouts, "scouts")
    run = Run(run_folder(spec, out, tier), seed, device, resume, progress=progress)
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    what = {"generator": cls.name, "config": asdict(config), "scouts": wanted and asdict(wanted)}
    what |= {"data": str(data)}
    return Training(_Fit(spec, config, data, wanted), run, repeats, what)


def _started(processes: int, training: "Training") -> list[dict[str, Any]] | None:
    """Return the metrics, or None in a process whose word is not needed."""
    from racines_models.training.processes import in_processes, is_main_process, leave

    if processes > 1:
        return in_processes(processes, _train, training)
    try:
        metrics = _train(training)
        return metrics if is_main_process() else None
    finally:
        leave()


def _train(training: "Training") -> list[dict[str, Any]]:
    from racines_models.training.sets import train_set

    return train_set([training])


def _words(metrics: dict[str, Any]) -> str:
    parts = [f"{k} {v:,}" for k, v in metrics.items() if not isinstance(v, dict | str)]
    if validation := metrics.get("validation"):
        parts.append("PSNR {psnr:.2f} dB on {n} {split} frames".format(**validation))
    return ", ".join(parts)
