"""Checks of patients' frames: a sound dataset passes, and each planted error is found."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.manifest import config_manifest, read_manifest
from racines_data.patients import LABELS
from racines_data.store.frames import open_store
from racines_data.validate import identity, leaks, patients
from racines_data.validate.meaning import statistics_of
from racines_data.validate.run import validate
from racines_data.validate.survey import CheckedSweep, Survey, survey
from racines_leaderboard.cli.command import app

Plant = Callable[[CheckedSweep], CheckedSweep]


@pytest.fixture(scope="module")
def found(root: Path) -> dict[str, Survey]:
    manifest = read_manifest(root)
    return {name: survey(root, manifest, name) for name in ("patients", "beating")}


def planted(found: Survey, plant: Plant, place: int = 0) -> Survey:
    sweeps = list(found.sweeps)
    sweeps[place] = plant(sweeps[place])
    return Survey(found.config, sweeps)


def test_a_sound_dataset_passes(root: Path):
    result = validate(root)
    checks = {check.name: check for check in result.checks}
    # The phantom's frames are noise here, which its own checks tell.
    tiers = "patients,", "beating,"
    own = {name: check for name, check in checks.items() if name.startswith(tiers)}
    assert [check.detail for check in own.values() if check.binding and not check.ok] == []
    assert {"splits", "oracle", "leaks", "phases", "masks", "measures", "people", "reference"} <= {
        name.removeprefix("beating, ") for name in own
    }
    assert "3 patients" in checks["patients, splits"].detail


def test_a_patient_in_two_splits_is_found(root: Path, found: dict[str, Survey]):
    manifest = config_manifest(read_manifest(root), "patients")
    leaked = planted(found["patients"], lambda sweep: replace(sweep, split="test"))
    with pytest.raises(RacinesError, match="patient 1 is in train and in test"):
        identity.check_splits(leaked, root, manifest)
    moved = Survey("patients", [replace(s, split="test") for s in found["patients"].sweeps])
    with pytest.raises(RacinesError, match="patient 1 of train is in test"):
        identity.check_splits(moved, root, manifest)


def test_the_leakage_audit_finds_a_patient_in_two_splits(root: Path):
    store = open_store(root, "beating")
    leaks.check_patients(store)
    assert store.patients is not None
    store.patients = [1 if seed == 20_000 else seed for seed in store.patients]
    with pytest.raises(RacinesError, match="patient 1 is in train and in test"):
        leaks.check_patients(store)


def test_phases_outside_are_found(found: dict[str, Survey]):
    one = np.ones((4, 2))
    for config, phases, told in (
        ("beating", one, "a phase lies outside"),
        ("beating", -one, "a phase lies outside"),
        ("beating", one * np.nan, "a phase lies outside"),
        ("patients", one * 0.5, "a still heart with a phase that is not 0"),
        ("beating", one * 0.5, "a heart that should beat stands still"),
    ):
        wrong = planted(found[config], lambda sweep, p=phases: replace(sweep, phases=p))
        with pytest.raises(RacinesError, match=told):
            patients.check_phases(wrong, config)


def test_masks_that_are_no_labels_are_found(found: dict[str, Survey]):
    own = found["patients"]
    with pytest.raises(RacinesError, match="a mask has the number 20; labels end at 19"):
        wrong = planted(own, lambda sweep: replace(sweep, mask_labels=(0, 20)))
        patients.check_masks(wrong, LABELS)
    with pytest.raises(RacinesError, match="lack masks"):
        patients.check_masks(planted(own, lambda s: replace(s, mask_labels=())), LABELS)
    with pytest.raises(RacinesError, match="names no labels"):
        patients.check_masks(own, ())


def test_measures_of_no_heart_are_found(root: Path, found: dict[str, Survey]):
    rows = open_store(root, "patients").measures().to_pylist()
    for change, told in (
        ({"ejection_fraction": 0.0}, "ejection fraction 0"),
        ({"volume_lv": [-1.0] * 11}, "volumes of lv that no heart has"),
        ({"volume_la": [9.0]}, "volumes of la that no heart has"),
        ({"ejection_fraction": 0.5}, "is not that of the volumes"),
        ({"pathology": "unwell"}, "unknown pathology 'unwell'"),
    ):
        wrong = pa.Table.from_pylist([rows[0] | change, *rows[1:]])
        with pytest.raises(RacinesError, match=told):
            patients.check_measures(wrong)
    for wrong in (rows[1:], [rows[0] | {"patient": 7}, *rows[1:]], [*rows, rows[0]]):
        with pytest.raises(RacinesError, match="not of the same patients"):
            patients.check_people(found["patients"], pa.Table.from_pylist(wrong))


def test_numbers_far_from_the_reference_are_found(found: dict[str, Survey]):
    parameters = found["beating"].column("parameters").copy()
    parameters[:, 6] += 0.2
    with pytest.raises(RacinesError, match="position_x: mean off by"):
        patients.check_reference(statistics_of(parameters))
    parameters[:, 8] = np.nan
    with pytest.raises(RacinesError, match="position_z was not measured"):
        patients.check_reference(statistics_of(parameters))


def test_an_export_that_would_lose_columns_is_refused(root: Path, tmp_path: Path):
    words = ["data", "export", str(root), "--format", "lerobot", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [*words, "--config", "beating"])
    assert done.exit_code == 1
    told = str(done.exception) + done.output + getattr(done, "stderr", "")
    assert "format lerobot has no place for patient, cardiac_phase, respiratory_phase, mask" in told
