"""What all visitors may share: made once by whoever asks first, and the oldest given up."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Kept = TypeVar("Kept")


class Shared(Generic[Kept]):
    """The last few values by key; making one holds up only those who want the same."""

    def __init__(self, capacity: int) -> None:
        """Keep at most `capacity` values, one or more."""
        self._capacity = max(1, capacity)
        self._kept: OrderedDict[Hashable, Kept] = OrderedDict()
        self._gates: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: Hashable, make: Callable[[], Kept]) -> Kept:
        """Return the value of a key, made now if it is not kept; what `make` raises passes on."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            gate = self._gates.setdefault(key, threading.Lock())
        with gate:
            with self._lock:
                if key in self._kept:  # somebody made it while we waited
                    return self._kept[key]
            try:
                value = make()
                self.put(key, value)
            finally:
                with self._lock:
                    self._gates.pop(key, None)
        return value

    def put(self, key: Hashable, value: Kept) -> None:
        """Keep a value in place of the key's last one."""
        with self._lock:
            self._kept[key] = value
            self._kept.move_to_end(key)
            while len(self._kept) > self._capacity:
                self._kept.popitem(last=False)
