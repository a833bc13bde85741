"""Several seeds of one method: each trained once, all of them scored."""

import json

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.generators.mean_image import MeanImage
from racines_models.protocol import Run
from racines_models.registry import open_runs, weights_of
from racines_models.sample import Sample
from racines_models.scores.scoring import Scorer, ScoresConfig, take_turns
from racines_models.training.checkpoint import repeat_folders
from racines_models.training.sets import train_seeds


class Fits:
    """Trains in no time; breaks off at one seed."""

    def __init__(self, breaks_at=None):
        self.breaks_at, self.runs = breaks_at, []

    def __call__(self, run: Run):
        if run.seed == self.breaks_at:
            raise KeyboardInterrupt
        self.runs.append(run)
        run.folder.mkdir(parents=True, exist_ok=True)
        return {"psnr": 20.0 + run.seed}


def test_each_seed_has_a_folder_and_all_are_reported(tmp_path):
    fits = Fits()
    metrics = train_seeds(fits, Run(tmp_path, seed=4), 3)
    assert [(run.seed, run.folder) for run in fits.runs] == [
        (4, tmp_path),
        (5, tmp_path / "seed-5"),
        (6, tmp_path / "seed-6"),
    ]
    assert metrics == json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["psnr"] == 24.0
    assert [each["psnr"] for each in metrics["seeds"].values()] == [24.0, 25.0, 26.0]


def test_trainings_that_are_no_longer_asked_for_are_not_lost_in_silence(tmp_path):
    train_seeds(Fits(), Run(tmp_path), 3)
    fits = Fits()
    said = r"\(seed-1, seed-2; repeats is 1\): move them away.*--fresh"
    with pytest.raises(RacinesError, match=said):
        train_seeds(fits, Run(tmp_path), 1)
    assert not fits.runs and len(repeat_folders(tmp_path)) == 2
    train_seeds(fits, Run(tmp_path, resume=False), 2)
    assert repeat_folders(tmp_path) == [tmp_path / "seed-1"], "as was asked for"


@pytest.mark.parametrize("resume", [None, True])
def test_a_killed_run_goes_on_with_the_seed_it_was_at(tmp_path, resume):
    with pytest.raises(KeyboardInterrupt):
        train_seeds(Fits(breaks_at=1), Run(tmp_path), 3)
    fits = Fits()
    metrics = train_seeds(fits, Run(tmp_path, resume=resume), 3)
    assert [run.seed for run in fits.runs] == [1, 2]
    assert [run.resume for run in fits.runs] == [resume, None]
    assert set(metrics["seeds"]) == {"0", "1", "2"}
    again = Fits()
    train_seeds(again, Run(tmp_path), 3)
    assert [run.seed for run in again.runs] == [0, 1, 2], "a finished run is made anew"


def test_fresh_begins_with_the_first(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        train_seeds(Fits(breaks_at=1), Run(tmp_path), 2)
    fits = Fits()
    train_seeds(fits, Run(tmp_path, resume=False), 2)
    assert [run.seed for run in fits.runs] == [0, 1]


def test_all_seeds_are_opened_and_hashed(store, tmp_path):
    train_seeds(lambda run: MeanImage().fit(store, run), Run(tmp_path, progress=False), 2)
    assert len(open_runs("mean-image", tmp_path)) == 2
    assert set(weights_of("mean-image", tmp_path)) == {
        "model.safetensors",
        "seed-1/model.safetensors",
    }


class Drawn:
    """Stands for a trained run."""

    def __init__(self, stochastic):
        self.card = type("Card", (), {"stochastic": stochastic})


def test_runs_and_drawing_seeds_take_turns():
    a, b, c, still = Drawn(True), Drawn(True), Drawn(True), Drawn(False)
    assert take_turns([a], (7, 8)) == [(a, 7), (a, 8)]
    assert take_turns([a, b], (7,)) == [(a, 7), (b, 8)]
    # One more than before: with sets of one training only, its interval would be of another n.
    assert take_turns([a, b], (0, 1, 2)) == [(a, 0), (b, 1), (a, 2), (b, 3)]
    assert take_turns([a, b, c], (0, 1, 2)) == [(a, 0), (b, 1), (c, 2)]
    assert take_turns([still, still], (0, 1, 2)) == [(still, 0), (still, 1)]
    assert take_turns([still], (0, 1, 2)) == [(still, 0)], "the same images thrice say nothing new"


def test_a_figure_is_the_mean_over_trainings_which_it_names(store):
    frames = store.take(store.split_indices("test"))
    sample = Sample(frames, torch.arange(len(frames.index)).numpy() // 4)
    black = torch.zeros_like(frames.images)
    sets = [frames.images, black]
    psnr = Scorer(ScoresConfig(), store, sample, sets, runs=2).likeness()["psnr"]
    assert psnr["settings"]["by_set"][0] == 100.0 > psnr["settings"]["by_set"][1]
    assert psnr["value"] == pytest.approx(sum(psnr["settings"]["by_set"]) / 2)
    assert psnr["settings"]["trainings"] == 2
    # Two sets of one training are one value; which each is, the evidence says.
    one = Scorer(ScoresConfig(), store, sample, sets)
    told = one.likeness()["psnr"]
    assert told["value"] == pytest.approx(psnr["value"]) and told["settings"]["trainings"] == 1
    assert "by_set" not in told["settings"]
    assert one.evidence.figures["psnr"].values.shape == (1, 2, len(frames.index))
    with pytest.raises(ValueError, match="3 sets of 2 trainings"):
        Scorer(ScoresConfig(), store, sample, [*sets, black], runs=2)
