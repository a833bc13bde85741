"""The source `rotation`: what is read, in which frame and unit, and how turns are split."""

import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import racines_data
from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.manifest import read_manifest, scale_known
from racines_data.schema import TURNS as TURN_NAMES
from racines_data.sources.images import Kind
from racines_data.sources.rotation.source import RotationSource
from racines_data.sources.rotation.turns import angles, apart, split_turns, to_nearest
from racines_data.store.frames import open_store
from racines_data.validate.inspecting import inspect_dataset
from racines_data.validate.run import validate
from tests.conftest import command
from tests.data.sources.rotation_folder import (
    APEX,
    PHASES,
    SIDE,
    TURNS,
    content_of,
    degrees_of,
    pose,
    write_content,
    write_rotation,
)

REAL = Path(os.environ.get("RACINES_REAL", Path(__file__).parents[3] / ".." / "shared" / "real"))
HEART = REAL / "neuralcmf"
ONE = DataConfig(workers=1, shards=1)


def source(folder: Path, **settings) -> RotationSource:
    return RotationSource.from_config(settings, [folder])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rotation(tmp_path_factory.mktemp("rotation") / "heart")


@pytest.fixture(scope="module")
def root(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("built") / "rotation"
    build(source(folder), out, ONE)
    return out


def test_a_turn_is_a_trajectory_of_one_pose_and_all_its_phases(root: Path):
    store = open_store(root)
    assert len(store) == TURNS * PHASES and len(store.trajectories) == TURNS
    assert store.trajectories.count("turn-0003") == 1 and set(store.sessions) == {"heart"}
    assert store.phases is not None and store.turns is not None
    for turn in range(TURNS):
        rows = torch.nonzero(store.trajectory_index == turn).flatten()
        assert store.phases[rows, 0].tolist() == pytest.approx([k / PHASES for k in range(PHASES)])
        assert bool(store.phases[rows, 1].isnan().all())
        assert len(store.parameters[rows, 6:].unique(dim=0)) == 1
    assert bool(store.parameters[:, :6].isnan().all()) and bool(store.timestamps.isnan().all())
    assert bool((store.views == -1).all()) and bool(store.grades.isnan().all())


def test_the_probe_looks_along_the_depth_from_the_apex(root: Path):
    store = open_store(root)
    found = parameters_to_pose(store.parameters.double())
    for row in range(0, len(store), PHASES):
        number = int(store.trajectories[int(store.trajectory_index[row])].removeprefix("turn-"))
        matrix = pose(float(degrees_of()[number]), lean=2.0 * np.sin(number))
        across, depth, normal = (matrix[:3, axis] for axis in range(3))
        wanted = np.stack([across, -normal, depth], -1)
        assert np.allclose(found.rotation[row], wanted, atol=1e-5)
        assert np.allclose(found.position[row], APEX, atol=1e-4)


def test_images_are_those_of_the_folder_in_order(folder: Path, root: Path):
    store = open_store(root)
    row = int(torch.nonzero(store.trajectory_index == store.trajectories.index("turn-0007"))[1])
    file = Image.open(folder / "images" / f"{7 * PHASES + 1:04d}.png")
    wanted = np.asarray(file.resize((128, 128), Image.Resampling.LANCZOS))
    assert np.array_equal(store.images[row].numpy(), wanted)


def test_without_a_pixel_size_positions_are_pixels_and_the_manifest_says_so(root: Path):
    manifest = read_manifest(root)
    assert manifest["scale"] == "unknown" and not scale_known(manifest)
    assert manifest["turns"]["count"] == TURNS and manifest["turns"]["phases"] == PHASES
    card = (root / "README.md").read_text()
    assert "positions are in pixels" in card and " mm" not in card
    assert "| `position_x` | pixels |" in card


def test_with_a_pixel_size_positions_are_metres(folder: Path, tmp_path: Path):
    build(source(folder, pixel_mm=0.8), tmp_path / "out", ONE)
    manifest, store = read_manifest(tmp_path / "out"), open_store(tmp_path / "out")
    assert manifest["scale"] == {"pixel_mm": 0.8} and scale_known(manifest)
    assert np.allclose(store.parameters[:, 6:9], 0.8e-3 * APEX, atol=1e-7)
    assert "| `position_x` | m |" in (tmp_path / "out" / "README.md").read_text()
    assert validate(tmp_path / "out").ok


def test_the_dataset_is_sound_and_loads(root: Path):
    found = validate(root)
    assert found.ok, [check for check in found.checks if not check.ok]
    assert not {"times", "rate"} & {check.name for check in found.checks}
    row = racines_data.load(root=root, split="test")[0]
    assert 0 <= row["cardiac_phase"] < 1 and 0 <= row["turn_angle"] < 180
    assert row["train_angle"] > 0 and row["force_x"] is None and row["timestamp"] is None
    croissant = (root / "croissant.json").read_text()
    assert all(f'"{name}"' in croissant for name in ("cardiac_phase", *TURN_NAMES))


def test_the_store_is_made_again_from_the_shards(root: Path, tmp_path: Path):
    from racines_data.store.sweeps import restore_stores

    copy = tmp_path / "copy"
    shutil.copytree(root, copy)
    (copy / "store" / "frames.arrow").unlink()
    assert restore_stores(copy) == ["store/frames.arrow"]
    one, other = open_store(root), open_store(copy)
    assert torch.equal(one.images, other.images)
    for name in ("phases", "turns", "parameters"):
        assert torch.equal(getattr(one, name).nan_to_num(-1), getattr(other, name).nan_to_num(-1))


def test_the_same_bytes_in_other_processes(
    folder: Path, root: Path, tmp_path: Path, warm_workers: None
):
    made = build(source(folder), tmp_path / "again", DataConfig(workers=2, shards=1))
    assert made["digest"] == read_manifest(root)["digest"]
    assert made["recipe_digest"] == read_manifest(root)["recipe_digest"]
    assert pickle.loads(pickle.dumps(source(folder))).plan() == source(folder).plan()


def test_conditions_end_with_the_phase(root: Path):
    store = open_store(root)
    rows = store.split_indices("test")
    batch = store.take(rows)
    assert store.phased and batch.parameters.shape == (len(rows), 13)
    assert store.phases is not None
    assert torch.equal(batch.parameters[:, 12], store.phases[rows, 0].float())
    assert torch.equal(batch.parameters[:, 6:12], store.parameters[rows, 6:])


def test_turns_are_a_sweep_for_each_phase(root: Path):
    made, store = inspect_dataset(root), open_store(root)
    assert store.turns is not None
    assert {len(each.rows) for each in made.drafts} == {len(store.trajectories)}
    assert made.unit == "pixels" and all(title.endswith("°") for title, _ in made.images)
    angles = store.turns[torch.from_numpy(made.drafts[0].rows), 0]
    assert bool((angles.diff() >= 0).all())
    tips = 1e3 * made.poses[0][:, :3, 3]
    told = store.parameters[torch.from_numpy(made.drafts[0].rows), 6:9]
    assert np.allclose(tips, told, rtol=1e-6)


@pytest.mark.parametrize("phases", [1, 2, 5])
def test_any_number_of_phases(tmp_path: Path, phases: int):
    folder = write_rotation(tmp_path / "heart", turns=12, phases=phases)
    build(source(folder), tmp_path / "out", ONE)
    store = open_store(tmp_path / "out")
    assert len(store) == 12 * phases and validate(tmp_path / "out").ok
    assert store.phased is (phases > 1) and (store.phases is None) is (phases == 1)
    assert store.take(store.split_indices("test")).parameters.shape[1] == 12 + (phases > 1)
    row = racines_data.load(root=tmp_path / "out", split="train")[0]
    assert (row["cardiac_phase"] is None) is (phases == 1) and row["train_angle"] == 0.0


def test_phase_major_order_and_times(tmp_path: Path):
    folder = write_rotation(tmp_path / "heart", turns=12)
    content = content_of(folder)
    frames = [
        {**each, "time": 0.9 - 0.4 * (k % PHASES)} for k, each in enumerate(content["frames"])
    ]
    order = [turn * PHASES + phase for phase in range(PHASES) for turn in range(12)]
    for place, name in enumerate(order):  # the images of the file's order, named by it
        frames[name] = frames[name] | {"file_path": f"images/{name:04d}.png"}
        assert place < len(frames)
    write_content(folder, {"frames": [frames[name] for name in order]})
    made = source(folder)
    units = made.plan()
    assert units[0].phases == pytest.approx((0.1, 0.5, 0.9))
    assert [path.name for path in units[4].paths] == ["0014.png", "0013.png", "0012.png"]
    assert not any(each.reason.startswith(Kind.PHASE) for each in made.report)


def test_images_that_are_not_square_and_a_full_matrix(tmp_path: Path):
    folder = write_rotation(tmp_path / "heart", turns=12, size=(SIDE, SIDE - 8))
    content = content_of(folder)
    for frame in content["frames"]:
        frame["transform_matrix"].append([0, 0, 0, 1])
    write_content(folder, content | {"w": SIDE, "h": SIDE - 8, "camera_angle_x": 0.7})
    units = source(folder).plan()
    assert source(folder).produce(units[0]).images.shape == (PHASES, 128, 128)
    assert units[0].matrix[:3, 3] == pytest.approx(APEX)


def test_what_is_printed(folder: Path, tmp_path: Path):
    words = "data", "import", str(folder), "--source", "rotation", "--workers", "1"
    done = command(tmp_path, "racines", *words, "--out", "out", code=0)
    assert "`file_path` names no file here (such as ./somewhere/else/0000.png): each image is that "
    assert "of its name in images/, which is their natural order" in done.stdout
    assert f"{TURNS} turns of {PHASES} phases, {SIDE}×{SIDE} pixels; interpolation:" in done.stdout
    assert "from the nearest training turn" in done.stdout
    assert "positions stay in pixels" in done.stdout and "--pixel-mm" in done.stdout
    assert "no licence given" in done.stderr
    more = "--pixel-mm", "0.9", "--licence", "MIT", "--set", "split=gap", "--out", "other"
    done = command(tmp_path, "racines", *words, *more, code=0)
    assert "pixels; gap:" in done.stdout and "stay in pixels" not in done.stdout
    assert read_manifest(tmp_path / "other")["card"]["license"] == "mit"


def test_the_order_is_natural_where_names_do_not_tell(tmp_path: Path):
    folder = write_rotation(tmp_path / "heart", turns=12, phases=1)
    images = sorted((folder / "images").iterdir())
    for number, path in enumerate(images):
        path.rename(path.with_name(f"frame{number}.png"))  # frame10 sorts before frame2
    made = source(folder)
    names = [unit.paths[0].name for unit in made.plan()]
    assert names == [f"frame{number}.png" for number in range(12)]
    assert any("the order is the natural one of images/" in each.reason for each in made.report)


# --- angles and splits ---------------------------------------------------------------------------


def test_angles_count_modulo_half_a_turn():
    at = np.array([3.0, 10.0, 100.0, 183.0, 190.0, 280.0])
    found = angles(np.stack([pose(degrees) for degrees in at]))
    assert apart(found[:3], found[3:]) == pytest.approx(0, abs=1e-6)
    assert apart(found[0], found[1]) == pytest.approx(7.0) and ((found >= 0) & (found < 180)).all()
    assert apart(np.array(179.0), np.array(2.0)) == pytest.approx(3.0)


@pytest.mark.parametrize("mode", ["interpolation", "gap"])
def test_blocks_are_contiguous_and_held_out_whole(mode: str):
    at = np.mod(np.random.default_rng(0).normal(80, 35, 200), 180)
    splits = split_turns(at, mode, 6, 3.0, 30.0, 0.2)
    assert set(splits) == {"train", "validation", "test"}
    train, test = at[splits == "train"], np.sort(at[splits == "test"])
    nearest = to_nearest(test, train)
    if mode == "gap":
        assert test[-1] - test[0] < 30 and nearest.max() > 7
        inside = (at >= test[0]) & (at <= test[-1])
        assert (splits[inside] == "test").all()
        assert to_nearest(test[:1], train) < 8 and to_nearest(test[-1:], train) < 8
    else:
        assert 1 < (np.diff(test) > 3).sum() + 1 <= 6 and nearest.max() <= 3.0
    validation = at[splits == "validation"]
    assert to_nearest(validation, test).min() > 3.0


def test_frames_know_how_far_training_is(root: Path):
    store = open_store(root)
    assert store.turns is not None
    train = store.turns[store.split_indices("train"), 0].numpy()
    for split in ("train", "validation", "test"):
        rows = store.split_indices(split)
        wanted = to_nearest(store.turns[rows, 0].numpy(), train)
        assert store.turns[rows, 1].numpy() == pytest.approx(wanted, abs=1e-9)
    assert float(store.turns[store.split_indices("test"), 1].min()) > 0


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"split": "random"}, "data.rotation.split 'random': choose interpolation or gap"),
        ({"pixel_mm": 800.0}, "pixel_mm 800: a pixel of an echo measures 0.01 to 5 mm"),
        ({"pixel_mm": -1.0}, "pixel_mm -1: a pixel"),
        ({"blocks": 0}, "blocks are 1 or more"),
        ({"width": 0.0}, "width in"),
        ({"gap": 170.0}, "gap in"),
        ({"share": 1.5}, "share lies in"),
        ({"length": 3}, "data.rotation.length: unknown key"),
    ],
)
def test_settings_are_refused(folder: Path, settings: dict, said: str):
    with pytest.raises(RacinesError, match=said):
        source(folder, **settings)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"width": 60.0, "blocks": 12}, "leave [01] to train on"),
    ],
)
def test_splits_that_leave_nothing_are_refused(folder: Path, settings: dict, said: str):
    with pytest.raises(RacinesError, match=said):
        source(folder, **settings).plan()


def test_a_gap_needs_turns_on_both_sides():
    with pytest.raises(RacinesError, match="no 30 degrees have turns on both sides to train on"):
        split_turns(np.arange(12.0), "gap", 6, 3.0, 30.0, 0.2)


# --- the real recording --------------------------------------------------------------------------


@pytest.mark.skipif(
    not HEART.is_dir(), reason=f"REAL HEART ABSENT from {HEART}: set RACINES_REAL to its folder"
)
@pytest.mark.slow
def test_the_real_recording(tmp_path: Path):
    made = source(HEART)
    manifest = build(made, tmp_path / "heart", DataConfig(workers=1, licence="MIT"))
    turns = manifest["turns"]
    assert (turns["count"], turns["phases"]) == (200, 6) and manifest["scale"] == "unknown"
    assert manifest["counts"]["frames"] == 1200 and turns["image_pixels"] == [160, 160]
    assert any("natural order" in each.reason for each in made.report)
    store = open_store(tmp_path / "heart")
    place = store.parameters[:, 6:9].double()
    assert np.allclose(place.mean(0), [80.10, 80.25, -2.01], atol=0.01)  # the cube's upper middle
    assert float((place - place.mean(0)).norm(dim=-1).max()) < 8  # turns are about the apex
    assert 0 < turns["median"] < turns["farthest"] < 3
    wide = source(HEART, split="gap")
    wide.plan()
    assert 5 < wide.told["turns"]["median"] < wide.told["turns"]["farthest"] <= 15
