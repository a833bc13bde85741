"""Tasks on a Ray cluster, or on a Ray of this machine's own.

    tasks ──> as many at a time as there are CPUs, and some that wait ──> workers
    results <── in order <── those that came early <── as they come ────────┘

A worker that dies costs the tasks it had: they run again elsewhere, a few times, for a task that
kills every worker must not go on for ever. Nothing is lost or doubled: a result counts by the
number of its task. Workers need no folder in common with this machine, but for what tasks read.
"""

import os
import pickle
import socket
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Self

from racines_data.engines import Result, State, Task
from racines_data.engines.versions import versions
from racines_data.engines.worker import Call, run_task
from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.terminal import say

TRIES = 4
"""How often a task is begun, if its worker dies."""
WAITING = 2
"""Tasks that wait at each CPU, so that none is idle."""
SECONDS = 10.0
"""Within which a cluster has to answer."""
REACH = "start one with `ray start --head`, check address and firewall, or leave --address out"


class RayEngine:
    """Runs tasks as Ray tasks of one process each."""

    own_files = False

    def __init__(self, workers: int | None = None, address: str | None = None) -> None:
        """Take an address, or that of RAY_ADDRESS, which `ray job submit` sets; else a local Ray.

        Raises:
            RacinesError: Ray is not installed, or no cluster answers there.
        """
        self._ray: Any = needed("ray", "--engine ray")
        self.address = address or os.environ.get("RAY_ADDRESS") or "local"
        _check_address(self.address)
        self._workers, self._started, self.size = workers, False, workers or 1

    def __enter__(self) -> Self:
        """Connect to the cluster, or start one here; an open connection of this process serves."""
        if not self._ray.is_initialized():
            self._connect()
            self._started = True
        cpus = int(self._ray.cluster_resources().get("CPU", 0))
        self.size = max(1, min(self._workers or cpus, cpus))
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the cluster; one that was started here ends."""
        if self._started:
            self._ray.shutdown()

    def _connect(self) -> None:
        own: dict[str, Any] = {}
        if self.address == "local":
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            own = {"include_dashboard": False, "num_cpus": self._workers}
        try:
            self._ray.init(self.address, log_to_driver=False, logging_level="ERROR", **own)
        except ConnectionError as error:
            raise RacinesError(f"--address {self.address}: no Ray there: {REACH}") from error
        except (ValueError, RuntimeError) as error:
            raise _not_started(self.address, error) from error

    def map(
        self,
        work: Callable[[State, Task], Result],
        state: State,
        tasks: Iterable[Task],
        threads: int | None = 1,
        remedy: str = "",
    ) -> Iterator[Result]:
        """Yield results in order, as `Engine.map`; each task has as many CPUs as threads."""
        call, content, cpus = self._call(work, state, threads)
        shared, ray = self._ray.put(content), self._ray
        # Ray would begin a task anew without end where memory is short: here it is counted.
        remote = ray.remote(num_cpus=cpus, max_retries=0)(_run)

        def begin(task: bytes) -> Any:
            return remote.remote(call, [shared], task)

        room = self.size if self._workers else self.size * (1 + WAITING)
        yield from self._in_order(begin, tasks, max(1, room // cpus), remedy)

    def trials(
        self,
        work: Callable[[State, Task], Result],
        state: State,
        tasks: Sequence[Task],
        told: Callable[[int, Result], None],
        threads: int | None = 1,
        remedy: str = "",
    ) -> None:
        """Run each task as a trial of Ray Tune, as `Trials.trials`; its dashboard shows them."""
        from racines_data.engines.tune import run_trials

        call, content, cpus = self._call(work, state, threads)
        room = max(1, self.size // cpus) if self._workers else None
        packed = [self._ray.cloudpickle.dumps(task) for task in tasks]
        run_trials(call, content, packed, told, cpus, room, TRIES, remedy)

    def _call(self, work: Any, state: Any, threads: int | None) -> tuple[Call, bytes, int]:
        """Return what tasks have in common, (work, state) pickled, and the CPUs of a task."""
        import torch

        count = threads or torch.get_num_threads()
        # By value where a script itself, `__main__`, defines it: workers have another.
        content = self._ray.cloudpickle.dumps((work, state))
        self._check_store(len(content))
        cpus = min(count, max(int(node.get("CPU", 1)) for node in self._nodes()))
        return Call(uuid.uuid4().hex, count, os.getcwd(), versions()), content, cpus

    def _in_order(
        self, begin: Callable[[bytes], Any], tasks: Iterable[Any], room: int, remedy: str
    ) -> Iterator[Any]:
        waiting = enumerate(map(self._ray.cloudpickle.dumps, tasks))
        running: dict[Any, tuple[int, bytes, int]] = {}  # by reference: number, task, tries
        early: dict[int, tuple[bool, bytes]] = {}
        following, more = 0, True
        try:
            while True:
                while more and len(running) + len(early) < room:
                    more = (taken := next(waiting, None)) is not None
                    if taken is not None:
                        running[begin(taken[1])] = (*taken, 1)
                if not running and not early:
                    return
                if running and following not in early:
                    (ready, *_), _ = self._ray.wait([*running], num_returns=1)
                    number, task, tries = running.pop(ready)
                    if (result := self._result(ready, tries, remedy)) is None:
                        running[begin(task)] = number, task, tries + 1
                    else:
                        early[number] = result
                while following in early:
                    done, content = early.pop(following)
                    if not done:  # in its turn: what came before it counts
                        raise pickle.loads(content)
                    yield pickle.loads(content)
                    following += 1
        finally:
            for reference in running:
                self._ray.cancel(reference, force=True)

    def _result(self, reference: Any, tries: int, remedy: str) -> tuple[bool, bytes] | None:
        """Return what `run_task` did; None if its worker died and the task is to run again.

        Raises:
            RacinesError: it was begun often enough, or its result has no room.
        """
        lost = self._ray.exceptions
        dead = lost.WorkerCrashedError, lost.NodeDiedError, lost.LocalRayletDiedError
        try:
            return self._ray.get(reference)
        except (*dead, lost.ObjectLostError, lost.OutOfMemoryError) as error:
            hungry = isinstance(error, lost.OutOfMemoryError)
            what = "ran out of memory" if hungry else "died"
            if tries >= TRIES:
                advice = "take fewer at a time with --workers, or nodes of more memory"
                raise RacinesError(
                    f"a task was begun {tries} times and its worker {what} each time: run again "
                    f"{remedy or 'once the cause is found'}; {advice}"
                ) from error
            say(f"racines: a worker {what}: its task runs again", err=True)
            return None
        except (lost.ObjectStoreFullError, lost.OutOfDiskError) as error:
            raise RacinesError(f"the object store of the cluster is full: {STORE}") from error

    def _nodes(self) -> list[dict[str, float]]:
        return [node["Resources"] for node in self._ray.nodes() if node["Alive"]]

    def _check_store(self, size: int) -> None:
        """Refuse what the object store of a node would not hold."""
        least = min(int(node.get("object_store_memory", 0)) for node in self._nodes())
        if size > least:
            raise RacinesError(
                f"what tasks share takes {size >> 20} MB, and the object store of a node has "
                f"{least >> 20} MB: {STORE}"
            )


STORE = "start Ray with a larger --object-store-memory, or enlarge /dev/shm (docker run --shm-size)"


def _run(call: Call, shared: list[Any], task: bytes) -> tuple[bool, bytes]:
    import ray

    return run_task(call, lambda: ray.get(shared[0]), task)


def _check_address(address: str) -> None:
    """Refuse an address at which nobody listens: Ray itself would wait for minutes."""
    if address in ("local", "auto"):
        return
    if "://" in address:
        raise RacinesError(
            f"--address {address}: give HOST:PORT of the head node, and run the command on the "
            "cluster: ray job submit --working-dir . -- racines …"
        )
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), SECONDS).close()
    except (ValueError, OSError, OverflowError) as error:
        raise RacinesError(f"--address {address}: no Ray answers there: {REACH}") from error


def _not_started(address: str, error: Exception) -> RacinesError:
    """Return in our words why Ray did not start, or did not take us."""
    told = " ".join(str(error).split())[:300]
    if "object store memory" in told:
        return RacinesError(f"--engine ray: too little memory for its object store: {STORE}")
    if "ersion mismatch" in told:
        return RacinesError(
            f"--address {address}: {told}: install the versions of the cluster here, or ours there"
        )
    return RacinesError(
        f"--engine ray: Ray did not start: {told}: see session_latest/logs in Ray's "
        "temporary folder"
    )
