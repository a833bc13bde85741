"""The registry of exporters: a file with a function each, an entry point `racines.exporters`."""

import inspect
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from racines_data.errors import RacinesError
from racines_data.manifest import ADDED
from racines_data.plugins import Plugins
from racines_data.schema import PHASES

EXPORTERS = Plugins("format", "racines.exporters", or_give="module:function")


class Exporter(Protocol):
    """Writes a dataset in another format: aside first, then renamed to a path that is new.

    One that can write the configs of patients takes `config`, by name, besides.
    """

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


def for_config(exporter: Exporter, config: str, name: str) -> Exporter:
    """Return an exporter of one config: `frames`, or patients where it takes `config`.

    Raises:
        RacinesError: another config, with the columns that would be lost.
    """
    if config == "frames":
        return exporter
    if config not in ADDED:
        raise RacinesError(f"--config {config}: formats hold `frames` alone; leave --config out")
    if "config" not in inspect.signature(exporter).parameters:
        lost = ", ".join(("patient", *PHASES, "mask"))
        raise RacinesError(
            f"--config {config}: format {name} has no place for {lost}: use --format lerobot, or "
            f"read the Parquet files of data/{config} by racines_data.load(config={config!r})"
        )
    for_any: Any = exporter
    return partial(for_any, config=config)


def exporter_names() -> tuple[str, ...]:
    """Return the names of the formats, sorted."""
    return EXPORTERS.names()


def load_exporter(name: str) -> Exporter:
    """Return the exporter of a format.

    Raises:
        RacinesError: no such format, or a package that it needs is not installed.
    """
    return EXPORTERS.load(name)
