"""Licence and consent of a user's recordings, from the command line to card and exports."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.export.registry import load_exporter
from racines_data.manifest import read_manifest
from racines_data.sources.base import SourceCard, manifest_card
from racines_data.sources.licence import declared_card
from racines_data.sources.phantom import PhantomSource
from racines_data.sources.table import TableSource
from racines_data.sources.tracked import TrackedSource
from racines_leaderboard.cli.command import app
from tests.data.sources.table_folder import COUNT, ROBOT, changed, synthetic_folder, write_mapping
from tests.data.sources.test_tracked import write_sequence


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One sweep imported with a licence and a statement, and without."""
    folder = tmp_path_factory.mktemp("licence")
    sweep = write_sequence(folder / "a.igs.mha")
    said = {"licence": "BSD-3-Clause", "consent": "A phantom: nobody was scanned."}
    for name, words in (("said", said), ("left", {})):
        made = TrackedSource.from_config({}, [sweep])
        build(made, folder / name, DataConfig(source="tracked", workers=1, **words))
    return {name: folder / name for name in ("said", "left")}


def test_what_is_said_stands_on_the_card_and_in_croissant(roots: dict[str, Path]):
    manifest = read_manifest(roots["said"])
    card = manifest_card(manifest)
    assert card.license == "bsd-3-clause" and card.rights == "BSD-3-Clause, as declared at import."
    assert card.personal.endswith("Consent, as declared at import: A phantom: nobody was scanned.")
    text = (roots["said"] / "README.md").read_text()
    assert "license: bsd-3-clause" in text and "as declared at import" in text
    croissant = json.loads((roots["said"] / "croissant.json").read_text())
    assert croissant["license"] == "bsd-3-clause"
    assert "nobody was scanned" in croissant["rai:personalSensitiveInformation"][0]


def test_what_is_left_out_is_unknown_and_said_so(roots: dict[str, Path]):
    text = (roots["left"] / "README.md").read_text()
    assert "license: unknown" in text and "The licence of these frames is unknown." in text
    assert "No statement on consent was given at import." in text
    same = [
        read_manifest(root)[key] for root in roots.values() for key in ("digest", "recipe_digest")
    ]
    assert len(set(same)) == 2, "neither content nor recipe depends on what is said"


def test_exports_carry_it(roots: dict[str, Path], tmp_path: Path):
    controls = dict(zip([f"u{i}" for i in range(6)], np.zeros((6, COUNT)), strict=True))
    folder = synthetic_folder(tmp_path / "mine", **controls)
    write_mapping(folder, changed(ROBOT, controls__columns=[*controls]))
    config = DataConfig(
        source="table", workers=1, licence="BSD-3-Clause", consent="nobody was scanned"
    )
    build(TableSource.from_config({}, [folder]), tmp_path / "made", config)
    load_exporter("lerobot")(tmp_path / "made", tmp_path / "lerobot")
    about = json.loads((tmp_path / "lerobot/meta/racines.json").read_text())
    assert about["license"] == "bsd-3-clause" and "nobody was scanned" in about["personal"]
    assert "licence bsd-3-clause" in (tmp_path / "lerobot/README.md").read_text()
    made = load_exporter("release")(roots["left"], tmp_path / "release")
    assert any("Unknown: no licence was given" in note for note in made["notes"])


def test_the_import_warns_and_takes_both(tmp_path: Path):
    sweep, run = write_sequence(tmp_path / "a.igs.mha"), CliRunner()
    words = ["data", "import", str(sweep), "--source=tracked", "--workers=1", "--out"]
    done = run.invoke(app, [*words, str(tmp_path / "a")])
    assert done.exit_code == 0 and "no licence given" in done.stderr
    said = ["--licence", "ours, ask", "--consent", "written, review 12/3"]
    done = run.invoke(app, [*words, str(tmp_path / "b"), *said])
    assert done.exit_code == 0 and "no licence given" not in done.stderr
    card = read_manifest(tmp_path / "b")["card"]
    assert card["license"] == "other" and card["rights"] == "ours, ask, as declared at import."
    assert "written, review 12/3" in card["personal"]


def test_a_source_that_knows_its_licence_keeps_it():
    phantom = PhantomSource.from_config({"frames": 10, "seed": 0}, [])
    assert declared_card(phantom) is None
    with pytest.raises(RacinesError, match="--licence: source phantom is cc-by-4.0: leave it out"):
        declared_card(phantom, "MIT")
    with pytest.raises(RacinesError, match="--consent: give one line"):
        declared_card(phantom, "", "a\nb")
    other = type("Other", (), {"name": "other", "card": SourceCard()})()
    card = declared_card(other, "CC0-1.0")
    assert card is not None and card.license == "cc0-1.0"
