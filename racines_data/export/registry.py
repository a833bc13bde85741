"""Other people's formats: the registry of exporters.

An exporter is one file with one function, and one line in `_EXPORTERS`:

    export(root, out, split=None, limit=None, progress=False) -> dict[str, Any]

It writes the dataset at `root` (one split, or all; at most `limit` frames, whole dataset order) to
the new path `out`, aside first and then renamed, and returns what it wrote as JSON. It refuses an
`out` that exists.
"""

from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from racines_data.errors import RacinesError

_EXPORTERS = {
    "release": "racines_data.export.release",
    "lerobot": "racines_data.export.lerobot.writer",
    "minari": "racines_data.export.minari",
}


class Exporter(Protocol):
    """Writes a dataset in another format."""

    def __call__(
        self,
        root: Path,
        out: Path,
        split: str | None = None,
        limit: int | None = None,
        progress: bool = False,
    ) -> dict[str, Any]:
        """Export; see the module."""
        ...


def exporter_names() -> tuple[str, ...]:
    """Return the names of the formats."""
    return tuple(_EXPORTERS)


def load_exporter(name: str) -> Exporter:
    """Return the exporter of a format.

    Raises:
        RacinesError: no such format, or a package that it needs is not installed.
    """
    if name not in _EXPORTERS:
        raise RacinesError(f"unknown format {name!r}: choose one of {', '.join(_EXPORTERS)}")
    try:
        return import_module(_EXPORTERS[name]).export
    except ModuleNotFoundError as error:
        raise RacinesError(
            f"format {name!r} needs the package {error.name}: pip install {error.name}"
        ) from error
