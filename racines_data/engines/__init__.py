"""Engines: who runs the tasks of long work, on this machine or on many.

    with open_engine("ray", address) as engine:
        for result in engine.map(work, state, tasks):     # in the order of the tasks
            ...

Work is a function of a module, `work(state, task) -> result`; all three are picklable, and a result
depends on nothing else, so that every engine gives the same. A new engine is one file, and one
entry point of the group `racines.engines`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol, Self, TypeVar, runtime_checkable

from racines_data.errors import RacinesError
from racines_data.plugins import Plugins

State = TypeVar("State")
Task = TypeVar("Task")
Result = TypeVar("Result")

LOCAL = "local"
ENGINES = Plugins("engine", "racines.engines", ("map",))


class Engine(Protocol):
    """Runs tasks; used as a context manager, which ends what it started."""

    own_files: bool
    """Whether what a task writes into a folder of this machine is there afterwards."""
    size: int
    """Tasks that run at the same time."""

    def __enter__(self) -> Self:
        """Start what tasks need."""
        ...

    def __exit__(self, *error: object) -> None:
        """End what was started."""
        ...

    def map(
        self,
        work: Callable[[State, Task], Result],
        state: State,
        tasks: Iterable[Task],
        threads: int | None = 1,
        remedy: str = "",
    ) -> Iterator[Result]:
        """Yield `work(state, task)` of each task, in order.

        Args:
            work: A function of a module.
            state: What all tasks share; it reaches each worker once.
            tasks: What is to be done; taken as there is room for more.
            threads: CPU threads of torch in a task, on which last bits depend; None: as many as
                this process has.
            remedy: Goes on "run again", where workers die and nothing else can be done.

        Raises:
            RacinesError: a task refused its input, or workers died of it.
        """
        ...


@runtime_checkable
class Trials(Protocol):
    """What an engine may have besides: tasks of hours, told of as they end, in any order."""

    def trials(
        self,
        work: Callable[[State, Task], Result],
        state: State,
        tasks: Sequence[Task],
        told: Callable[[int, Result], None],
        threads: int | None = 1,
        remedy: str = "",
    ) -> None:
        """Run `work(state, task)` of each task; `told` gets its number and result.

        Raises:
            RacinesError: as `Engine.map`, once the other tasks are done.
        """
        ...


def open_engine(
    name: str = LOCAL, address: str | None = None, workers: int | None = None
) -> Engine:
    """Return an engine that is not started yet.

    Args:
        name: A registered engine, or `module:Class`.
        address: Of a cluster; None: on this machine.
        workers: Tasks at the same time; None: one here, on a cluster as many as it has CPUs.

    Raises:
        RacinesError: an unknown engine, or an address for one that works here alone.
    """
    if name == LOCAL and address is not None:
        raise RacinesError(f"--address {address}: give --engine ray as well, or leave it out")
    found: Any = ENGINES.load(name)
    return found(address=address, workers=workers)
