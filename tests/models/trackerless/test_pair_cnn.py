"""The learned baseline: what it learns, that rows are their own, how it is kept and resumed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.protocol import Run
from racines_models.trackerless.floors import MeanMotion, NoMotion
from racines_models.trackerless.motion import from_vectors, steps
from racines_models.trackerless.pair_cnn.estimator import PairCnn
from racines_models.trackerless.pair_cnn.network import (
    PairConfig,
    PairNetwork,
    PairTraining,
    windows,
)
from racines_models.trackerless.pair_cnn.training import (
    PairBatch,
    PairLearner,
    Pairs,
    point_errors,
    turned_round,
)
from racines_models.trackerless.scoring import MotionScoresConfig, estimate_all, score_motion
from racines_models.trackerless.sweeps import SweepSet
from racines_models.training.sets import train_seeds
from racines_models.weights import publish
from tests.models.trackerless.sweeping import SweptStore

TINY = PairTraining(
    images=96, batch_size=16, warmup_images=16, checkpoint_every=16, sample_every=48, log_every=32
)


def config(**given: Any) -> PairConfig:
    small: dict[str, Any] = {"widths": (4, 6, 8), "hidden": 16, "training": TINY}
    return PairConfig(**(small | given))


@pytest.fixture(scope="module")
def sweeps() -> SweepSet:
    return SweepSet(SweptStore())


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> tuple[Path, SweepSet]:
    many = SweepSet(SweptStore({"train": 150, "validation": 8, "test": 12}))
    learnt = replace(TINY, images=3_200, warmup_images=320, checkpoint_every=1_600)
    folder = tmp_path_factory.mktemp("pair-cnn")
    wide = config(widths=(8, 12, 16, 24), hidden=48, learning_rate=4e-3, training=learnt)
    PairCnn(wide).fit(many, Run(folder, 0, "cpu", progress=False))
    return folder, many


def test_it_learns_motion_of_sweeps_that_it_has_not_seen(trained, tmp_path: Path):
    folder, sweeps = trained
    found = sweeps.sweeps("test")
    asked = MotionScoresConfig()

    def lpe(estimator) -> float:
        motions = estimate_all([estimator], sweeps, found)
        return score_motion("x", motions, sweeps, asked).content["metrics"]["lpe"]["value"]

    mean = MeanMotion()
    mean.fit(sweeps, Run(tmp_path, progress=False))
    assert lpe(PairCnn.load(folder)) < 0.8 * min(lpe(NoMotion()), lpe(mean))
    metrics = json.loads((folder / "metrics.json").read_text())
    told = metrics["metrics"]["points_mm"]
    assert metrics["split"] == "validation" and told["n"] == 56
    assert told["low"] < told["value"] < told["high"]


def test_a_step_ignores_its_batch(trained):
    folder, sweeps = trained
    estimator = PairCnn.load(folder)
    shown = sweeps.shown(sweeps.sweeps("test")[0])
    whole = estimator.estimate(shown).to_previous
    cut = estimator.estimate(replace(shown, images=shown.images[:4])).to_previous
    assert torch.equal(cut, whole[:4])
    later = estimator.estimate(replace(shown, images=shown.images[3:])).to_previous
    assert torch.equal(later[1:], whole[4:])
    pair = estimator.estimate(replace(shown, images=shown.images[5:7])).to_previous
    assert torch.equal(pair[1], whole[6])
    single = estimator.estimate(replace(shown, images=shown.images[:1]))
    assert torch.equal(single.to_first, torch.eye(4, dtype=torch.float64)[None])


def test_a_killed_training_goes_on_to_the_same_bits(sweeps, tmp_path: Path, monkeypatch):
    whole = Run(tmp_path / "whole", 3, "cpu", progress=False)
    killed = Run(tmp_path / "killed", 3, "cpu", progress=False)
    PairCnn(config(reverse=0.5)).fit(sweeps, whole)
    updates, done = PairLearner.updates, iter(range(100))

    def dies(self, nets, batch):
        if next(done) == 4:
            raise KeyboardInterrupt
        yield from updates(self, nets, batch)

    monkeypatch.setattr(PairLearner, "updates", dies)
    with pytest.raises(KeyboardInterrupt):
        PairCnn(config(reverse=0.5)).fit(sweeps, killed)
    assert (tmp_path / "killed/checkpoint/last.pt").is_file()
    monkeypatch.undo()
    PairCnn(config(reverse=0.5)).fit(sweeps, killed)
    one, other = (PairCnn.load(run.folder).sha256 for run in (whole, killed))
    assert one == other and not list((tmp_path / "killed").glob("*checkpoint*"))
    PairCnn(config(reverse=0.5)).fit(sweeps, replace(whole, folder=tmp_path / "other", seed=4))
    assert PairCnn.load(tmp_path / "other").sha256 != one


def test_three_trainings_are_one_result(sweeps, tmp_path: Path):
    settings = config(training=replace(TINY, repeats=3))
    run = Run(tmp_path, 5, "cpu", progress=False)
    told = train_seeds(lambda one: PairCnn(settings).fit(sweeps, one), run, 3)
    assert set(told["seeds"]) == {"5", "6", "7"}
    folders = [tmp_path, tmp_path / "seed-6", tmp_path / "seed-7"]
    trainings = [PairCnn.load(each) for each in folders]
    motions = estimate_all(trainings, sweeps, sweeps.sweeps("test"))
    content = score_motion("pair-cnn", motions, sweeps, MotionScoresConfig()).content
    assert content["runs"] == content["metrics"]["gpe"]["settings"]["trainings"] == 3


def test_weights_are_kept_whole_or_in_half_precision(trained, tmp_path: Path):
    folder, sweeps = trained
    shown = sweeps.shown(sweeps.sweeps("test")[0])
    publish(folder, tmp_path)
    half, whole = PairCnn.load(tmp_path), PairCnn.load(folder)
    apart = half.estimate(shown).to_first - whole.estimate(shown).to_first
    assert 0 < float(apart.abs().max()) < 2e-3
    assert whole.learned_from == json.loads((folder / "config.json").read_text())["data"]


def test_a_window_keeps_to_its_sweep(sweeps):
    pairs = Pairs(sweeps, 3)
    rows = pairs.split_indices("test")
    first = int(sweeps.rows("test")[0][0])
    assert rows[0] == first + 1 and len(rows) == 6 * 7
    batch = pairs.take(rows[:2], rows[:2])
    images = sweeps.store.images
    assert torch.equal(batch.images[0], images[[first, first, first + 1]])
    assert torch.equal(batch.images[1], images[[first, first + 1, first + 2]])
    assert windows(torch.tensor([1, 2]), 2, 0).tolist() == [[0, 1], [1, 2]]


def test_pairs_that_are_turned_round_have_their_motion_undone():
    generator = torch.Generator().manual_seed(0)
    motions = 0.1 * torch.randn(64, 6, generator=generator)
    images = torch.randint(0, 255, (64, 2, 128, 128), generator=generator, dtype=torch.uint8)
    batch = PairBatch(images, motions, torch.arange(64))
    turned = turned_round(batch, 0.5)
    changed = (turned.motions != motions).any(1)
    assert 16 < int(changed.sum()) < 48
    assert torch.equal(turned.images[changed], images[changed].flip(1))
    assert torch.equal(turned.images[~changed], images[~changed])
    both = from_vectors(motions[changed].double()) @ from_vectors(turned.motions[changed].double())
    assert torch.allclose(both, torch.eye(4, dtype=torch.float64).expand_as(both), atol=1e-6)
    assert turned_round(batch, 0.0) is batch


def test_the_loss_is_a_distance_in_millimetres():
    shift = torch.tensor([[0.003, 0.004, 0.0, 0.0, 0.0, 0.0]])
    points = torch.rand(9, 3)
    found = point_errors(torch.zeros(1, 6), shift, points)
    assert torch.allclose(found, torch.full((1, 9), 5.0), atol=1e-3)


def test_it_starts_at_the_training_sweeps_mean_and_ends_slowly(sweeps):
    learner = PairLearner(sweeps, config(), Run(Path("unused"), 0, "cpu", progress=False))
    motions = learner.pairs.motions(learner.pairs.split_indices("train"))
    assert torch.allclose(learner.network.mean, motions.mean(0))
    assert learner.rate(0) > learner.rate(2) > learner.rate(5) > 0.0


def test_what_cannot_be_used_is_refused(sweeps, tmp_path: Path):
    wrongs: tuple[tuple[dict[str, Any], str], ...] = (
        ({"input_size": 96}, "input_size 96"),
        ({"window": 1}, "window 1: give 2 or more"),
        ({"widths": ()}, "widths"),
        ({"reverse": 2.0}, "reverse 2"),
    )
    for wrong, told in wrongs:
        with pytest.raises(RacinesError, match=told):
            PairConfig(**wrong)
    with pytest.raises(RacinesError, match="no network yet"):
        PairCnn().estimate(sweeps.shown(sweeps.sweeps("test")[0]))
    store = SweptStore()
    store._splits["train"] = [0, 0]
    with pytest.raises(RacinesError, match="train split has no sweeps with poses"):
        PairCnn(config()).fit(SweepSet(store), Run(tmp_path, progress=False))
    (tmp_path / "config.json").write_text(json.dumps({"schema": "racines.grader/1"}))
    with pytest.raises(RacinesError, match="schema 'racines.grader/1'"):
        PairCnn.load(tmp_path)


def test_every_size_can_be_built():
    several: tuple[dict[str, Any], ...]
    several = ({}, {"input_size": 128}, {"window": 4}, {"widths": (8,)})
    for given in several:
        settings = PairConfig(**given)
        network = PairNetwork(settings).eval()
        images = torch.zeros(2, settings.window, 128, 128, dtype=torch.uint8)
        found = network(network.normalise(images))
        assert found.shape == (2, 6)
        assert steps(found.detach()).to_first.shape == (3, 4, 4)
