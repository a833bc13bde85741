"""One task in a worker of a cluster: checked, in the caller's folder, with the caller's threads.

Nothing here imports Ray: a worker that has another version of ours refuses before it runs a task.
"""

import os
import pickle
import platform
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from racines_data.engines.threads import torch_threads
from racines_data.engines.versions import described, versions
from racines_data.errors import RacinesError

_held: dict[str, Any] = {}  # the state of the last map, unpickled once


@dataclass(frozen=True)
class Call:
    """What all tasks of one `map` have in common."""

    name: str
    """Tells the states of several maps apart."""
    threads: int
    folder: str
    """The caller's working folder."""
    versions: dict[str, str]


def run_task(call: Call, fetch: Callable[[], bytes], task: bytes) -> tuple[bool, bytes]:
    """Return whether a task was done, and its pickled result, or why it was refused.

    Args:
        call: See `Call`.
        fetch: Returns the pickled (work, state) of the map; called where they are not here yet.
        task: Pickled. Pickles give arrays that may be written to, as a local pool does.
    """
    try:
        _check(call.versions)
        if os.path.isdir(call.folder):  # relative paths mean here what they mean there
            os.chdir(call.folder)
        if call.name not in _held:
            _held.clear()
            _held[call.name] = pickle.loads(fetch())
        work, state = _held[call.name]
        with torch_threads(call.threads):
            return True, pickle.dumps(work(state, pickle.loads(task)), pickle.HIGHEST_PROTOCOL)
    except (RacinesError, OSError) as error:
        return False, pickle.dumps(error)


def _check(wanted: dict[str, str]) -> None:
    here = versions()
    if here != wanted:
        differing = {key: value for key, value in here.items() if wanted.get(key) != value}
        theirs = {key: wanted[key] for key in differing}
        raise RacinesError(
            f"a worker on {platform.node()} has {described(differing)}; the machine that sent "
            f"the task has {described(theirs)}: install the same on every node (pip install "
            f"racines=={wanted['racines']} torch=={wanted['torch']}), or start the nodes from one "
            "image"
        )
