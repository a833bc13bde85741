"""What a source says of its data, also where the source is not installed."""

import dataclasses
import json

from racines_data.card.datasheet import rai_fields
from racines_data.card.markdown import write_card
from racines_data.manifest import read_manifest
from racines_data.sources.base import SOURCES, SourceCard, manifest_card, own_card

THEIRS = SourceCard(
    origin="somebody's recordings",
    license="mit",
    rights="As you like.",
    tags=("lung",),
    limits="Do not use on Mondays.",
    biases="One lung.",
)


def test_ours_say_all_there_is_to_say():
    neutral = SourceCard()
    for name in ("phantom", "release", "cactus", "tracked"):
        card = SOURCES.load(name).card
        for field in ("origin", "rights", "collection", "annotation", "biases", "limits"):
            assert getattr(card, field) != getattr(neutral, field), (name, field)
        assert manifest_card({"source": name}) == card
        assert own_card(SOURCES.load(name)) is None


def test_a_dataset_holds_the_card_of_a_source_that_need_not_be_installed(tiny_root):
    held = json.loads(json.dumps(dataclasses.asdict(THEIRS))) | {"of_a_later_version": 1}
    manifest = read_manifest(tiny_root) | {"source": "theirs", "card": held}
    assert manifest_card(manifest) == THEIRS
    text = write_card(manifest)
    for part in ("— somebody's recordings.**", "license: mit", "- lung", "As you like.", "Mondays"):
        assert part in text
    assert rai_fields(manifest)["rai:dataBiases"] == ["One lung."]


def test_without_a_card_the_text_is_neutral(tiny_root):
    manifest = read_manifest(tiny_root) | {"source": "theirs"}
    assert manifest_card(manifest) == SourceCard()
    assert "— a source of another package.**" in write_card(manifest)
