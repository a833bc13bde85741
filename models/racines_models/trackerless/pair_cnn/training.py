"""Training of `pair-cnn` by the trainer of the generators; its figures on validation sweeps."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.geometry import axis_angle_to_matrix, rotate
from racines_data.randomness import uniform
from racines_data.schema import SPLITS
from racines_models.protocol import Run
from racines_models.sample import evenly
from racines_models.statistics import figure
from racines_models.trackerless.motion import from_vectors, to_vectors
from racines_models.trackerless.pair_cnn.network import PairConfig, PairNetwork, windows
from racines_models.trackerless.sweeps import SweepSet
from racines_models.training.augmentation import augment
from racines_models.training.objective import Course, Feed, Update, rate_factor
from racines_models.training.trainer import train

LOOKED_AT = 1_024
"""Validation steps that are looked at while it trains."""
REVERSED = 51
"""Random stream: which pairs are shown last frame first."""


class PairBatch(NamedTuple):
    """B windows of W frames."""

    images: Tensor
    """(B, W, 128, 128) uint8."""
    motions: Tensor
    """(B, 6) float32, m and rad, of the last frame to the one before."""
    seeds: Tensor
    """(B,) int64."""


class Pairs:
    """All steps of a dataset's sweeps, by the row of the frame that moved."""

    def __init__(self, sweeps: SweepSet, window: int) -> None:
        self._store, self._window = sweeps.store, window
        count = len(sweeps.store.parameters)
        self._motions, self._first = torch.zeros(count, 6), torch.zeros(count, dtype=torch.int64)
        # Frames of a sweep need not lie side by side in the store: windows are taken among places.
        self._place, self._at = torch.zeros(count, dtype=torch.int64), torch.arange(0)
        self._rows = {name: torch.zeros(0, dtype=torch.int64) for name in SPLITS}
        for split in SPLITS:
            if sweeps.count(split):
                self._rows[split], motions = sweeps.steps(split)
                self._motions[self._rows[split]] = motions.float()
                for each in sweeps.rows(split):
                    self._first[each] = len(self._at)
                    self._place[each] = len(self._at) + torch.arange(len(each))
                    self._at = torch.cat([self._at, each])

    def split_indices(self, split: str) -> Tensor:
        """Return the (n,) rows of the frames that moved."""
        return self._rows[split]

    def motions(self, rows: Tensor) -> Tensor:
        """Return the (n, 6) true motions."""
        return self._motions[rows]

    def take(self, rows: Tensor, seeds: Tensor) -> PairBatch:
        """Return the windows that end at (B,) rows."""
        places = windows(self._place[rows], self._window, self._first[rows])
        images = self._store.take(self._at[places.flatten()]).images.view(*places.shape, 128, 128)
        return PairBatch(images, self._motions[rows], seeds)


class PairLearner(Course):
    """What the trainer needs; it feeds itself, since an example is more than one frame."""

    name = "pair-cnn"

    def __init__(self, sweeps: SweepSet, config: PairConfig, run: Run) -> None:
        if not sweeps.metric:
            raise RacinesError(
                f"pair-cnn: {sweeps.store.root}: positions of these data have no metres, which it "
                "learns to tell: import them with their scale"
            )
        self.pairs, self.config, self.device = Pairs(sweeps, config.window), config, run.device
        rows = self.pairs.split_indices("train")
        if not len(rows):
            raise RacinesError("pair-cnn: the train split has no sweeps with poses to learn from")
        size = config.training.batch_size
        self.feed = Feed(cast(Any, self.pairs), size, run.seed, run.device)
        known = {"config": asdict(config), "seed": run.seed, "data": dict(sweeps.card)}
        self.identity = {"name": self.name} | known
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            self.network = PairNetwork(config)
        self.network.fit_motions(self.pairs.motions(rows))
        self.network.to(run.device)
        self.points = _grid(config.reach).to(run.device)

    def modules(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {self.name: self.network}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return (self.name,)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return its AdamW."""
        rate, decay = self.config.learning_rate, self.config.weight_decay
        return {self.name: AdamW(self.network.parameters(), rate, weight_decay=decay, fused=True)}

    def rate(self, step: int) -> float:
        """Return the factor that the config's schedule and warm-up say."""
        return rate_factor(self.config.training, step * self.config.training.batch_size)

    def batches(self, start: int, stop: int) -> Iterator[PairBatch]:
        """Yield windows, their motions and seeds, on the device."""
        for rows, seeds in self.feed.rows(start, stop):
            batch = turned_round(self.pairs.take(rows, seeds), self.config.reverse)
            yield PairBatch(*(each.to(self.device) for each in batch))

    def updates(self, nets: Mapping[str, nn.Module], batch: PairBatch) -> Iterator[Update]:
        """Yield the one step: the mean distance, mm, of nine points of the plane."""
        x = self.network.normalise(batch.images)
        # Frames of a window are one examination: they are varied alike, by one seed.
        count, size = x.shape[:2]
        flat = x.flatten(0, 1).unsqueeze(1)
        varied = augment(flat, batch.seeds.repeat_interleave(size), self.config.augmentation)
        found = nets[self.name](varied.view(count, size, *x.shape[2:]))
        loss = point_errors(found, batch.motions, self.points).mean()
        yield Update(self.name, loss, {"points_mm": loss.detach()})

    @torch.no_grad()
    def look(self, seen: int, folder: Path) -> Mapping[str, float]:
        """Return the mean distance of the same points on some validation steps, mm."""
        errors = self.errors("validation", LOOKED_AT)
        return {} if errors is None else {"validation/points_mm": float(errors.mean())}

    @torch.no_grad()
    def errors(self, split: str, most: int = 0) -> Tensor | None:
        """Return the (n,) mean errors of the points, mm, of at most so many steps of a split."""
        rows = self.pairs.split_indices(split)
        if not len(rows):
            return None
        rows = rows[evenly(len(rows), most or len(rows))]
        parts = []
        for part in rows.split(256):
            batch = self.pairs.take(part, part)
            found = self.network(self.network.normalise(batch.images.to(self.device)))
            true = batch.motions.to(self.device)
            parts.append(point_errors(found.float(), true, self.points).mean(1).cpu())
        return torch.cat(parts)


def point_errors(found: Tensor, true: Tensor, points: Tensor) -> Tensor:
    """Return the (B, P) distances, mm, of (P, 3) points, m, moved by two (B, 6) motions."""
    apart = _moved(found, points) - _moved(true, points)
    return 1e3 * (apart.square().sum(-1) + 1e-12).sqrt()


def _moved(motions: Tensor, points: Tensor) -> Tensor:
    rotation = axis_angle_to_matrix(motions[:, 3:]).unsqueeze(1)
    return rotate(rotation, points) + motions[:, None, :3]


def _grid(reach: float) -> Tensor:
    """Return (9, 3) points, m, of a square in the image plane under the probe."""
    across = torch.tensor([-0.5, 0.0, 0.5]).repeat(3) * reach
    down = torch.tensor([0.0, 0.5, 1.0]).repeat_interleave(3) * reach
    return torch.stack([across, torch.zeros(9), down], -1)


def turned_round(batch: PairBatch, share: float) -> PairBatch:
    """Show a share of the windows last frame first, with the motion between those two undone.

    A window of more than two frames is turned as a whole, and so its last motion is another; those
    are left as they are.
    """
    if not share or batch.images.shape[1] > 2:
        return batch
    chosen = uniform(batch.seeds, 1, REVERSED)[:, 0] < share
    images = torch.where(chosen.view(-1, 1, 1, 1), batch.images.flip(1), batch.images)
    undone = to_vectors(torch.linalg.inv(from_vectors(batch.motions.double()))).float()
    motions = torch.where(chosen.unsqueeze(1), undone, batch.motions)
    return PairBatch(images, motions, batch.seeds)


def train_network(
    sweeps: SweepSet, config: PairConfig, run: Run
) -> tuple[PairNetwork, dict[str, Any]]:
    """Train; return the network, the trainer's figures, and the error on validation sweeps.

    Raises:
        RacinesError: no training sweeps, or `run.resume` is True and nothing can be resumed.
    """
    learner = PairLearner(sweeps, config, run)
    metrics: dict[str, Any] = {
        "training": train(learner, sweeps.store, config.training, run, learner)
    }
    learner.network.eval()
    errors = learner.errors("validation")
    if errors is not None:
        units = sweeps.units(learner.pairs.split_indices("validation"))
        told = figure("mean", errors.numpy(), "mm", 0.0, np.inf, units)
        metrics |= {"split": "validation", "metrics": {"points_mm": told}}
    return learner.network, metrics
