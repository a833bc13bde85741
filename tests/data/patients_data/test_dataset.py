"""Patients as configs of a dataset: what is loaded, and that nothing else has changed."""

import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import datasets
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

import racines_data
from racines_data.build.dataset import DataConfig, build, make_also, read_data_section
from racines_data.digest import check_files
from racines_data.errors import RacinesError
from racines_data.files import locked_place
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.manifest import read_manifest
from racines_data.patients import LABELS, Pool, draw_patient, split_of
from racines_data.schema import PHASES, frame_features
from racines_data.sources.patients import BeatingSource, PatientsSource
from racines_data.store.frames import open_store
from racines_data.store.hearts import hearts_of, to_heart
from racines_data.store.sweeps import restore_stores
from racines_data.validate.identity import same_version
from racines_data.views import VIEWS
from racines_leaderboard.cli.command import app
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from racines_models.judges.grader.report import examine
from racines_models.judges.segmentation.frames import MaskSet
from tests.conftest import command
from tests.data.fake_source import FakeConfig, FakeSource
from tests.data.patients_data.conftest import ONE, SEEDS, SETTINGS
from tests.waiting import until

TIERS = ("patients", "beating")


@pytest.mark.parametrize("config", TIERS)
def test_splits_are_by_patient(root: Path, config: str):
    loaded = datasets.load_dataset(str(root), config)
    assert {name: set(rows["patient"]) for name, rows in loaded.items()} == {
        name: {seed} for name, seed in SEEDS.items()
    }
    assert all(split_of(seed) == name for name, seed in SEEDS.items())
    checked = racines_data.load(config=config, root=root)
    assert {name: len(rows) for name, rows in checked.items()} == dict.fromkeys(SEEDS, 24)


def test_columns(root: Path):
    row = racines_data.load(config="beating", split="test", root=root)[9]
    old = frame_features()
    assert list(row)[: len(old)] == list(old)
    assert list(row)[len(old) :] == ["patient", *PHASES, "mask"]
    assert row["mask"].mode == "L" and row["mask"].size == row["image"].size == (128, 128)
    assert np.asarray(row["mask"]).max() < len(LABELS)
    assert 0 <= row["cardiac_phase"] < 1 and 0 < row["respiratory_phase"] < 1
    assert row["phantom"] is None and row["session"] == "patient-20000"
    still = racines_data.load(config="patients", root=root)["train"]
    assert set(still["cardiac_phase"]) == set(still["respiratory_phase"]) == {0.0}
    assert still.features["source"].int2str(still[0]["source"]) == "patients"
    assert "source patients (simulated" in still.info.description


def test_the_other_configs_stay_bit_for_bit(root: Path, built: Path):
    manifest, plain = read_manifest(root), read_manifest(built)
    for key in ("source", "version", "digest", "recipe_digest", "counts", "canonical"):
        assert manifest[key] == plain[key]
    assert [*manifest["configs"]] == [*plain["configs"], *TIERS]
    assert open_store(root).manifest["digest"] == plain["digest"]
    assert racines_data.load(root=root)["train"].features == frame_features()
    own = {manifest[name]["digest"] for name in TIERS}
    assert len(own) == 2 and manifest["digest"] not in own
    assert open_store(root, "beating").manifest["source"] == "beating"


def test_another_build_has_the_same_digests(root: Path, tmp_path: Path, warm_workers: None):
    """Other workers, another order, other patients beside: the same bytes of a patient."""
    other = tmp_path / "racines"
    build(FakeSource(FakeConfig()), other, ONE)
    build(PatientsSource.from_config(SETTINGS), other, DataConfig(workers=2, shards=2))
    build(BeatingSource.from_config(SETTINGS), other, ONE)
    assert read_manifest(other) == read_manifest(root)
    assert same_version(root, other) == "equal, byte for byte"


@pytest.mark.parametrize("kind", [PatientsSource, BeatingSource])
def test_a_sweep_depends_on_its_patient_alone(
    root: Path, kind: type[PatientsSource], monkeypatch: pytest.MonkeyPatch
):
    source = kind.from_config({"validation": 1, "frames_per_sweep": 4})
    unit = source.plan()[3]
    monkeypatch.setattr("racines_data.sources.patients._pool", lambda *_: Among(kind.beating))
    made, store = source.produce(unit), open_store(root, kind.adds)
    assert store.patients is not None and store.phases is not None and store.masks is not None
    index = store.trajectories.index(unit.id)
    rows = (store.trajectory_index == index).nonzero()[:, 0]
    assert store.patients[index] == 10_000
    for name in ("images", "masks", "phases", "parameters", "views", "grades", "timestamps"):
        assert np.array_equal(getattr(store, name)[rows].numpy(), getattr(made, name)), name


class Among:
    """The patient 10,000 in a pool of others, each frame a batch of its own, the last first."""

    def __init__(self, beating: bool):
        self._pool = Pool([20_000, 10_000], beating=beating)
        self.workspace = self._pool.workspace
        self.wrench = self._pool.wrench

    def targets(self, rows, phase=None):
        return self._pool.targets(rows + 1, phase)

    def phase(self, rows, time):
        return self._pool.phase(rows + 1, time)

    def judge(self, pose, rows, phase):
        return self._pool.judge(pose, rows + 1, phase)

    def mask(self, pose, rows, phase):
        return self._one_by_one(self._pool.mask, pose, rows, phase)

    def render(self, pose, rows, phase, seeds):
        return self._one_by_one(self._pool.render, pose, rows, phase, seeds)

    def _one_by_one(self, draw, pose, rows, *more):
        parts = []
        for i in range(len(rows) - 1, -1, -1):
            one = Pose(*(part[i : i + 1] for part in pose))
            parts.append(draw(one, rows[i : i + 1] + 1, *(each[i : i + 1] for each in more)))
        return torch.cat(parts[::-1])


def test_a_store_is_made_again_from_the_shards(root: Path, tmp_path: Path):
    copy = tmp_path / "racines"
    shutil.copytree(root, copy)
    (copy / "store" / "beating.arrow").unlink()
    assert restore_stores(copy) == ["store/beating.arrow"]
    assert read_manifest(copy) == read_manifest(root)


def test_measures_are_the_pools(root: Path):
    pool = Pool([10_000])
    true, who = pool.measures(0), pool.patients[0]
    table = open_store(root, "patients").measures()
    row = next(each for each in table.to_pylist() if each["patient"] == 10_000)
    assert (row["split"], row["pathology"]) == ("validation", who.pathology)
    assert row["ejection_fraction"] == true.ejection_fraction
    assert row["phases"] == list(true.phases)
    assert all(row[f"volume_{part}"] == list(each) for part, each in true.volumes.items())
    assert (row["lv_length_diastole"], row["lv_length_systole"]) == true.lv_length
    assert (row["female"], row["height"]) == (who.body.female, who.body.height)
    assert set(row["shown"]) <= set(VIEWS)
    placement = pool.hearts[0].placement
    assert row["heart_axes"] == placement.axes.flatten().tolist()
    assert row["heart_origin"] == placement.origin.tolist()
    with pytest.raises(RacinesError, match="config frames has no patients"):
        open_store(root).measures()


def test_poses_about_hearts_tell_frames_of_a_view_from_the_rest(root: Path):
    """Frames of one view are alike about the hearts, not on the chests, of two patients."""
    store = open_store(root, "beating")
    rows = torch.nonzero(store.views == VIEWS.index("A4C"))[:, 0]
    assert len(set(store.units(rows).tolist())) > 1
    pose = parameters_to_pose(store.parameters[rows].double())
    about = to_heart(pose, hearts_of(store, rows), store.phases[rows, 1])
    assert float(about.position.std(0).norm()) < 0.7 * float(pose.position.std(0).norm())


def test_the_segmentation_judge_gets_its_masks(root: Path):
    frames = MaskSet.of(open_store(root, "beating"))
    assert frames.labels == LABELS and set(frames.patients.tolist()) == set(SEEDS.values())
    assert frames.card["source"] == "beating" and set(frames.strata) == {"view", "pathology"}
    assert len(np.unique(frames.masks.numpy())) > 10


def test_a_grader_is_judged_by_patient_and_pathology(root: Path):
    store = open_store(root, "beating")
    grader = Grader(GraderNetwork(32), GraderConfig(input_size=32, bf16=False))
    told = examine(grader, store).content
    rows = store.split_indices("test")
    assert set(store.units(rows).tolist()) == {SEEDS["test"]}
    assert store.pathologies(rows).tolist() == [draw_patient(20_000).pathology] * len(rows)
    assert told["metrics"]["view_accuracy"]["settings"]["units"] == 1, "five sweeps, one patient"
    by_label = [each["value"] for each in told["views"].values()]
    assert told["metrics"]["balanced_accuracy"]["value"] == pytest.approx(np.mean(by_label))
    ((name, figures),) = told["pathologies"].items()
    assert name == draw_patient(20_000).pathology
    assert figures["view_accuracy"]["value"] == told["metrics"]["view_accuracy"]["value"]
    with pytest.raises(RacinesError, match="has no patients"):
        open_store(root).pathologies(rows)


def test_masks_can_be_left_out(root: Path, tmp_path: Path):
    copy = tmp_path / "racines"
    shutil.copytree(root, copy)
    settings = {"train": 1, "frames_per_sweep": 2, "masks": False}
    build(PatientsSource.from_config(settings), copy, ONE)
    rows = racines_data.load(config="patients", split="train", root=copy)
    assert rows[0]["mask"] is None
    store = open_store(copy, "patients")
    assert store.masks is None and store.mask_labels is None
    with pytest.raises(RacinesError, match="has no masks; add one that has"):
        MaskSet.of(store)
    assert "have no masks: the column is null" in (copy / "README.md").read_text()
    assert read_manifest(copy)["beating"] == read_manifest(root)["beating"]
    with pytest.raises(RacinesError, match="recipe_digest of patients: "):
        same_version(root, copy)


def test_a_new_phantom_leaves_patients_where_they_are(root: Path, tmp_path: Path):
    copy = tmp_path / "racines"
    shutil.copytree(root, copy)
    build(FakeSource(FakeConfig(seed=1)), copy, ONE)
    old, new = read_manifest(root), read_manifest(copy)
    assert old["digest"] != new["digest"] and [old[n] for n in TIERS] == [new[n] for n in TIERS]
    assert len(racines_data.load(config="beating", root=copy, verify=True)["test"]) == 24


def test_a_killed_build_goes_on_where_it_stopped(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    copy, source = tmp_path / "racines", BeatingSource.from_config(SETTINGS)
    shutil.copytree(root, copy)

    def die(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("racines_data.build.beside.swap_folder", die)
        with pytest.raises(KeyboardInterrupt):
            build(source, copy, ONE)
    assert read_manifest(copy) == read_manifest(root), "what stood there is untouched"
    monkeypatch.setattr(BeatingSource, "produce", die)
    monkeypatch.setattr(BeatingSource, "measures", die)
    build(source, copy, ONE)
    assert read_manifest(copy) == read_manifest(root)
    assert not list(tmp_path.glob(".racines*"))


def test_two_additions_at_one_moment_both_stay(built: Path, tmp_path: Path):
    """Each in a process of its own; both come to where the dataset is sealed while it is held."""
    copy = tmp_path / "racines"
    shutil.copytree(built, copy)
    before = read_manifest(copy)
    settings = {"train": [1], "frames_per_sweep": 2}
    params = {"data": {"workers": 1, "patients": settings, "beating": settings}}
    (tmp_path / "params.yaml").write_text(json.dumps(params))
    words = ["racines", "data", "build", "--params", "params.yaml", "--out", "racines", "--source"]
    with ThreadPoolExecutor(2) as pool:
        with locked_place(copy):
            added = [pool.submit(command, tmp_path, *words, name) for name in TIERS]
            until(lambda: len([*tmp_path.glob(".racines.staging-*/measures/*.json")]) == 2)
            time.sleep(0.2)  # what is left is done in that time, where nobody waits
            assert read_manifest(copy) == before, "who does not hold the place changes nothing"
        assert [done.result().returncode for done in added] == [0, 0]
    after = read_manifest(copy)
    assert set(after["configs"]) == {*before["configs"], *TIERS}
    assert after["digest"] == before["digest"]
    check_files(copy, after["files"], "rebuild", verify=True)
    assert not list(tmp_path.glob(".racines*"))


def test_the_card_tells_of_patients(root: Path):
    card = (root / "README.md").read_text()
    lines = [line for line in card.splitlines() if line.startswith("| patients | train |")]
    assert lines[0].endswith("| 6 (1 patients) | 24 |") and "healthy 1" in lines[1]
    assert "no patient is drawn again" in card and "19 aortic cusp" in card
    assert "`measures/patients.parquet`" in card
    assert "the best frame of each view, and a mask over a frame](card/beating.png)" in card
    assert "card/beating.png" in read_manifest(root)["files"]


BAD = [
    ({}, "data.patients: no patient: set train, validation or test"),
    ({"test": 141}, "data.patients.test: 141: the split has 140 patients: give 0 to 140"),
    ({"train": -1}, "data.patients.train: -1"),
    ({"train": [10_003]}, "seed 10003 is a patient of validation, not of train: name validation"),
    ({"test": [20_000, 20_000]}, "data.patients.test: a seed stands there twice"),
    ({"train": [15_000]}, "seed 15000 is no patient's"),
    ({"train": 1, "frames_per_sweep": 1}, "data.patients.frames_per_sweep: 1: give 2 or more"),
    ({"hearts": 3}, "data.patients.hearts: unknown key"),
]


@pytest.mark.parametrize(("settings", "told"), BAD)
def test_bad_settings_are_told_in_one_line(settings: dict, told: str):
    with pytest.raises(RacinesError) as caught:
        PatientsSource.from_config(settings)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_other_bad_input(root: Path, built: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="reads no --input"):
        PatientsSource.from_config(SETTINGS, [tmp_path])
    with pytest.raises(RacinesError, match="no dataset here; build one"):
        build(PatientsSource.from_config(SETTINGS), tmp_path / "none", ONE)
    with pytest.raises(RacinesError, match="unknown config 'patient'; this dataset has frames"):
        racines_data.load(config="patient", root=root)
    for ask in (racines_data.load, open_store):
        with pytest.raises(RacinesError, match="add it: racines data build --source beating"):
            ask(config="beating", root=built)


PARAMS = """
data:
  frames: 60
  workers: 1
  also: [patients, beating]
  phantom: {shortest: 10, longest: 20}
  patients: {train: [1], frames_per_sweep: 2}
  beating: {train: [1], frames_per_sweep: 2}
"""


def test_a_build_adds_what_its_settings_name_also(tmp_path: Path):
    """And the frames of the one heart have the digests and the bytes that they have alone."""
    (tmp_path / "params.yaml").write_text(PARAMS)
    alone = PARAMS.replace("[patients, beating]", "[]")
    (tmp_path / "alone.yaml").write_text(alone)
    told = {}
    for name in ("params", "alone"):
        words = ["data", "build", "--params", str(tmp_path / f"{name}.yaml"), "--json"]
        done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / name)])
        assert done.exit_code == 0, done.output
        told[name] = json.loads(done.stdout)
    assert told["params"]["digest"] == told["alone"]["digest"]
    assert told["params"]["recipe_digest"] == told["alone"]["recipe_digest"]
    assert [each["source"] for each in told["params"]["also"]] == [*TIERS]
    assert told["alone"]["also"] == []
    own = [path for path in (tmp_path / "alone").rglob("*") if path.is_file()]
    for path in own:
        if path.name not in ("README.md", "manifest.json", "croissant.json"):
            other = tmp_path / "params" / path.relative_to(tmp_path / "alone")
            assert other.read_bytes() == path.read_bytes(), path
    assert set(read_manifest(tmp_path / "params")["configs"]) >= set(TIERS)


def test_what_adds_nothing_is_refused_before_anything_is_built(tmp_path: Path):
    values = {"also": ["patients", "tracked"], "patients": {"train": 1}}
    with pytest.raises(RacinesError, match="data.also: source tracked adds no config.*patients"):
        make_also(*read_data_section(values))
    with pytest.raises(RacinesError, match="data.patients: no patient: set train"):
        make_also(*read_data_section({"also": ["patients"]}))
