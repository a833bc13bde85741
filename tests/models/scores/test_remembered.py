"""Judges that remember say of each image what they would say of it anew."""

import pytest
import torch
from torch import Tensor

from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
from racines_models.judges.segmentation.model import (
    SegmentationConfig,
    SegmentationJudge,
    SegmentationNetwork,
)
from racines_models.scores.remembered import RememberedOutlines, RememberedPose


@pytest.fixture
def images() -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, (7, 128, 128), generator=generator, dtype=torch.uint8)


@pytest.mark.parametrize("kind", ["pose", "outlines"])
def test_what_was_seen_is_not_looked_at_again_and_is_the_same(images, kind, monkeypatch):
    torch.manual_seed(0)
    if kind == "pose":
        judge = PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125))
        kept, method = RememberedPose(judge), "predict"
    else:
        config = SegmentationConfig(input_size=64, channels=2)
        judge = SegmentationJudge(SegmentationNetwork(config), config)
        kept, method = RememberedOutlines(judge), "segment"
    judge.sha256 = "ab" * 32
    look, seen = getattr(judge, method), []

    def counted(asked: Tensor):
        seen.append(len(asked))
        return look(asked)

    monkeypatch.setattr(judge, method, counted)
    for rows in ([0, 1, 2, 1], [2, 0], [3, 1, 6, 3, 5], []):
        asked = images[torch.tensor(rows, dtype=torch.int64)]
        said, anew = getattr(kept, method)(asked), look(asked)
        pairs = [(said, anew)] if isinstance(said, Tensor) else zip(said, anew, strict=True)
        for told, own in pairs:
            assert told.dtype == own.dtype and torch.equal(told, own)
    assert seen == [3, 3, 0]
    every = look(images)
    every = every if isinstance(every, Tensor) else every.position
    assert len(every.flatten(1).unique(dim=0)) == len(images), "the judge tells them apart"
