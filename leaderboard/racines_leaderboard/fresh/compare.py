"""How near an entry's images are to the truth, beside the truth drawn again; and which are copies.

What is nearest to a frame without knowing that frame's noise is the mean of all scans of its pose:
it has half the squared error of a second scan, 3 dB of PSNR. An honest generator that averages its
noise comes close to it; what is nearer still has seen the frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.store.frames import Batch, FrameStore
from racines_leaderboard.fresh.frames import AllFrames, scan_again
from racines_models.generators.mean_image import MeanImage
from racines_models.protocol import Run
from racines_models.sample import Sample, draw
from racines_models.scores import diversity
from racines_models.scores.features import kept
from racines_models.scores.metrics import psnr, ssim
from racines_models.scores.scoring import take_turns
from racines_models.statistics.intervals import Interval, difference, mean_replicates

NEAR = {"ssim": ssim, "psnr": psnr}
"""What says how near an image is to the frame at its pose."""
SCANS = 16
"""Scans whose mean stands for the mean of all; a sixteenth of one scan's noise is left in it."""
SHARE = 0.1
"""Of the distance from the mean image to the truth drawn again: how much an entry may lose on fresh
frames beyond the interval. Whoever chose among many variants by their public scores loses a little
of what chance gave the best; so little that it would not change what the entry is worth."""


class Remembered:
    """A generator that keeps what it drew, so that it is scored and compared by the same images."""

    def __init__(self, source: Any) -> None:
        self.source = source
        self._drawn: dict[tuple[int, bytes], Tensor] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def draw_frames(self, frames: Batch, seed: int) -> Tensor:
        """Return the (N, 128, 128) images of N frames, drawn once."""
        key = seed, frames.index.numpy().tobytes()
        if key not in self._drawn:
            self._drawn[key] = draw(self.source, frames, seed)
        return self._drawn[key]


@dataclass(frozen=True)
class Side:
    """One set of frames, public or fresh, and the images that an entry drew of it."""

    store: FrameStore
    sample: Sample
    runs: list[list[Tensor]]
    """(N, 128, 128) sets of each training of the entry, one or more."""

    @classmethod
    def drawn(
        cls, store: FrameStore, sample: Sample, sources: Sequence[Any], seeds: Sequence[int]
    ) -> "Side":
        """Let an entry's trainings draw a sample with seeds in turn, as they are scored."""
        runs: dict[int, list[Tensor]] = {id(each): [] for each in sources}
        for each, seed in take_turns(sources, seeds):
            runs[id(each)].append(draw(each, sample.frames, seed))
        return cls(store, sample, list(runs.values()))

    def near(self, sets: Sequence[Tensor]) -> dict[str, np.ndarray]:
        """Return how near some (N, 128, 128) images are to the frames, (N,) means over the sets."""
        truth = self.sample.frames.images
        return {
            name: torch.stack([metric(each, truth) for each in sets]).double().mean(0).numpy()
            for name, metric in NEAR.items()
        }

    def nearer(self, seeds: Sequence[int]) -> dict[str, Interval]:
        """Return by how much the entry is nearer to the truth than the truth drawn again.

        Drawn again is one scan, or the mean of all (see the module), whichever is nearer. Paired by
        frame, with trajectories as units; of several trainings the one that is most surely nearer.
        """
        scans = scan_again(self.store, self.sample.frames, seeds)
        mean = torch.stack([each.float() for each in scans]).mean(0).round().to(torch.uint8)
        ceilings = [self.near([scans[0]]), self.near([mean])]
        found = {}
        for name in NEAR:
            truth = max((each[name] for each in ceilings), key=np.mean)
            apart = [self._apart(self.near(sets)[name], truth) for sets in self.runs]
            found[name] = max(apart, key=lambda each: -np.inf if each.low is None else each.low)
        return found

    def margins(self, seed: int) -> dict[str, float]:
        """Return how far each measure may fall on fresh frames (see `SHARE`)."""
        floor = MeanImage()
        floor.learn(self.store, Run(Path(), progress=False))
        lowest = self.near([draw(floor, self.sample.frames, 0)])
        highest = self.near(scan_again(self.store, self.sample.frames, [seed]))
        return {name: SHARE * float(abs(highest[name].mean() - lowest[name].mean()))
                for name in NEAR}  # fmt: skip

    def copies(self, public: FrameStore, cache: Path | None = None) -> Interval:
        """Return the share of images that are frames of a dataset, above that of the frames here.

        An image is one of them where it differs by less than `diversity.COPY` gray levels.
        """
        every = AllFrames(public.root, public.config)
        key = ["all summaries", public.manifest["digest"], diversity.BLOCK]
        summaries = kept(cache, key, lambda: diversity.summarise_train(every).half())

        def share(images: Tensor) -> np.ndarray:
            return (diversity.nearest_train(images, every, summaries) < diversity.COPY).numpy()

        by_run = [np.mean([share(each) for each in sets], axis=0) for sets in self.runs]
        apart = [self._apart(each, share(self.sample.frames.images)) for each in by_run]
        return max(apart, key=lambda each: each.value)

    def _apart(self, ours: np.ndarray, theirs: np.ndarray) -> Interval:
        units = self.sample.trajectory
        return difference(mean_replicates(ours, units), mean_replicates(theirs, units))
