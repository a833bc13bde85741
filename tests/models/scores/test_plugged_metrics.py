"""Metrics of other packages: their values, their intervals, and what is refused."""

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.sample import take_sample
from racines_models.scores import scorer as module
from racines_models.scores.plugin import Metric
from racines_models.scores.scorer import Scorer, ScoresConfig
from tests.models.labelled import LabelledStore


class Mean:
    """An extractor: the mean gray, and nothing else."""

    settings = {"id": "mean"}

    def __call__(self, images):
        return images.double().mean((1, 2))[:, None]


def _dark(drawn, truth):
    assert torch.equal(drawn.parameters, truth.parameters) and len(drawn.images) == len(
        truth.images
    )
    return (truth.images.double() - drawn.images.double()).mean((1, 2))


@pytest.fixture
def judge() -> Scorer:
    store = LabelledStore()
    sample = take_sample(store, "test", 12)
    darker = [(sample.frames.images // 2), torch.zeros_like(sample.frames.images)]
    return Scorer(ScoresConfig(), store, sample, darker)


def plug(monkeypatch: pytest.MonkeyPatch, *metrics: Metric) -> None:
    monkeypatch.setattr(module, "installed_metrics", lambda: list(metrics))


def test_values_are_means_over_sets_with_an_interval(judge, monkeypatch):
    plug(monkeypatch, Metric("dark", "Dark", "lower", _dark, unit="gray", rule="how dark"))
    told = judge.plugged(Mean())["dark"]
    truth = judge.sample.frames.images
    expected = torch.stack([_dark(judge.sample.frames._replace(images=each), judge.sample.frames)
                            for each in judge.drawn]).mean()  # fmt: skip
    assert told["value"] == pytest.approx(float(expected)) and told["n"] == len(truth)
    assert told["low"] <= told["value"] <= told["high"]
    assert (told["unit"], told["settings"]["rule"]) == ("gray", "how dark")


def test_a_name_that_is_taken_and_a_wrong_shape_are_refused(judge, monkeypatch):
    plug(monkeypatch, Metric("ssim", "Mine", "higher", _dark))
    with pytest.raises(RacinesError, match="metric 'ssim': rename it"):
        judge.plugged(Mean(), {"ssim": {}})
    plug(monkeypatch, Metric("one", "One", "higher", lambda drawn, truth: 1.0))
    with pytest.raises(RacinesError, match="metric 'one': it has to give one value an image"):
        judge.plugged(Mean())
