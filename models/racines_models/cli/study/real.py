"""What the studies that need real frames share. Heavy imports stand inside."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from racines_data.cli.settings import given, read_settings

if TYPE_CHECKING:
    from racines_models.studies.realism.report import RealismConfig

Real = Annotated[Path | None, typer.Option(help="Parquet of real frames. Default: realism.real.")]


def realism_settings(
    real: Path | None, frames: int | None, params: Path | None, profile: str | None
) -> "tuple[RealismConfig, Path | None]":
    """Return the section `realism`, and the file of real frames where one is named."""
    from racines_data.config import fill, section
    from racines_models.studies.realism.report import RealismConfig

    settings = section(read_settings(params, profile), "realism") | given(frames=frames)
    config = fill(RealismConfig, settings, "realism")
    return config, real or (Path(config.real) if config.real else None)


def no_real(path: Path | None) -> str:
    """Return what is said where there are no real frames."""
    told = f"{path}: no such file" if path else "no real frames named"
    return f"{told}; give --real PATH.parquet (docs/scores.md): THE PHANTOM IS NOT COMPARED"
