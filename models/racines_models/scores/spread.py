"""Who draws and who looks at images, with their work given to an engine a batch at a time.

What comes back is what they give here: a generator, an extractor and a judge treat an image alike
at every place of every batch (`networks.batching`), on as many threads.
"""

import pickle
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from racines_data.engines import Engine
from racines_data.geometry import Pose
from racines_data.imaging import ImageSource
from racines_data.randomness import derive
from racines_data.store.frames import Batch
from racines_models.judges.grader.model import Grader
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.sample import CHUNK, DRAW, FrameSource, Progress, check_drawn, draw, drawn_of
from racines_models.scores.features import Extractor

BATCH = 128
"""Images of a task."""


def spread_draw(
    engine: Engine, generator: ImageSource, frames: Batch, seed: int,
    progress: Progress | None = None,
) -> Tensor:  # fmt: skip
    """Return what `sample.draw` does; whoever cannot be sent, such as an ONNX session, draws here.

    Raises:
        RacinesError: images that cannot be scored.
    """
    if isinstance(generator, FrameSource) or not can_be_sent(generator):
        return draw(generator, frames, seed, progress)
    seeds = derive(torch.full_like(frames.index, seed), DRAW, frames.index)
    tasks = zip(frames.parameters.split(CHUNK), seeds.split(CHUNK), strict=True)
    return check_drawn(_joined(engine.map(_draw, generator, tasks, threads=None), progress))


class SpreadExtractor:
    """An extractor whose batches are tasks."""

    def __init__(self, extractor: Extractor, engine: Engine) -> None:
        """Wrap an extractor; the engine is started."""
        self._extractor, self._engine, self.settings = extractor, engine, extractor.settings

    def __call__(self, images: Tensor, progress: Progress | None = None) -> Tensor:
        """Return (N, D) features of (N, 128, 128) uint8 images."""
        tasks = images.split(BATCH)
        return _joined(self._engine.map(_embed, self._extractor, tasks, threads=None), progress)


class SpreadGrader(Grader):
    """A grader whose batches are tasks."""

    def __init__(self, grader: Grader, engine: Engine) -> None:
        """Wrap a grader; the engine is started."""
        super().__init__(
            grader.network, grader.config, str(grader.device), grader.labels, grader.temperature
        )
        self.sha256, self._grader, self._engine = grader.sha256, grader, engine

    @property
    def settings(self) -> dict[str, Any]:
        """What its features depend on."""
        return self._grader.settings

    def judge(self, images: Tensor, batch_size: int = BATCH) -> tuple[Tensor, Tensor, Tensor]:
        """Return (N,) labels, (N,) grades and (N, D) features on the CPU."""
        tasks = images.split(batch_size)
        made = list(self._engine.map(_judge, self._grader, tasks, threads=None))
        labels, grades, features = (torch.cat(column) for column in zip(*made, strict=True))
        return labels, grades, features


class SpreadPose(PoseRegressor):
    """A pose regressor whose batches are tasks."""

    def __init__(self, regressor: PoseRegressor, engine: Engine) -> None:
        """Wrap a regressor; the engine is started."""
        super().__init__(regressor.network, regressor.config, str(regressor.device))
        self.sha256, self._regressor, self._engine = regressor.sha256, regressor, engine

    def predict(self, images: Tensor) -> Pose:
        """Return the poses, on the CPU, of (N, 128, 128) uint8 images."""
        tasks = images.split(BATCH)
        made = list(self._engine.map(_read, self._regressor, tasks, threads=None))
        return Pose(*(torch.cat(column) for column in zip(*made, strict=True)))


class SpreadOutlines(SegmentationJudge):
    """A segmentation judge whose batches are tasks."""

    def __init__(self, judge: SegmentationJudge, engine: Engine) -> None:
        """Wrap a judge; the engine is started."""
        super().__init__(judge.network, judge.config, str(judge.device))
        self.sha256, self._judge, self._engine = judge.sha256, judge, engine

    def segment(self, images: Tensor) -> Tensor:
        """Return the masks, on the CPU, of (N, 128, 128) uint8 images."""
        if not len(images):
            return self._judge.segment(images)
        tasks = images.split(BATCH)
        return torch.cat(list(self._engine.map(_outline, self._judge, tasks, threads=None)))


def _joined(parts: Iterator[Tensor], progress: Progress | None) -> Tensor:
    found = []
    for part in parts:
        found.append(part)
        if progress is not None:
            progress(len(part))
    return torch.cat(found)


def can_be_sent(value: Any) -> bool:
    """Return whether workers can be given a value; an ONNX session is none of theirs."""
    try:
        pickle.dumps(value)
    except (TypeError, AttributeError, RuntimeError, pickle.PicklingError):
        return False
    return True


def _draw(generator: ImageSource, task: tuple[Tensor, Tensor]) -> Tensor:
    return drawn_of(generator, *task)


def _embed(extractor: Extractor, images: Tensor) -> Tensor:
    return extractor(images)


def _judge(grader: Grader, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return grader.judge(images)


def _read(regressor: PoseRegressor, images: Tensor) -> Pose:
    return regressor.predict(images)


def _outline(judge: SegmentationJudge, images: Tensor) -> Tensor:
    return judge.segment(images)
