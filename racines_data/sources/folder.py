"""What sources share that read one folder of files: opening it, and the recipe."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.sources.base import Finding, Unit


@dataclass
class FolderSource:
    """The part of a source's protocol that is the same for every folder."""

    config: Any
    root: Path
    report: list[Finding] = field(default_factory=list)
    progress: bool = False
    """Show a progress bar on stderr while the files are checked."""
    name = ""
    Config: ClassVar[type]
    reader: ClassVar[int] = 1
    """Version of what the reader makes of the files; part of the recipe."""

    def __post_init__(self) -> None:
        """Remember nothing yet."""
        self._inputs = ""  # the sha256 over all files, which `plan` finds

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path]) -> Self:
        """Make the source; the one input is the folder.

        Raises:
            RacinesError: no input or several, no such folder, or a wrong setting.
        """
        settings = fill(cls.Config, config, f"data.{cls.name}")
        cls.check_settings(settings)
        if len(inputs) != 1:
            raise RacinesError(f"source {cls.name}: name one folder: --input FOLDER")
        if not inputs[0].is_dir():
            raise RacinesError(f"{inputs[0]}: no such folder")
        return cls(settings, inputs[0].resolve())

    @classmethod
    def check_settings(cls, settings: Any) -> None:
        """Refuse settings whose values do not fit, by `RacinesError`."""

    def recipe(self) -> dict[str, Any]:
        """Return the reader's version, the settings, and the sha256 over all files."""
        if not self._inputs:
            self.plan()
        config = dataclasses.asdict(self.config)
        return {"reader": self.reader, "config": config, "inputs": self._inputs}

    def plan(self) -> Sequence[Unit]:
        """Check every file, set the hash over all, and return the units; see `Source`."""
        raise NotImplementedError
