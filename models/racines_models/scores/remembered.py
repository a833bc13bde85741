"""Judges that look at no image twice: strata are parts of what was looked at whole.

A judge treats an image alike at every place of every batch (`networks.batching`): what it has said
of an image it would say again, to the last bit.
"""

import hashlib
from collections.abc import Callable, Iterable

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge

Rows = tuple[Tensor, ...]


class RememberedPose(PoseRegressor):
    """A pose regressor that looks at no image twice."""

    def __init__(self, regressor: PoseRegressor) -> None:
        """Wrap a regressor."""
        super().__init__(regressor.network, regressor.config, str(regressor.device))
        self.sha256, self._regressor = regressor.sha256, regressor
        self._known: dict[bytes, Rows] = {}

    def predict(self, images: Tensor) -> Pose:
        """Return the poses, on the CPU, of (N, 128, 128) uint8 images."""
        if not len(images):
            return self._regressor.predict(images)
        return Pose(*_looked_up(images, self._known, self._regressor.predict))


class RememberedOutlines(SegmentationJudge):
    """A segmentation judge that looks at no image twice."""

    def __init__(self, judge: SegmentationJudge) -> None:
        """Wrap a judge."""
        super().__init__(judge.network, judge.config, str(judge.device))
        self.sha256, self._judge = judge.sha256, judge
        self._known: dict[bytes, Rows] = {}

    def segment(self, images: Tensor) -> Tensor:
        """Return the masks, on the CPU, of (N, 128, 128) uint8 images."""
        if not len(images):
            return self._judge.segment(images)
        (masks,) = _looked_up(images, self._known, lambda new: (self._judge.segment(new),))
        return masks


def _looked_up(
    images: Tensor, known: dict[bytes, Rows], look: Callable[[Tensor], Iterable[Tensor]]
) -> Rows:
    """Return the columns that `look` gives of images, of new ones alone, which become known."""
    keys = [hashlib.sha256(image.numpy().tobytes()).digest() for image in images]
    new = {key: row for row, key in enumerate(keys) if key not in known}
    if new:
        found = look(images[list(new.values())])
        known |= dict(zip(new, zip(*found, strict=True), strict=True))
    return tuple(torch.stack(column) for column in zip(*(known[key] for key in keys), strict=True))
