"""Processes of their own, in which a stage runs again under other environment variables.

Which instructions PyTorch and oneDNN take is decided once a process, when they are loaded. So each
set of variables has one process, which is started when it is first asked for and runs every stage
that is asked of it.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Self

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_leaderboard.determinism.stages import Arrays, Setup, Stage, Work, threads
from racines_models.training.processes import die_with_parent

ATEN = "ATEN_CPU_CAPABILITY"
ONEDNN = "ONEDNN_MAX_CPU_ISA"
LEVELS = {"DEFAULT": 0, "AVX2": 1, "AVX512": 2}
"""What PyTorch calls the instruction sets of x86 processors, and their order."""


def own_level() -> int:
    """Return the instruction set that PyTorch took in this process, as a place in `LEVELS`."""
    return LEVELS.get(torch.backends.cpu.get_cpu_capability(), 0)


class Processes:
    """The processes of one report; used as a context manager, which ends them."""

    def __init__(self, folder: Path) -> None:
        """Work in a folder, that of a `Work`."""
        self.folder = folder
        self._pools: dict[tuple[tuple[str, str], ...], ProcessPoolExecutor] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for pool in self._pools.values():
            pool.shutdown(cancel_futures=True)

    def run(self, stage: Stage, setup: Setup, variables: Mapping[str, str]) -> Arrays:
        """Run a stage, which has to be picklable, in the process of these variables.

        Raises:
            RacinesError: the process ended, or took another instruction set than it was told.
        """
        pool = self._pool(variables)
        try:
            made = pool.submit(_make, self.folder, stage, setup).result()
        except BrokenProcessPool as error:
            told = " ".join(f"{key}={value}" for key, value in variables.items())
            raise RacinesError(
                f"{stage.name}: its process ended ({told or 'without variables'}): killed, out of "
                "memory, or an instruction that this processor lacks"
            ) from error
        return {name: torch.from_numpy(values) for name, values in made.items()}

    def _pool(self, variables: Mapping[str, str]) -> ProcessPoolExecutor:
        key = tuple(sorted(variables.items()))
        if key not in self._pools:
            pool = ProcessPoolExecutor(1, get_context("spawn"), die_with_parent)
            with _environment(variables):  # the process starts at the first question, this one
                took = pool.submit(torch.backends.cpu.get_cpu_capability).result()
            told = variables.get(ATEN)
            if told is not None and took.lower() != told:
                pool.shutdown()
                raise RacinesError(f"{ATEN}={told}: PyTorch took {took.lower()}")
            self._pools[key] = pool
        return self._pools[key]


@contextlib.contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Let a process that starts now have these instruction sets, and none that we were told."""
    before = {name: os.environ.pop(name, None) for name in (ATEN, ONEDNN)}
    own = {name: value for name, value in before.items() if value is not None}
    os.environ.update(own | dict(variables))
    try:
        yield
    finally:
        for name in (*before, *variables):
            os.environ.pop(name, None)
        os.environ.update(own)


def _make(folder: Path, stage: Stage, setup: Setup) -> dict[str, np.ndarray]:
    """Run a stage in this process."""
    with threads(setup.threads):
        return {key: value.numpy() for key, value in stage.make(Work(folder), setup).items()}
