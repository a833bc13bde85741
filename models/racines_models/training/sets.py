"""Sets of trainings: of one method or of many, each with several seeds.

    methods ──> seeds of each ──> one after another, or beside each other on workers ──> metrics

Each seed is a run of its own, in the folder that `checkpoint` names. One that is done leaves a note
there until the whole set is, so that a set that was killed goes on with what was not, the seeds it
was at from their checkpoints.
"""

import dataclasses
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.engines import Engine, Trials
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.terminal import say
from racines_models.protocol import Run
from racines_models.training.checkpoint import PREFIX, repeat_folders
from racines_models.training.processes import is_main_process

FINISHED = "finished.json"
"""In the folder of a run that is done, while others of its set are not."""

Metrics = dict[str, Any]
Take = Callable[[int, Metrics | RacinesError], None]
"""Takes the number of a waiting run, and its metrics or why it was refused."""


@dataclass(frozen=True)
class Training:
    """One method, and the seeds that it is trained with."""

    fit: Callable[[Run], Metrics]
    """Trains one run, and returns its metrics; picklable where workers are processes."""
    run: Run
    """Of the first seed; the others follow it."""
    repeats: int = 1
    what: Any = None
    """What is trained, as JSON: a seed that was done as something else is trained anew."""

    @property
    def runs(self) -> list[Run]:
        """One run a seed."""
        seeds = range(self.run.seed, self.run.seed + self.repeats)
        folders = [self.run.folder, *(self.run.folder / f"{PREFIX}{k}" for k in seeds[1:])]
        pairs = zip(seeds, folders, strict=True)
        return [dataclasses.replace(self.run, seed=k, folder=folder) for k, folder in pairs]


def train_seeds(
    fit: Callable[[Run], Metrics], run: Run, repeats: int, engine: Engine | None = None,
    what: Any = None,
) -> Metrics:  # fmt: skip
    """Train seeds `run.seed`, `run.seed + 1`, …; return the first's metrics, all under `seeds`.

    As `train_set` of the one method, which is refused at the first seed that is.
    """
    return train_set([Training(fit, run, repeats, what)], engine)[0]


def train_set(
    trainings: Sequence[Training],
    engine: Engine | None = None,
    told: Callable[[Run, Metrics | RacinesError], None] | None = None,
) -> list[Metrics]:
    """Train several methods; return the metrics of each: its first seed's, and all under `seeds`.

    Args:
        trainings: In the order in which they begin.
        engine: Where they run, started; each seed is a task, which goes on from its checkpoint if
            its worker dies. All workers have to see the folders. None: here, one after another.
        told: Is told of each run once it is done, with its metrics or why it was refused.

    Raises:
        RacinesError: a folder is asked for twice, or holds trainings of other seeds, and
            `run.resume` is not False; a training was refused, after all others are done; or
            workers wrote into another folder.
    """
    _check_folders(trainings)
    if is_main_process():
        for each in trainings:
            _clear(each)
    if len(trainings) == 1 and trainings[0].repeats == 1 and engine is None:
        metrics = trainings[0].fit(trainings[0].run)
        if is_main_process():
            _forget(trainings[0])  # what a set that was killed noted of it
        return [metrics]
    done: dict[Path, Metrics | RacinesError] = {}
    waiting: list[tuple[int, Run]] = []
    for place, each in enumerate(trainings):
        for run in each.runs:
            metrics = _finished(each, run)
            if metrics is None:
                waiting.append((place, run))
            else:
                done[run.folder] = metrics

    def take(number: int, metrics: Metrics | RacinesError) -> None:
        run = waiting[number][1]
        done[run.folder] = metrics
        if told:
            told(run, metrics)

    if engine is None:
        _one_by_one(trainings, waiting, take)
    else:
        _on_workers(trainings, waiting, take, engine)
    refused = {folder: each for folder, each in done.items() if isinstance(each, RacinesError)}
    if len(trainings) == 1 and refused:
        raise next(iter(refused.values()))
    if refused:
        reasons = "; ".join(f"{folder}: {why}" for folder, why in refused.items())
        raise RacinesError(
            f"{len(refused)} of {len(done)} trainings were refused: {reasons} (the others are "
            "kept: the same command goes on)"
        )
    metrics = [_summed_up(each, done) for each in trainings]
    if is_main_process():
        for each in trainings:
            _forget(each)
    return metrics


def _check_folders(trainings: Sequence[Training]) -> None:
    folders = [run.folder.absolute() for each in trainings for run in each.runs]
    for folder in folders:
        if folders.count(folder) > 1:
            raise RacinesError(f"{folder}: two trainings would write there: name each once")
    for each in trainings:
        if (others := _others(each)) and each.run.resume is not False:
            names = ", ".join(folder.name for folder in others)
            raise RacinesError(
                f"{each.run.folder}: holds trainings that this run would remove ({names}; repeats "
                f"is {each.repeats}): move them away, raise repeats, give another --out, or --fresh"
            )


def _others(training: Training) -> list[Path]:
    own = [run.folder for run in training.runs]
    return [folder for folder in repeat_folders(training.run.folder) if folder not in own]


def _clear(training: Training) -> None:
    """Remove what a training that begins anew would take for its own."""
    for folder in _others(training):
        shutil.rmtree(folder)
    if training.run.resume is False:
        _forget(training)


def _forget(training: Training) -> None:
    for run in training.runs:
        (run.folder / FINISHED).unlink(missing_ok=True)


def _finished(training: Training, run: Run) -> Metrics | None:
    """Return the metrics of a run that is done, of this very training; None if it is not."""
    try:
        note = json.loads((run.folder / FINISHED).read_text(encoding="utf-8"))
        if note["seed"] == run.seed and note["what"] == _as_json(training.what):
            return note["metrics"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError):
        pass  # cut short, or another's: it is made again
    say(f"racines: {run.folder}: done with other settings: it is trained anew", err=True)
    return None


def _one_by_one(
    trainings: Sequence[Training], waiting: Sequence[tuple[int, Run]], take: Take
) -> None:
    for number, (place, run) in enumerate(waiting):
        # Only the seed that was cut short has a checkpoint.
        later = number > 0 and run.resume is True
        task = place, dataclasses.replace(run, resume=None) if later else run
        take(number, metrics := _train(trainings, task))
        if len(trainings) == 1 and isinstance(metrics, RacinesError):
            return


def _on_workers(
    trainings: Sequence[Training], waiting: Sequence[tuple[int, Run]], take: Take, engine: Engine
) -> None:
    def took(number: int, metrics: Metrics | RacinesError) -> None:
        refused = isinstance(metrics, RacinesError)
        if not refused and not (run := waiting[number][1]).folder.is_dir():
            metrics = RacinesError(
                f"{run.folder}: a worker trained seed {run.seed} and nothing is there: give --out "
                "a folder that all nodes of the cluster see"
            )
        take(number, metrics)

    # Any of them may have been cut short, or not begun.
    tasks = [
        (place, dataclasses.replace(run, resume=None if run.resume else run.resume, progress=False))
        for place, run in waiting
    ]
    given = _train, tuple(trainings), tasks
    settings: Any = {"threads": None, "remedy": "to go on"}
    if isinstance(engine, Trials):
        engine.trials(*given, told=took, **settings)
        return
    for number, metrics in enumerate(engine.map(*given, **settings)):
        took(number, metrics)


def _train(trainings: Sequence[Training], task: tuple[int, Run]) -> Metrics | RacinesError:
    """Train one run; a refusal is returned, so that others of the set go on."""
    place, run = task
    training = trainings[place]
    try:
        metrics = training.fit(run)
        if is_main_process():
            note = {"seed": run.seed, "what": _as_json(training.what), "metrics": metrics}
            write_json(run.folder / FINISHED, note)
    except RacinesError as error:
        return error
    except OSError as error:
        return RacinesError(str(error))
    return metrics


def _summed_up(training: Training, done: dict[Path, Any]) -> Metrics:
    """Return a method's metrics; written into its folder where it has several seeds."""
    own = [done[run.folder] for run in training.runs]
    if training.repeats == 1:
        return own[0]
    seeds = {str(run.seed): each for run, each in zip(training.runs, own, strict=True)}
    metrics = own[0] | {"seeds": seeds}
    if is_main_process():
        write_json(training.run.folder / "metrics.json", metrics)
    return metrics


def _as_json(value: Any) -> Any:
    """Return a value as it is once it has been written and read again."""
    return json.loads(json.dumps(value, default=str))
