"""The halves of the real patients: kept to their rule, and what a study of one half reads."""

import json
import os
from pathlib import Path

import polars as pl
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.studies.realism.patients import (
    FILE,
    LISTS,
    UNLISTED,
    halve,
    list_of,
    patient_lists,
    patients_of,
)
from racines_models.studies.realism.report import one_each, read_real
from tests.models.studies.test_realism import compared, phantom_like, png, speckle

__all__ = ["phantom_like"]
SHARED = Path(os.environ.get("RACINES_REAL", Path(__file__).parents[4] / "shared" / "real"))


def test_the_lists_are_what_their_rule_gives_and_share_nobody():
    lists = patient_lists()
    assert [len(lists[name]) for name in LISTS] == [125, 125]
    assert len(set(lists["tuning"]) | set(lists["reporting"])) == 250
    assert halve((*lists["reporting"], *lists["tuning"])) == lists
    assert "SHA-256" in json.loads(FILE.read_text())["rule"]


def test_they_are_the_patients_of_the_real_frames():
    path = SHARED / "camus_a4c_reference.parquet"
    if not path.is_file():
        pytest.skip(f"NO REAL FRAMES: {path} is absent; the lists are held to their rule alone")
    assert halve(pl.read_parquet(path)["patient"]) == patient_lists()


def test_a_patient_is_in_one_list_or_in_none():
    assert list_of(patient_lists()["tuning"][3]) == "tuning"
    assert list_of("patient9999") == UNLISTED
    with pytest.raises(RacinesError, match="'test': no such list; choose tuning or reporting"):
        patients_of("test")


@pytest.fixture
def listed(tmp_path):
    """20 patients of each list, two frames each."""
    names = [each for name in LISTS for each in patient_lists()[name][:20] for _ in range(2)]
    images = [png(each) for each in speckle(len(names), 50, seed=3).numpy()]
    path = tmp_path / "real.parquet"
    pl.DataFrame({"patient": names, "image": images}).write_parquet(path)
    return path


def test_realism_of_one_list_reads_its_patients_alone(listed, phantom_like):
    both, half = read_real(listed), read_real(listed, "reporting")
    assert (len(both.images), len(half.images)) == (80, 40) and half.sha256 == both.sha256
    assert (half.images == both.images[40:]).all() and one_each(half, 5).chosen == "reporting"
    told = compared(half, phantom_like).content["real"]
    assert told["list"] == "reporting" and told["patients"] == 20
    assert "list" not in compared(both, phantom_like).content["real"]


def test_a_file_of_other_patients_and_an_unknown_list_are_refused(tmp_path):
    path = tmp_path / "real.parquet"
    frame = png(speckle(1, 50, seed=1).numpy()[0])
    pl.DataFrame({"patient": ["somebody"], "image": [frame]}).write_parquet(path)
    with pytest.raises(RacinesError, match="column patient has nobody of list tuning"):
        read_real(path, "tuning")
    words = ["study", "realism", "--real", str(path), "--patients", "half"]
    with pytest.raises(RacinesError, match="no such list"):
        CliRunner().invoke(app, words, catch_exceptions=False)
