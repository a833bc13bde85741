"""What is done for each of many patients, in one process or in several, with its progress."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from racines_data.engines.local import LocalEngine
from racines_data.progress import progress_bar

State = TypeVar("State")
Done = TypeVar("Done")


def exhaust(done: Iterator[object]) -> None:
    """Let all be done, where it leaves files and returns nothing."""
    for _ in done:
        pass


def of_each(
    work: Callable[[State, int], Done], state: State, patients: Sequence[int], what: str,
    shown: bool, processes: int = 1,
) -> Iterator[Done]:  # fmt: skip
    """Yield what is done for each patient, in their order.

    Args:
        work: a function of a module; with several processes, what it returns is pickled.
        state: what all share.
        patients: seeds.
        what: it is, beside the progress bar.
        shown: whether there is one.
        processes: that work at once.
    """
    with progress_bar(shown, "patients") as bar:
        task = bar.add_task(what, total=len(patients))
        # One thread of torch in each of several; alone, as many as this process has.
        threads = 1 if processes > 1 else None
        for done in LocalEngine(processes).map(work, state, patients, threads):
            yield done
            bar.advance(task)
