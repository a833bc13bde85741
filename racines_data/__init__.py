"""The RACINES dataset: sources, the simulated phantom, building, loading, checking."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from racines_data.errors import RacinesError
from racines_data.load import load

if TYPE_CHECKING:
    from racines_data.build import DataConfig
    from racines_data.store import Batch, FrameStore, open_store

__all__ = [
    "Batch",
    "DataConfig",
    "FrameStore",
    "RacinesError",
    "load",
    "open_store",
]
_LAZY = {"Batch": "store", "FrameStore": "store", "open_store": "store", "DataConfig": "build"}


def __getattr__(name: str) -> Any:
    # torch and datasets take seconds to import: only what is used is imported.
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
