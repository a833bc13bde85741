"""All doubts of a mapping, and the refusal that they are."""

from collections.abc import Sequence

import numpy as np

from racines_data.errors import RacinesError
from racines_data.sources.gate.bounds import READING, Bounds
from racines_data.sources.gate.numbers import rotation_faults
from racines_data.sources.table.doubts.base import Doubt
from racines_data.sources.table.doubts.motion import motion_doubts
from racines_data.sources.table.doubts.names import name_doubts
from racines_data.sources.table.doubts.values import value_doubts
from racines_data.sources.table.mapping import Mapping
from racines_data.sources.table.sweeps import Draft


def find_doubts(mapping: Mapping, drafts: Sequence[Draft], bounds: Bounds) -> list[Doubt]:
    """Return what looks wrong, what is certain first, each mistake once."""
    found = [*value_doubts(mapping, drafts, bounds), *name_doubts(mapping)]
    if not any(doubt.certain and doubt.field.startswith("poses.rotation") for doubt in found):
        found += motion_doubts(mapping, [_rigid(draft, mapping) for draft in drafts])
    once = {(doubt.name, doubt.field): doubt for doubt in reversed(found)}
    return sorted(reversed(once.values()), key=lambda doubt: not doubt.certain)


def _rigid(draft: Draft, mapping: Mapping) -> Draft:
    """Return the draft with poses of NaN where they are not rigid."""
    faults = rotation_faults(draft.poses, mapping.poses.tolerance)
    wrong = np.array([fault is not None for fault in faults], bool)
    poses = draft.poses.copy()
    poses[wrong] = np.nan
    return Draft(**{**vars(draft), "poses": poses})


def refuse_doubts(doubts: Sequence[Doubt], allow: Sequence[str], where: str) -> None:
    """Refuse a mapping that looks wrong, but for inferences that are allowed.

    Raises:
        RacinesError: the first doubt, and how many more there are.
    """
    held = [doubt for doubt in doubts if doubt.certain or READING not in allow]
    if held:
        names = ", ".join(doubt.name for doubt in held[1:])
        more = f" (also: {names}; racines data inspect shows all)" if names else ""
        raise RacinesError(f"{where}: {held[0]}{more}")
