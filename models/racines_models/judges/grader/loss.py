"""What the grader's training minimises: masked losses, class weights, schedule."""

import math

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.store.frames import FrameStore

WARM_UP = 0.1
"""Share of a stage in which the learning rate rises."""


def view_loss(logits: Tensor, views: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted cross-entropy of (B, L) logits over the frames with a view (not -1)."""
    loss = functional.cross_entropy(logits, views, weights, ignore_index=-1, reduction="sum")
    total = weights[views.clamp_min(0)].mul(views >= 0).sum()
    return loss / total.clamp_min(1e-6)


def grade_loss(grade: Tensor, target: Tensor) -> Tensor:
    """Return the smooth L1 loss of (B,) grades over the frames with a grade (not NaN)."""
    present = target.isfinite()
    error = functional.smooth_l1_loss(grade, target.nan_to_num(0.0), reduction="none", beta=1.0)
    return (error * present).sum() / present.sum().clamp_min(1)


def class_weights(store: FrameStore, power: float) -> Tensor:
    """Return (labels,) weights, the train frequencies to minus `power`, of mean one over frames."""
    views = store.views[store.split_indices("train")]
    count = torch.bincount(views[views >= 0], minlength=len(store.labels)).float()
    weights = count.clamp_min(1.0).pow(-power)
    return weights * count.sum() / (weights * count).sum()


def learning_rate(peak: float, progress: float) -> float:
    """Rise linearly to the peak, then fall as a cosine to zero; progress in 0-1."""
    if progress < WARM_UP:
        return peak * (progress + 1e-3) / (WARM_UP + 1e-3)
    return peak * 0.5 * (1.0 + math.cos(math.pi * (progress - WARM_UP) / (1.0 - WARM_UP)))
