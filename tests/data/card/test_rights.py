"""Licences in Croissant are addresses or the words given; rights of anatomies stand beside."""

import json
from dataclasses import replace
from pathlib import Path

import mlcroissant
import pytest

from racines_data.card.croissant import write_croissant
from racines_data.card.rights import licence_of
from racines_data.manifest import read_manifest
from racines_data.sources.base import SourceCard, card_with, held_card
from racines_data.sources.licence import HUB, declared_card
from racines_data.sources.phantom import CARD
from racines_data.sources.tracked import TrackedSource

OWN = {"name": "cup", "digest": "ab" * 32, "source": "", "licence": "Apache-2.0", "synthetic": {}}


@pytest.mark.parametrize(
    ("said", "address"),
    [
        ("MIT", "https://spdx.org/licenses/MIT.html"),
        ("bsd-3-clause", "https://spdx.org/licenses/BSD-3-Clause.html"),
        ("Apache-2.0", "https://spdx.org/licenses/Apache-2.0.html"),
        ("gpl-3.0", "https://spdx.org/licenses/GPL-3.0-only.html"),
        ("GPL-3.0-or-later", "https://spdx.org/licenses/GPL-3.0-or-later.html"),
        ("odbl", "https://spdx.org/licenses/ODbL-1.0.html"),
        ("CC-BY-4.0", "https://creativecommons.org/licenses/by/4.0/"),
        ("CC-BY-NC-SA-4.0", "https://creativecommons.org/licenses/by-nc-sa/4.0/"),
        ("CC0-1.0", "https://creativecommons.org/publicdomain/zero/1.0/"),
        ("ours, ask us", "ours, ask us"),
        ("https://example.org/terms", "https://example.org/terms"),
        ("unknown", "unknown, as declared at import."),
    ],
)
def test_what_was_said_at_import_is_an_address_or_itself(said: str, address: str):
    card = declared_card(TrackedSource, said)
    assert card is not None and licence_of(card) == address


def test_every_licence_of_a_hub_has_an_address():
    for name in HUB - {"unknown", "other"}:
        assert licence_of(SourceCard(license=name)).startswith("https://"), name
    assert licence_of(SourceCard()) == SourceCard.rights
    assert licence_of(SourceCard(license="proprietary-7")) == "proprietary-7"


def described(manifest: dict, root: Path, tmp_path: Path) -> tuple[dict, mlcroissant.Metadata]:
    """Return a dataset's Croissant as text has it, and as the library reads it."""
    path = tmp_path / "croissant.json"
    path.write_text(write_croissant(manifest, root))
    metadata = mlcroissant.Dataset(str(path)).metadata
    assert not metadata.ctx.issues.errors
    assert all("datePublished" in warning for warning in metadata.ctx.issues.warnings)
    return json.loads(path.read_text()), metadata


def test_the_rights_of_an_anatomy_stand_beside_the_licence(tiny_root: Path, tmp_path: Path):
    manifest = read_manifest(tiny_root) | {"card": held_card(card_with(CARD, OWN))}
    document, metadata = described(manifest, tiny_root, tmp_path)
    assert metadata.license == ["https://creativecommons.org/licenses/by/4.0/"]
    assert document["sc:usageInfo"] == "CC BY 4.0. The anatomy: Apache-2.0."


def test_configs_of_other_licences_add_theirs(tiny_root: Path, tmp_path: Path):
    manifest = read_manifest(tiny_root) | {"card": held_card(declared_card(TrackedSource, "MIT"))}
    own = held_card(replace(CARD, rights="CC BY 4.0. The anatomy: CC0."))
    manifest["patients"] = {"source": "patients", "card": own, "bounds": None}
    manifest["configs"] = manifest["configs"] | {"patients": manifest["configs"]["frames"]}
    document, metadata = described(manifest, tiny_root, tmp_path)
    assert metadata.license == [
        "https://spdx.org/licenses/MIT.html",
        "https://creativecommons.org/licenses/by/4.0/",
    ]
    assert document["sc:usageInfo"][1] == "CC BY 4.0. The anatomy: CC0."
