"""Other people's formats: the registry of exporters.

An exporter is one file with one function, and one entry point of the group `racines.exporters`:

    export(root, out, split=None, limit=None, progress=False) -> dict[str, Any]

It writes the dataset at `root` (one split, or all; at most `limit` frames, whole dataset order) to
the new path `out`, aside first and then renamed, and returns what it wrote as JSON. It refuses an
`out` that exists.
"""

from pathlib import Path
from typing import Any, Protocol

from racines_data.plugins import Plugins

EXPORTERS = Plugins("format", "racines.exporters", or_give="module:function")


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
        """Export.

        Args:
            root: Folder of the dataset.
            out: New folder to write.
            split: One split only; default all, in the order train, validation, test.
            limit: Frames to write, the first of that order.
            progress: Show a progress bar on stderr.
        """
        ...


def exporter_names() -> tuple[str, ...]:
    """Return the names of the formats, sorted."""
    return EXPORTERS.names()


def load_exporter(name: str) -> Exporter:
    """Return the exporter of a format.

    Raises:
        RacinesError: no such format, or a package that it needs is not installed.
    """
    return EXPORTERS.load(name)
