"""Licence, consent and origin of a user's recordings, from the command line to the exports."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.export.registry import load_exporter
from racines_data.manifest import read_manifest
from racines_data.sources.base import NOT_TOLD, SourceCard, manifest_card
from racines_data.sources.cactus import CactusSource
from racines_data.sources.licence import credited, declared_card, left_out
from racines_data.sources.phantom import PhantomSource
from racines_data.sources.release import ReleaseSource
from racines_data.sources.release.layout import RIGHTS
from racines_data.sources.table import TableSource
from racines_data.sources.tracked import TrackedSource
from racines_leaderboard.cli.command import app
from tests.data.sources.table_folder import COUNT, ROBOT, changed, synthetic_folder, write_mapping
from tests.data.sources.test_tracked import write_sequence

ORIGIN = "Lasso et al. {PLUS}, https://plustoolkit.org"


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One sweep imported with a licence and a statement, and without."""
    folder = tmp_path_factory.mktemp("licence")
    sweep = write_sequence(folder / "a.igs.mha")
    said = {"licence": "BSD-3-Clause", "consent": "A phantom: nobody was scanned."}
    said["origin"] = ORIGIN
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
    assert croissant["license"] == "https://spdx.org/licenses/BSD-3-Clause.html"
    assert croissant["sc:usageInfo"] == "BSD-3-Clause, as declared at import."
    assert "nobody was scanned" in croissant["rai:personalSensitiveInformation"][0]
    assert card.attribution == ORIGIN and "declared at import: Lasso et al" in text
    assert croissant["rai:dataCollection"].endswith(f"Origin, as declared at import: {ORIGIN}")
    named = {"name": "Lasso et al. {PLUS}", "url": "https://plustoolkit.org"}
    assert croissant["creator"] == {"@type": "sc:Organization"} | named
    assert (
        "author = {{Lasso et al. (PLUS)}}, url = {https://plustoolkit.org}" in croissant["citeAs"]
    )


def test_what_is_left_out_is_unknown_and_said_so(roots: dict[str, Path]):
    text = (roots["left"] / "README.md").read_text()
    assert "license: unknown" in text and "The licence of these frames is unknown." in text
    assert "No statement on consent was given at import." in text
    assert "who made the recordings is not known here" in text
    assert "The developers of RACINES" not in text
    croissant = (roots["left"] / "croissant.json").read_text()
    assert "RACINES developers" not in croissant
    assert json.loads(croissant)["creator"]["name"] == NOT_TOLD
    assert json.loads(croissant)["license"].startswith("Unknown: no licence was given at import.")
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
    config = replace(config, origin=ORIGIN)
    build(TableSource.from_config({}, [folder]), tmp_path / "made", config)
    load_exporter("lerobot")(tmp_path / "made", tmp_path / "lerobot")
    about = json.loads((tmp_path / "lerobot/meta/racines.json").read_text())
    assert about["license"] == "bsd-3-clause" and "nobody was scanned" in about["personal"]
    assert about["attribution"] == ORIGIN
    card = (tmp_path / "lerobot/README.md").read_text()
    assert "licence bsd-3-clause" in card and "Made by: Lasso et al" in card
    load_exporter("minari")(tmp_path / "made", tmp_path / "minari")
    about = json.loads(next((tmp_path / "minari").glob("racines/*/data/metadata.json")).read_text())
    assert about["author"] == ["Lasso et al. {PLUS}"]
    assert about["racines"]["attribution"] == ORIGIN
    made = load_exporter("release")(roots["left"], tmp_path / "release")
    assert any("Unknown: no licence was given" in note for note in made["notes"])
    assert any(f"made by: {NOT_TOLD}" in note for note in made["notes"])
    lines = (tmp_path / "release" / RIGHTS).read_text().splitlines()
    assert lines[1].startswith("Licence: unknown. Unknown: no licence was given at import.")
    assert lines[2].endswith("No statement on consent was given at import.")
    assert lines[3] == f"Made by: {NOT_TOLD}" and "No origin was given" in lines[4]
    load_exporter("release")(tmp_path / "made", tmp_path / "again")
    text = (tmp_path / "again" / RIGHTS).read_text()
    assert "BSD-3-Clause, as declared at import." in text and f"Made by: {ORIGIN}\n" in text
    assert "Consent, as declared at import: nobody was scanned\n" in text


def test_the_import_warns_and_takes_both(tmp_path: Path):
    sweep, run = write_sequence(tmp_path / "a.igs.mha"), CliRunner()
    words = ["data", "import", str(sweep), "--source=tracked", "--workers=1", "--out"]
    done = run.invoke(app, [*words, str(tmp_path / "a")])
    assert done.exit_code == 0 and "no licence given" in done.stderr
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("racines: no ")]
    assert "--licence" in line and "--consent" in line and "--origin" in line
    said = ["--licence", "ours, ask", "--consent", "written, review 12/3", "--origin", "us"]
    done = run.invoke(app, [*words, str(tmp_path / "b"), *said])
    assert done.exit_code == 0 and "racines: no " not in done.stderr
    card = read_manifest(tmp_path / "b")["card"]
    assert card["license"] == "other" and card["rights"] == "ours, ask, as declared at import."
    assert "written, review 12/3" in card["personal"] and card["attribution"] == "us"
    assert json.loads((tmp_path / "b/croissant.json").read_text())["license"] == "ours, ask"


def test_a_source_that_knows_its_licence_keeps_it():
    phantom = PhantomSource.from_config({"frames": 10, "seed": 0}, [])
    assert declared_card(phantom) is None
    with pytest.raises(RacinesError, match="--licence: source phantom is cc-by-4.0: leave it out"):
        declared_card(phantom, "MIT")
    with pytest.raises(RacinesError, match="--consent: give one line"):
        declared_card(phantom, "", "a\nb")
    with pytest.raises(RacinesError, match="--origin: source cactus says itself whose it is"):
        declared_card(CactusSource, origin="us")
    other = type("Other", (), {"name": "other", "card": SourceCard()})()
    card = declared_card(other, "CC0-1.0")
    assert card is not None and card.license == "cc0-1.0"


def test_what_is_missing_is_asked_for_and_nothing_else():
    assert left_out(TrackedSource) == left_out(TrackedSource, "", "", "")
    assert left_out(TrackedSource, "MIT", "", "us").startswith("no statement that those who were")
    assert "--licence" not in left_out(TrackedSource, "MIT")
    assert left_out(TrackedSource, "MIT", "written", "us") == ""
    assert left_out(CactusSource) == left_out(PhantomSource) == ""
    assert left_out(ReleaseSource).startswith("no origin given")
    card = declared_card(ReleaseSource, origin="us, https://our.org")
    assert card is not None and card.attribution == "us, https://our.org"
    assert (
        card.personal == ReleaseSource.card.personal and card.license == ReleaseSource.card.license
    )


@pytest.mark.parametrize(
    ("told", "name", "url"),
    [
        ("A. Doe, B. Roe, https://x.org/a", "A. Doe, B. Roe", "https://x.org/a"),
        ("A. Doe (https://x.org/a).", "A. Doe", "https://x.org/a"),
        ("https://x.org/a A. Doe", "A. Doe", "https://x.org/a"),
        ("https://x.org/a", "https://x.org/a", "https://x.org/a"),
        ("our laboratory, unpublished", "our laboratory, unpublished", ""),
    ],
)
def test_names_and_address_are_told_apart(told: str, name: str, url: str):
    assert credited(told) == (name, url)


def test_a_simulator_of_somebody_else_is_credited():
    """That frames are simulated does not make them this project's."""

    class Theirs:
        name, of_users, card = "theirs", False, SourceCard(simulated=True)

    assert "--origin" in left_out(Theirs())
    card = declared_card(Theirs(), origin="A. Else, https://example.org/sim")
    assert card is not None and card.attribution == "A. Else, https://example.org/sim"
    assert not left_out(Theirs(), origin="A. Else, https://example.org/sim")
