"""Scores on turns about the apex: what is next, what is told by angle, and what is withheld."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from racines_data.build.dataset import DataConfig, build
from racines_data.manifest import read_manifest
from racines_data.sources.rotation.source import RotationSource
from racines_data.store.frames import FrameStore, open_store
from racines_models.generators.nearest_pose import NearestPose
from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
from racines_models.protocol import Run
from racines_models.sample import take_sample
from racines_models.scores import metrics
from racines_models.scores.gallery import gallery_sample, write_gallery
from racines_models.scores.scorer import Scorer, ScoresConfig
from racines_models.scores.turns import apart, by_angle, next_turns, training_frames, turn_figures
from racines_models.studies.leakage import LeakageConfig, measure_leakage
from tests.data.sources.rotation_folder import PHASES, write_rotation

COUNT = 72
ONE = DataConfig(workers=1, shards=1)


def made(folder: Path, name: str, **settings) -> FrameStore:
    source = RotationSource.from_config(settings, [folder])
    build(source, folder.parent / name, ONE)
    return open_store(folder.parent / name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rotation(tmp_path_factory.mktemp("turns") / "heart", turns=COUNT)


@pytest.fixture(scope="module")
def store(folder: Path) -> FrameStore:
    return made(folder, "pixels", split="gap")


class Blocks:
    """Means of 32 × 32 pixels: features that need no network."""

    settings = {"id": "blocks"}

    def __call__(self, images, progress=None):
        return torch.nn.functional.avg_pool2d(images.float().unsqueeze(1), 32).flatten(1)


def scorer_of(store: FrameStore, drawn=None) -> Scorer:
    sample = take_sample(store, "test", 1000)
    return Scorer(ScoresConfig(), store, sample, [sample.frames.images] if drawn is None else drawn)


def turn_of(store: FrameStore, rows: torch.Tensor) -> list[int]:
    names = [store.trajectories[int(k)] for k in store.trajectory_index[rows]]
    return [int(name.removeprefix("turn-")) for name in names]


def test_the_next_turn_is_the_nearest_other_one_at_the_same_phase(store: FrameStore):
    rows = torch.arange(len(store))
    found = next_turns(store, rows)
    assert store.phases is not None
    assert torch.equal(store.phases[found, 0], store.phases[rows, 0])
    steps = {
        (other - own) % COUNT
        for own, other in zip(turn_of(store, rows), turn_of(store, found), strict=True)
    }
    assert steps <= {1, COUNT - 1}  # turns are written in order of their angle
    pairs = zip(turn_of(store, rows), turn_of(store, found), strict=True)
    assert all(other == own - 1 for own, other in pairs if own % 3 == 2)  # the close one


def test_the_nearest_training_frame_is_mirrored_from_the_other_side(store: FrameStore):
    rows = store.split_indices("test")
    train, turns = store.split_indices("train"), store.turns
    assert turns is not None and store.phases is not None
    images = training_frames(store, rows)
    mirrored = 0
    for image, row in zip(images, rows.tolist(), strict=True):
        least = float(apart(turns[train, 0], turns[row, 0]).min())
        assert least == pytest.approx(float(turns[row, 1]), abs=1e-9)
        near = train[(apart(turns[train, 0], turns[row, 0]) - least).abs() < 1e-9]
        near = near[store.phases[near, 0] == store.phases[row, 0]]
        plain, flipped = store.images[near], store.images[near].flip(-1)
        assert bool((image == plain).flatten(1).all(1).any()) or bool(
            (image == flipped).flatten(1).all(1).any()
        )
        mirrored += not bool((image == plain).flatten(1).all(1).any())
    assert 0 < mirrored < len(rows)


def test_figures_of_the_truth_and_of_its_neighbours(store: FrameStore):
    scorer = scorer_of(store)
    figures = turn_figures(scorer, Blocks())
    assert figures["feature_distance"]["value"] == 0.0
    rows, truth = scorer.sample.frames.index, scorer.sample.frames.images
    beside = store.images[next_turns(store, rows)]
    wanted = float(metrics.ssim(beside, truth).mean())
    assert figures["ssim_neighbour"]["value"] == pytest.approx(wanted)
    away = (Blocks()(beside) - Blocks()(truth)).norm(dim=1).mean()
    assert figures["feature_distance_neighbour"]["value"] == pytest.approx(float(away), rel=1e-5)
    assert figures["ssim_train"]["value"] <= figures["ssim_neighbour"]["value"]
    for name in ("ssim", "psnr", "feature_distance", "fid", "kid"):
        for kind in ("neighbour", "train"):
            told = figures[f"{name}_{kind}"]
            assert told["n"] == len(rows) and "real frame" in told["settings"]["rule"]


def test_of_three_trainings_the_real_frames_are_looked_at_once(store: FrameStore):
    sample = take_sample(store, "test", 1000)
    drawn = [sample.frames.images, sample.frames.images.flip(-1), sample.frames.images.flip(0)]
    thrice = Scorer(ScoresConfig(), store, sample, drawn, runs=3)
    figures, one = turn_figures(thrice, Blocks()), turn_figures(scorer_of(store), Blocks())
    assert len(figures["feature_distance"]["settings"]["by_set"]) == 3
    for name in ("ssim_neighbour", "fid_neighbour", "kid_train", "feature_distance_train"):
        assert figures[name]["value"] == pytest.approx(one[name]["value"])
        assert "by_set" not in figures[name]["settings"]


def test_strata_are_parts_of_the_whole(store: FrameStore):
    scorer = scorer_of(store)
    strata = by_angle(scorer, Blocks())
    whole = turn_figures(scorer, Blocks()) | scorer.likeness()
    counts = [each["ssim"]["n"] for each in strata.values()]
    assert len(strata) > 1
    assert sum(counts) == len(scorer.sample.frames.index)
    means = [each["ssim_train"]["value"] for each in strata.values()]
    assert np.average(means, weights=counts) == pytest.approx(whole["ssim_train"]["value"])
    assert not any(key.startswith(("fid", "kid")) for each in strata.values() for key in each)
    first, last = (list(strata.values())[k]["ssim_train"]["value"] for k in (0, -1))
    assert first > last  # nearer training frames are more alike


def test_units_are_sectors_of_three_degrees(store: FrameStore):
    sample = take_sample(store, "test", 1000)
    assert store.turns is not None
    angle = store.turns[sample.frames.index, 0].numpy()
    assert np.array_equal(sample.trajectory, np.floor(angle / 3).astype(int))
    assert len(np.unique(sample.trajectory)) < len(np.unique(angle))


def test_millimetres_are_withheld_without_a_scale(folder: Path, store: FrameStore):
    regressor = PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125))
    for known, each in ((False, store), (True, made(folder, "metres", pixel_mm=0.8))):
        found = scorer_of(each).poses(regressor)
        assert ("pose_error_mm" in found) is known and "pose_error_deg" in found
        leak = measure_leakage(each, LeakageConfig(samples=50)).content["splits"]["trajectory"]
        assert (leak["position_mm"] is not None) is known and leak["rotation_deg"] is not None


def test_retrieval_finds_the_phase_and_is_bounded_by_neighbours(store: FrameStore, tmp_path: Path):
    generator = NearestPose()
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    assert generator.card.data["scale"] == "unknown" and generator.card.data["phase"] is True
    assert generator.metres == 1e-3
    sample = take_sample(store, "test", 1000)
    drawn = generator.generate(sample.frames.parameters, 0)
    own = float(metrics.ssim(drawn, sample.frames.images).mean())
    scorer = scorer_of(store, [drawn])
    bound = turn_figures(scorer, Blocks())["ssim_neighbour"]["value"]
    assert own < bound
    assert len(read_manifest(store.root)["turns"]["test"]) * PHASES == len(drawn)


def test_a_gallery_shows_six_held_out_turns_in_order(store: FrameStore, tmp_path: Path):
    sample = gallery_sample(store)
    rows = sample.frames.index
    assert store.turns is not None and store.phases is not None
    at = torch.remainder(store.turns[rows, 0], 180.0)
    assert len(rows) == 6 and bool((at.diff() > 0).all())
    assert set(rows.tolist()) <= set(store.split_indices("test").tolist())
    assert len(store.phases[rows, 0].unique()) == PHASES
    generator = NearestPose()
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    write_gallery(tmp_path / "six.png", store, sample, {"nearest-pose": generator}, 0)
    assert Image.open(tmp_path / "six.png").size[1] > 6 * 128


def test_a_part_measures_nothing_again_and_says_what_it_would_measure(store: FrameStore):
    sample = take_sample(store, "test", 20)
    drawn = [sample.frames.images.roll(k, 0) for k in (1, 2)]
    whole = Scorer(ScoresConfig(), store, sample, drawn, runs=2)
    rows, calls = torch.tensor([1, 4, 5]), []

    def counted(images: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        calls.append(len(images))
        return metrics.ssim(images, truth)

    whole.measure("ssim", counted, drawn)
    part = whole.part(rows)
    told = part.likeness()
    assert calls == [len(sample.frames.images)] * 2
    alone = Scorer(
        ScoresConfig(), store, part.sample, [images[rows] for images in drawn], runs=2
    ).likeness()
    assert told["ssim"] == alone["ssim"] and told["psnr"] == alone["psnr"]
    assert part.sample.frames.index.tolist() == sample.frames.index[rows].tolist()
    assert set(whole.measured) == {"ssim"}, "the whole is told nothing by its part"
