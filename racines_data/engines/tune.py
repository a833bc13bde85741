"""Tasks of hours as trials of Ray Tune: told of as they end, begun again where their worker dies.

Tune keeps nothing that a task would go on from: what it has done stands in its own checkpoint, and
a caller that is killed and run again gives only the tasks that were not done.
"""

import logging
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from typing import Any

from racines_data.engines.worker import Call, run_task
from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.terminal import say

QUIET = {
    "RAY_AIR_NEW_OUTPUT": "0",  # the newer one tells of each trial whatever it was asked
    "RAY_CHDIR_TO_TRIAL_DIR": "0",
    "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
    "TUNE_DISABLE_SIGINT_HANDLER": "1",  # an interruption is the command's
}
"""Settings of Tune that it reads from the environment alone."""


def run_trials(
    call: Call, content: bytes, tasks: Sequence[bytes], told: Callable[[int, Any], None],
    cpus: int, room: int | None, tries: int, remedy: str,
) -> None:  # fmt: skip
    """Run pickled tasks of pickled (work, state) `content` as trials; `told` gets each result.

    Args:
        call: See `Call`.
        content: See `run_task`.
        tasks: See `run_task`.
        told: Gets the number of a task and its result, as it ends.
        cpus: Of a trial.
        room: Trials at a time; None: as many as there are CPUs for.
        tries: How often a trial is begun, if its worker dies.
        remedy: Goes on "run again".

    Raises:
        RacinesError: a task was refused, or begun `tries` times; the other tasks are done.
    """
    tune: Any = needed("ray.tune", "trainings under --engine ray")
    refusals: dict[int, Exception] = {}

    class Told(tune.Callback):
        def on_trial_complete(self, iteration: int, trials: Any, trial: Any, **info: Any) -> None:
            number = trial.config["task"]
            done, result = trial.last_result["made"]
            if done:
                told(number, pickle.loads(result))
            else:
                refusals[number] = pickle.loads(result)

        def on_trial_recover(self, iteration: int, trials: Any, trial: Any, **info: Any) -> None:
            say("racines: a worker died: its training goes on elsewhere", err=True)

    trainable = tune.with_parameters(_trial, call=call, content=content, tasks=list(tasks))
    with _quietly(), TemporaryDirectory() as folder:
        tuner = tune.Tuner(
            tune.with_resources(trainable, {"cpu": cpus}),
            param_space={"task": tune.grid_search([*range(len(tasks))])},
            tune_config=tune.TuneConfig(max_concurrent_trials=room),
            run_config=tune.RunConfig(
                storage_path=folder,
                verbose=0,
                failure_config=tune.FailureConfig(max_failures=tries - 1),
                callbacks=[Told()],
            ),
        )
        results = tuner.fit() if tasks else ()
    for result in results:
        if (error := result.error) is not None:
            raise RacinesError(
                f"a training was begun {tries} times and its worker died each time: run again "
                f"{remedy or 'once the cause is found'}; take fewer at a time, or nodes of more "
                "memory"
            ) from error
    if refusals:
        raise refusals[min(refusals)]


def _trial(config: dict[str, Any], call: Call, content: bytes, tasks: Sequence[bytes]) -> None:
    from ray import tune

    tune.report({"made": run_task(call, lambda: content, tasks[config["task"]])})


@contextmanager
def _quietly() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in QUIET}
    os.environ |= QUIET
    log = logging.getLogger("ray.tune")  # it prints the death of each worker, line by line
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
