"""The licence of a dataset as Croissant has it: an address where the licence is a known one.

A hub names licences by lower-case identifiers of its own (`mit`, `bsd-3-clause`), which other tools
do not know. Where no identifier stands, Croissant has the words that were given at import.
"""

import re
from collections.abc import Mapping
from typing import Any

from racines_data.manifest import added_configs, config_manifest
from racines_data.sources.base import SourceCard, manifest_card
from racines_data.sources.licence import UNKNOWN

_SPDX = {
    name.lower(): name
    for name in (
        *("Apache-2.0", "MIT", "BSD-2-Clause", "BSD-3-Clause", "GPL-3.0-only", "GPL-3.0-or-later"),
        *("ODC-By-1.0", "ODbL-1.0", "PDDL-1.0"),
    )
} | {"gpl-3.0": "GPL-3.0-only", "odc-by": "ODC-By-1.0", "odbl": "ODbL-1.0", "pddl": "PDDL-1.0"}
"""SPDX identifiers of what a hub, or a user, calls a licence, beside those of Creative Commons."""
_COMMONS = re.compile(r"cc-(by(?:-nc)?(?:-sa|-nd)?)-(\d\.\d)")
_DECLARED = ", as declared at import."
"""What follows the words given at import; see `sources.licence`."""


def rights_fields(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return Croissant's `license` and `usageInfo`: of all configs, each licence and text once."""
    configs = ("frames", *added_configs(manifest))
    cards = [manifest_card(config_manifest(manifest, config)) for config in configs]
    licences = list(dict.fromkeys(licence_of(card) for card in cards))
    rights = list(dict.fromkeys(card.rights for card in cards))
    return {"license": _one(licences), "sc:usageInfo": _one(rights)}


def licence_of(card: SourceCard) -> str:
    """Return the licence of a card: an address, the words given, or what is said of the rights."""
    words = card.rights.removesuffix(_DECLARED)
    name = words if card.license == "other" else card.license
    lower = name.lower()
    if lower == "cc0-1.0":
        return "https://creativecommons.org/publicdomain/zero/1.0/"
    if commons := _COMMONS.fullmatch(lower):
        return f"https://creativecommons.org/licenses/{commons[1]}/{commons[2]}/"
    if lower in _SPDX:
        return f"https://spdx.org/licenses/{_SPDX[lower]}.html"
    return card.rights if name == UNKNOWN else name


def _one(texts: list[str]) -> str | list[str]:
    return texts[0] if len(texts) == 1 else texts
