"""Memory for the images of batches, used again once nobody holds them any more."""

import sys
import threading

import numpy as np
import torch
from torch import Tensor

from racines_data.records import PIXELS


class BatchMemory:
    """A few arrays that serve in turn.

    The system hands out fresh memory page by page, which takes as long as the copy into it. A
    tensor made from an array holds the array, and so does every view of the tensor, so that the
    array's count of holders tells whether a batch or a part of it is still in use.
    """

    def __init__(self, most: int = 4) -> None:
        """Keep `most` arrays; batches beyond them get memory of their own."""
        self._most = most
        self._arrays: list[np.ndarray] = []
        self._lock = threading.Lock()

    def get(self, rows: int, capacity: int) -> Tensor:
        """Return (rows, 2048) int64 memory with anything in it, out of one for `capacity` rows."""
        with self._lock:
            for place in range(len(self._arrays)):
                idle = _holders(self._arrays, place) == _IDLE
                if idle and len(self._arrays[place]) == capacity:
                    return torch.from_numpy(self._arrays[place][:rows])
            array = np.empty((capacity, PIXELS // 8), np.int64)
            self._arrays = [*self._arrays[-self._most + 1 :], array]
            return torch.from_numpy(array[:rows])


def _holders(arrays: list[np.ndarray], place: int) -> int:
    return sys.getrefcount(arrays[place])


_IDLE = _holders([np.empty(0)], 0)
"""Holders of an array that only its list holds; the number differs between Pythons."""
