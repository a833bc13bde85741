"""Training of the segmentation judge, by the trainer of the generators; its report."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_models.devices import resolve_device
from racines_models.judges.segmentation.frames import Masked, MaskSet
from racines_models.judges.segmentation.model import (
    SegmentationConfig,
    SegmentationJudge,
    SegmentationNetwork,
)
from racines_models.judges.segmentation.overlap import dice, overlap_figures
from racines_models.judges.segmentation.structures import relabel, to_structures
from racines_models.protocol import Run
from racines_models.provenance import code_version, environment
from racines_models.sample import evenly
from racines_models.training.augmentation import augment, strengthen
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.objective import Course, Feed, Update, rate_factor
from racines_models.training.trainer import train

LOOKED_AT = 128
"""Validation frames that are looked at while it trains."""


class SegmentationLearner(Course):
    """What the trainer needs of the judge; it feeds itself, since masks go with its images."""

    name = "segmentation"

    def __init__(self, frames: MaskSet, config: SegmentationConfig, run: Run) -> None:
        from monai.losses.dice import DiceLoss

        size = config.training.batch_size
        self.feed = Feed(cast(Any, frames), size, run.seed, run.device)
        self.frames, self.config, self.device = frames, config, run.device
        known = {"config": asdict(config), "seed": run.seed, "data": dict(frames.card)}
        self.identity = {"name": self.name} | known
        self.table = to_structures(frames.labels, config.structures).to(run.device)
        # Over a batch: a structure is absent from many a frame.
        self.dice = DiceLoss(False, to_onehot_y=True, softmax=True, batch=True)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            self.network = SegmentationNetwork(config).to(run.device)

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

    def batches(self, start: int, stop: int) -> Iterator[tuple[Masked, Tensor]]:
        """Yield frames with masks, and the (B,) seeds of their augmentation, on the device."""
        for index, seeds in self.feed.rows(start, stop):
            taken = (each.to(self.device) for each in self.frames.take(index))
            yield Masked(*taken), seeds.to(self.device)

    def updates(
        self, nets: Mapping[str, nn.Module], batch: tuple[Masked, Tensor]
    ) -> Iterator[Update]:
        """Yield the one step: soft Dice (Milletari et al., 2016) and cross-entropy, even parts."""
        frames, seeds = batch
        x = augment(self.network.normalise(frames.images), seeds, self.config.augmentation)
        masks = relabel(frames.masks, self.table)
        x, moved = strengthen(x, seeds, self.config.strong, masks)
        truth = cast(Tensor, moved)
        logits = nets[self.name](x)
        logged = {
            "dice": self.dice(logits, truth.unsqueeze(1)),
            "entropy": nn.functional.cross_entropy(logits, truth.long()),
        }
        yield Update(self.name, logged["dice"] + logged["entropy"], logged)

    def look(self, seen: int, folder: Path) -> Mapping[str, float]:
        """Return the mean Dice of the structures on some validation frames."""
        rows = self.frames.split_indices("validation")
        if not len(rows):
            return {}
        frames = self.frames.take(rows[evenly(len(rows), LOOKED_AT)])
        with torch.inference_mode():
            parts = frames.images.to(self.device).split(self.config.training.batch_size)
            found = [self.network(self.network.normalise(part)).argmax(1).cpu() for part in parts]
        truth = relabel(frames.masks, self.table.cpu())
        values = dice(torch.cat(found).to(torch.uint8), truth, len(self.config.structures))
        mean = float(values.nanmean())
        return {"validation/dice": mean} if np.isfinite(mean) else {}


def train_segmentation(frames: MaskSet, config: SegmentationConfig, run: Run) -> dict[str, Any]:
    """Train, save into `run.folder`, and return the metrics on the test patients.

    Raises:
        RacinesError: no training frames, masks without a structure that is asked for, or
            `run.resume` is True and nothing can be resumed.
    """
    if not len(frames.split_indices("train")):
        raise RacinesError("segmentation: the train split is empty; build a dataset with more")
    run = replace(run, device=resolve_device(run.device))
    learner = SegmentationLearner(frames, config, run)
    figures = train(learner, cast(Any, frames), config.training, run, learner)
    judge = SegmentationJudge(learner.network, config, run.device)
    made = {"dataset": dict(frames.card), "seed": run.seed, "code": code_version()}
    judge.save(run.folder, **made)
    metrics = {"schema": "racines.segmentation-metrics/1"} | made | report(judge, frames)
    metrics |= {"training": figures, "environment": environment(run.device)}
    write_json(run.folder / "metrics.json", metrics)
    discard_checkpoint(run.folder)
    return metrics


def report(judge: SegmentationJudge, frames: MaskSet, split: str = "test") -> dict[str, Any]:
    """Outline a split and compare with its masks.

    Returns:
        `split`; `metrics`: `dice_…` and `false_…` by structure (see `overlap`), with value, low,
        high, n, over patients; `by`: the same for each stratum, by kind and name.
    """
    rows = frames.split_indices(split)
    if not len(rows):
        return {"split": split, "metrics": {}, "by": {}}
    taken, table = frames.take(rows), to_structures(frames.labels, judge.structures)
    found, truth = judge.segment(taken.images), relabel(taken.masks, table)
    patients = frames.patients[rows.numpy()]

    def figures(some: np.ndarray) -> dict[str, Any]:
        at = torch.from_numpy(some)
        return overlap_figures(found[at], truth[at], judge.structures, patients[some])

    by: dict[str, Any] = {}
    for kind, names in frames.strata.items():
        name = np.array(names)[rows.numpy()]
        by[kind] = {str(each): figures(np.flatnonzero(name == each)) for each in np.unique(name)}
    return {"split": split, "metrics": figures(np.arange(len(rows))), "by": by}
