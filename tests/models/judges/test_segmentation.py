"""The segmentation judge: what it learns, that rows are their own, how it is kept and resumed."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.judges.segmentation import training
from racines_models.judges.segmentation.frames import MaskSet
from racines_models.judges.segmentation.model import (
    SegmentationConfig,
    SegmentationJudge,
    SegmentationNetwork,
    SegmentationTraining,
)
from racines_models.judges.segmentation.overlap import dice, overlap_figures
from racines_models.judges.segmentation.structures import relabel, to_camus, to_structures
from racines_models.judges.segmentation.training import SegmentationLearner, train_segmentation
from racines_models.protocol import Run
from racines_models.training.augmentation import StrongAugmentation
from racines_models.weights import publish
from tests.models.judges.masked import LABELS, mask_set
from tests.models.labelled import LabelledStore

NAMES = ("LV", "LV myocardium", "LA")


@pytest.fixture(scope="module")
def frames() -> MaskSet:
    return mask_set()


def config(images: int = 96, **given) -> SegmentationConfig:
    settings = {"batch_size": 8, "warmup_images": 16, "precision": "fp32", "ema": 0.9}
    learnt = SegmentationTraining(images=images, **settings, checkpoint_every=16)
    return SegmentationConfig(NAMES, 64, 8, training=learnt, **given)


@pytest.fixture(scope="module")
def trained(frames, tmp_path_factory):
    folder = tmp_path_factory.mktemp("segmentation")
    mild = StrongAugmentation(("rotation", "gain"), gain=0.1)
    run = Run(folder, 0, "cpu", progress=False)
    return folder, train_segmentation(frames, config(560, learning_rate=1e-2, strong=mild), run)


def test_it_learns_outlines_of_patients_it_has_not_seen(trained, frames):
    folder, metrics = trained
    for name in ("dice_lv", "dice_lv_myocardium", "dice_la"):
        figure = metrics["metrics"][name]
        assert figure["value"] > 0.75 and figure["low"] < figure["value"] < figure["high"]
        assert figure["settings"]["units"] == 9 and figure["n"] == 72
    assert set(metrics["by"]["pathology"]) == {"healthy", "dilated"}
    assert json.loads((folder / "metrics.json").read_text()) == json.loads(json.dumps(metrics))
    judge = SegmentationJudge.load(folder)
    assert training.report(judge, frames)["metrics"] == metrics["metrics"]
    assert judge.structures == NAMES and judge.settings["sha256"] == judge.sha256
    publish(folder, folder / "half")
    half = SegmentationJudge.load(folder / "half").segment(frames.images[:8])
    assert float((half == judge.segment(frames.images[:8])).float().mean()) > 0.99


def test_a_mask_ignores_its_batch(trained, frames):
    judge = SegmentationJudge.load(trained[0])
    whole = judge.segment(frames.images[:21])
    assert torch.equal(torch.cat([judge.segment(each[None]) for each in frames.images[:21]]), whole)
    order = torch.randperm(21, generator=torch.Generator().manual_seed(1))
    assert torch.equal(judge.segment(frames.images[order]), whole[order])
    assert judge.segment(frames.images[:0]).shape == (0, 128, 128)
    camus = judge.segment_camus(frames.images[:2])
    assert torch.equal(camus, whole[:2])  # its structures stand in CAMUS's order


def test_a_killed_training_goes_on_to_the_same_bits(frames, tmp_path, monkeypatch):
    whole = Run(tmp_path / "whole", 3, "cpu", progress=False)
    train_segmentation(frames, config(48), whole)
    killed = Run(tmp_path / "killed", 3, "cpu", progress=False)
    updates = SegmentationLearner.updates
    steps = iter(range(100))

    def dies(self, nets, batch):
        if next(steps) == 4:
            raise KeyboardInterrupt
        yield from updates(self, nets, batch)

    monkeypatch.setattr(SegmentationLearner, "updates", dies)
    with pytest.raises(KeyboardInterrupt):
        train_segmentation(frames, config(48), killed)
    monkeypatch.undo()
    train_segmentation(frames, config(48), killed)
    one, other = (SegmentationJudge.load(run.folder).sha256 for run in (whole, killed))
    assert one == other and not list((tmp_path / "killed").glob("*checkpoint*"))


@pytest.mark.thorough
def test_patches_outline_what_no_grid_of_them_could(frames, tmp_path):
    """A network of 4 x 4 patches tells pixels of one patch apart."""
    learnt = replace(config(320, learning_rate=1e-2, patch=4), input_size=128)
    run = Run(tmp_path, 0, "cpu", progress=False)
    metrics = train_segmentation(frames, learnt, run)["metrics"]
    assert metrics["dice_lv"]["value"] > 0.6
    found = SegmentationJudge.load(tmp_path).segment(frames.images[:8])
    patches = found.unfold(1, 4, 4).unfold(2, 4, 4).flatten(3)
    mixed = (patches != patches[..., :1]).any(-1) & (patches > 0).any(-1)
    assert int(mixed.sum()) > 100


def test_dice_is_asked_where_the_structure_is():
    truth = torch.zeros(3, 128, 128, dtype=torch.uint8)
    found = truth.clone()
    truth[0, :20, :20], found[0, 10:30, :20] = 1, 1
    found[1, :10, :10] = 1
    values = dice(found, truth, 1)[:, 0]
    assert values[0] == 0.5 and bool(values[1:].isnan().all())
    figures = overlap_figures(found, truth, ("LV",), np.arange(3))
    assert figures["dice_lv"]["n"] == 1 and figures["false_lv"]["value"] == 0.5


def test_labels_go_by_name_to_structures_and_to_camus():
    table = to_structures(LABELS, NAMES)
    assert table[:6].tolist() == [0, 1, 2, 3, 1, 0]
    own = to_structures(LABELS, ("LA", "LV"))
    camus = relabel(torch.tensor([0, 1, 2], dtype=torch.uint8), to_camus(("LA", "LV")))
    assert own[:5].tolist() == [0, 2, 0, 1, 2] and camus.tolist() == [0, 3, 1]
    with pytest.raises(RacinesError, match=r"structures RV: the masks have background, LV"):
        to_structures(LABELS, ("LV", "RV"))


def test_what_does_not_fit_is_refused(frames, tmp_path):
    rows = frames.splits | {"test": frames.splits["train"][:3]}
    with pytest.raises(RacinesError, match="patient 0 is in train and test: split by patient"):
        MaskSet(frames.images, frames.masks, frames.patients, rows, LABELS)
    with pytest.raises(RacinesError, match="differ in number or shape"):
        MaskSet(frames.images[1:], frames.masks, frames.patients, frames.splits, LABELS)
    store = LabelledStore()
    store.root = tmp_path
    with pytest.raises(RacinesError, match="has no masks; add one that has"):
        MaskSet.of(store)
    with pytest.raises(RacinesError, match="input_size 96: choose 64 or 128"):
        SegmentationConfig(input_size=96)
    with pytest.raises(RacinesError, match="patch 3: choose 1, 2 or 4"):
        SegmentationConfig(patch=3)
    with pytest.raises(RacinesError, match="no segmentation judge there; run: racines train seg"):
        SegmentationJudge.load(tmp_path)


def test_full_size_and_the_command_that_says_what_is_lacking(tmp_path):
    images = torch.zeros(2, 128, 128, dtype=torch.uint8)
    for patch in (1, 2, 4):
        network = SegmentationNetwork(SegmentationConfig(channels=2, patch=patch)).eval()
        assert network(network.normalise(images)).shape == (2, 6, 128, 128)
    words = ["train", "segmentation", "--data", "none", "--out", str(tmp_path / "run")]
    with pytest.raises(RacinesError, match="none: no dataset here"):
        CliRunner().invoke(app, words, catch_exceptions=False)
    assert not (tmp_path / "run").exists()
