"""Checks of patients' frames: a sound dataset passes, and each planted error is found."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from pyarrow import ipc
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.manifest import config_manifest, read_manifest
from racines_data.patients import LABELS, PATIENTS_VERSION
from racines_data.store.frames import open_store
from racines_data.store.sweeps import read_sweeps
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
    assert checks["patients, leaks"].binding and checks["beating, leaks"].binding


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


def test_a_patient_in_two_splits_of_two_configs_is_found(root: Path):
    still, beating = (open_store(root, name) for name in ("patients", "beating"))
    leaks.check_patients(still, beating)
    assert beating.patients is not None
    beating.patients = [1 if seed == 20_000 else 3 for seed in beating.patients]
    with pytest.raises(RacinesError, match="patient 1 is in train and in test of beating: keep"):
        beating._splits["train"] = beating._splits["validation"] = [0, 0]
        leaks.check_patients(still, beating)


def test_a_frame_of_train_in_the_test_of_patients_leaks(root: Path):
    store = open_store(root, "patients")
    assert not any(sweep.leaks for sweep in leaks.find_leaks(store))
    held, train = (store.split_indices(split) for split in ("test", "train"))
    first = held[store.trajectory_index[held] == store.trajectory_index[held[0]]]
    darker = (store.images[train[: len(first)]] * 0.9).round().to(torch.uint8)
    store.images[first] = darker  # in this process's memory, not in the file
    found = [sweep for sweep in leaks.find_leaks(store) if sweep.leaks]
    assert [(sweep.split, sweep.copies) for sweep in found] == [("test", 1.0)]
    with pytest.raises(RacinesError, match="of test leaks: 100% of its 4 frames are copies"):
        leaks.check_leaks(found)


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
        ({"heart_axes": [-x for x in rows[0]["heart_axes"]]}, "heart_axes are no axes"),
        ({"heart_axes": [1.0, 0.0]}, "heart_axes are no axes"),
        ({"pathology": "unwell"}, "unknown pathology 'unwell'"),
    ):
        wrong = pa.Table.from_pylist([rows[0] | change, *rows[1:]])
        with pytest.raises(RacinesError, match=told):
            patients.check_measures(wrong)
    older = pa.Table.from_pylist(rows).drop_columns("heart_axes")
    with pytest.raises(RacinesError, match="no heart_axes: built by an earlier version"):
        patients.check_measures(older)
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


def export(root: Path, out: Path, name: str, config: str = "beating"):
    words = ["data", "export", str(root), "--format", name, "--out", str(out), "--config", config]
    return CliRunner().invoke(app, words)


def test_an_export_that_would_lose_columns_is_refused(root: Path, tmp_path: Path):
    done = export(root, tmp_path / "out", "release")
    told = str(done.exception) + done.output
    assert done.exit_code == 1
    assert "format release has no place for patient, cardiac_phase, respiratory_phase, mask" in told
    done = export(root, tmp_path / "out", "lerobot", "multi_phantom")
    assert done.exit_code == 1 and "formats hold `frames` alone" in str(done.exception)


@pytest.mark.parametrize("config", ["patients", "beating"])
def test_lerobot_has_patients_phases_and_masks(root: Path, tmp_path: Path, config: str):
    out = tmp_path / "out"
    done = export(root, out, "lerobot", config)
    assert done.exit_code == 0, done.output
    table = pa.concat_tables(
        pq.read_table(path) for path in sorted(out.glob("data/*/*.parquet"))
    ).to_pydict()
    manifest = config_manifest(read_manifest(root), config)
    rows = [row for path in read_sweeps(root, config=config) for row in path.table.to_pylist()]
    assert table["patient"] == [row["patient"] for row in rows]
    for name in ("cardiac_phase", "respiratory_phase"):
        assert np.allclose(table[name], [row[name] for row in rows], atol=1e-6)
    for name, column in (("ultrasound", "image"), ("mask", "mask")):
        kept = [each["bytes"] for each in table[f"observation.images.{name}"]]
        assert kept == [row[column]["bytes"] for row in rows]
    info = json.loads((out / "meta/info.json").read_text())
    assert info["features"]["observation.images.mask"]["shape"] == [128, 128, 1]
    assert set(info["features"]) == set(table)
    stats = json.loads((out / "meta/stats.json").read_text())
    assert stats["observation.images.mask"]["max"][0][0][0] <= (len(LABELS) - 1) / 255
    about = json.loads((out / "meta/racines.json").read_text())
    assert about["mask_labels"] == list(LABELS) and about["digest"] == manifest["digest"]


@pytest.mark.parametrize("config", ["patients", "beating"])
def test_minari_has_patients_phases_and_masks(root: Path, tmp_path: Path, config: str):
    done = export(root, tmp_path / "out", "minari", config)
    assert done.exit_code == 0, done.output
    for sweeps in ([*read_sweeps(root, split, config=config)] for split in ("train", "test")):
        split = sweeps[0].split
        data = tmp_path / "out" / "racines" / f"{config}-{split}-v0" / "data"
        for episode, sweep in enumerate(sweeps):
            with ipc.open_file((data / str(episode) / "part-0.arrow").read_bytes()) as file:
                infos = file.get_batch(0).column("infos")
                assert not any(file.get_batch(0).column("terminations").to_pylist())
            for name in ("patient", "cardiac_phase", "respiratory_phase"):
                assert infos.field(name).to_pylist() == sweep.table[name].to_pylist()
            masks = np.array(infos.field("mask").to_pylist(), np.uint8).reshape(-1, 128, 128)
            assert np.array_equal(masks, sweep.masks())
            about = json.loads((data / str(episode) / "metadata.json").read_text())
            assert about["patient"] == sweep.first("patient")
        told = json.loads((data / "metadata.json").read_text())
        assert told["racines"]["version"] == PATIENTS_VERSION
        assert "mask (128 rows of 128: 0 " in told["description"]
        spec = EnvSpec.from_json(told["env_spec"])
        assert spec.id.endswith(f"-{config}-v0") and spec.kwargs["split"] == split
        env = gymnasium.make(spec, patients=1, observation="params")
        env.reset(seed=0)
