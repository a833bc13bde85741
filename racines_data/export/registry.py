"""The registry of exporters: a file with a function each, an entry point `racines.exporters`."""

from pathlib import Path
from typing import Any, Protocol

from racines_data.plugins import Plugins

EXPORTERS = Plugins("format", "racines.exporters", or_give="module:function")


class Exporter(Protocol):
    """Writes a dataset in another format: aside first, then renamed to a path that is new."""

    def __call__(
        self,
        root: Path,
        out: Path,
        split: str | None = None,
        limit: int | None = None,
        progress: bool = False,
    ) -> dict[str, Any]:
        """Export, and return what was written as JSON.

        Args:
            root: Folder of the dataset.
            out: New folder to write; one that exists is refused.
            split: One split only; default all, in the order train, validation, test.
            limit: Frames to write, the first of that order.
            progress: Show a progress bar on stderr.

        Raises:
            RacinesError: `out` exists, or there is no such dataset or split.
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
