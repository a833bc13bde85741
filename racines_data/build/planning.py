"""What is asked of a source before its units are made, and of the units once they are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from racines_data.errors import RacinesError
from racines_data.records import float_columns
from racines_data.schema import PARAMETERS
from racines_data.sources.base import Finding, Source, Unit, has_poses
from racines_data.sources.gate.check import check_scales, scale_of

if TYPE_CHECKING:
    from racines_data.build.writer import Part

FORMAT = 3
"""Version of the layout of units, shards and store; part of every recipe."""


@dataclass(frozen=True)
class DataConfig:
    """How a dataset is built. Settings of a source stand in a section of its name beside these."""

    source: str = "phantom"
    """Name of the source."""
    frames: int = 6000
    """Frames to acquire, where the source can choose."""
    seed: int = 0
    """Seed of the acquisition and of the splits."""
    workers: int = 2
    """Worker processes; the result does not depend on it."""
    shards: int = 16
    """Parquet shards of `frames`, at least (never more than there are frames)."""
    validation: float = 0.15
    """Share of trajectories for validation."""
    test: float = 0.15
    """Share of trajectories for test."""
    strict: bool = False
    """Stop at the first input that is refused."""
    max_refused: float = 0.2
    """Largest share of frames that may be refused."""
    allow: tuple[str, ...] = ()
    """Opinions of the gate that are not held against this data, by name (docs/import.md)."""
    licence: str = ""
    """Licence of recordings, as their user states it at import; empty where none was said."""
    consent: str = ""
    """Statement on consent and review, likewise."""
    origin: str = ""
    """Who made the recordings and where they are published, likewise."""
    also: tuple[str, ...] = ()
    """Sources that add a config each once the dataset stands, in order: `patients`, `beating`."""


def plan_units(source: Source, config: DataConfig) -> list[Unit]:
    """Return the units of a source; refuse none, an id twice, and too much that was refused."""
    units = list(source.plan())
    _check_report(source.report, units, config)
    if not units:
        raise RacinesError(f"source {source.name}: no trajectory to build from")
    ids = [unit.id for unit in units]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise RacinesError(f"source {source.name}: trajectory {twice!r} occurs twice")
    return units


def own_splits(units: Sequence[Unit]) -> dict[str, str]:
    """Return the split of each trajectory id that units name themselves; empty if they do not."""
    own = {unit.id: getattr(unit, "split", "") for unit in units}
    return own if all(own.values()) else {}


def check_part(part: "Part", allow: Sequence[str]) -> None:
    """Hold the staged trajectories of a source against one another."""
    if has_poses(part.source):
        scales = [
            scale_of(
                row["trajectory"],
                float_columns(table, PARAMETERS[:6]),
                float_columns(table, PARAMETERS[6:9]),
                table["timestamp"].to_numpy(),
            )
            for row, table in zip(part.rows, part.tables(), strict=True)
        ]
        check_scales(scales, part.source.name, allow)


def _check_report(report: Sequence[Finding], units: Sequence[Unit], config: DataConfig) -> None:
    refused = [finding for finding in report if finding.refused]
    if not refused:
        return
    first = f"{refused[0].file} {refused[0].item}: {refused[0].reason}"
    if config.strict:
        raise RacinesError(f"refused (--strict): {first}")
    lost = sum(finding.frames for finding in refused)
    total = lost + sum(unit.frames for unit in units)
    if lost > config.max_refused * total:
        raise RacinesError(
            f"{lost} of {total} frames refused, more than max_refused {config.max_refused}; "
            f"first: {first}"
        )
