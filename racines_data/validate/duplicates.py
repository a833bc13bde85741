"""Near-copies of training frames in validation and test.

A frame's *signature* is its 16 x 16 block means: speckle of one block averages out, what stays is
the picture. The distance of two frames is the root mean square of the difference, in gray levels.
The yardstick is the distance of two consecutive frames of a sweep with the probe at rest: a frame
nearer than that to some training frame tells a model nothing new.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import geodesic, parameters_to_pose
from racines_data.validate.survey import Survey

NEAR_LIMIT = 0.5
"""Largest share of near-copies, as a part of what a random split of frames has. Sweeps over one
block cross now and then, the more of them the more often: that is no fault of the split."""
NEAR_FLOOR = 0.02  # a share of near-copies that is never too large
REST = (0.0005, 0.0087)
"""The probe is at rest if it moves less between two frames: m, rad (0.5 mm, 0.5 degrees)."""
EMPTY = 0.5  # a frame darker than this share of the upper quartile of brightness shows no tissue
COMPARED = 4096  # held-out frames of the random frame split that is given for comparison
QUERIES, KEYS = 1024, 32_768  # frames compared at a time: bounds the distances at 134 MB


@dataclass(frozen=True)
class Duplicates:
    """Copies of training frames among the held-out ones."""

    held_out: int  # frames of validation and test that show tissue
    exact: int  # those whose pixels are those of a training frame
    near: (
        float | None
    )  # share nearer to a training frame than `threshold`; None: nothing to compare
    near_frame_split: float | None  # the same share if the frames had been split at random
    threshold: float | None  # median distance of two consecutive frames at rest, gray levels
    median: float | None  # median distance to the nearest training frame, gray levels
    empty: int  # those that show no tissue are not compared: nothing looks like nothing


def find_duplicates(survey: Survey) -> Duplicates:
    """Compare every frame of validation and test with all training frames."""
    signatures = torch.from_numpy(survey.column("signatures")).float()
    train = torch.from_numpy(survey.each("split") == "train")
    shows = _shows_tissue(signatures)
    tested = ~train & shows
    hashes = survey.column("hashes")
    exact = np.isin(hashes[tested.numpy()], np.unique(hashes[train.numpy()]))
    empty = int((~train & ~shows).sum())
    threshold = _at_rest(survey, signatures, shows)
    keys = signatures[train & shows]
    held_out, copies = int(tested.sum()), int(exact.sum())
    if not len(keys) or not held_out or threshold is None:
        return Duplicates(held_out, copies, None, None, threshold, None, empty)
    distance = nearest_distance(signatures[tested], keys)
    near = float((distance < threshold).float().mean())
    by_frame = _frame_split(signatures[shows], len(keys), threshold)
    median = float(distance.median())
    return Duplicates(held_out, copies, near, by_frame, threshold, median, empty)


def _shows_tissue(signatures: Tensor) -> Tensor:
    # Without contact there is the near field's reverberation and darkness below it.
    brightness = signatures[:, signatures.shape[1] // 4 :].mean(1)
    return brightness >= EMPTY * brightness.quantile(0.75) if len(brightness) else brightness > 0


def _at_rest(survey: Survey, signatures: Tensor, shows: Tensor) -> float | None:
    """Return the median distance of consecutive frames at rest; None where none is at rest."""
    index = torch.repeat_interleave(torch.tensor([len(sweep) for sweep in survey.sweeps]))
    pairs = (index[1:] == index[:-1]) & shows[1:] & shows[:-1]
    pose = parameters_to_pose(torch.from_numpy(survey.column("parameters")).double())
    moved = (pose.position[1:] - pose.position[:-1]).norm(dim=-1)
    turned = geodesic(pose.rotation[1:], pose.rotation[:-1])
    rest = pairs & (moved < REST[0]) & (turned < REST[1])
    chosen = rest.nonzero()[:, 0]
    if not len(chosen):
        return None
    return float((signatures[chosen + 1] - signatures[chosen]).square().mean(1).sqrt().median())


def _frame_split(signatures: Tensor, train: int, threshold: float) -> float:
    """Return the share of near-copies had as many frames been drawn for training at random."""
    order = torch.randperm(len(signatures), generator=torch.Generator().manual_seed(0))
    held_out = order[train:][:COMPARED]
    distance = nearest_distance(signatures[held_out], signatures[order[:train]])
    return float((distance < threshold).float().mean())


def nearest_distance(queries: Tensor, keys: Tensor) -> Tensor:
    """Return the (Q,) RMS distance of (Q, D) signatures to the nearest of (K, D) others."""
    centre = keys.mean(0)
    keys, queries = keys - centre, queries - centre  # small numbers: the squares stay exact
    norms = keys.square().sum(1)
    found = []
    for query in queries.split(QUERIES):
        nearest = query.new_full((len(query),), torch.inf)
        for key, norm in zip(keys.split(KEYS), norms.split(KEYS), strict=True):
            nearest = torch.minimum(nearest, torch.addmm(norm, query, key.T, alpha=-2.0).amin(1))
        found.append(nearest + query.square().sum(1))
    return (torch.cat(found).clamp_min(0.0) / keys.shape[1]).sqrt()


def check_exact(found: Duplicates) -> str:
    """Check that no held-out frame is a training frame."""
    if found.exact:
        raise RacinesError(
            f"{found.exact} of {found.held_out} held-out frames are copies of training frames"
        )
    empty = f"; {found.empty} frames without tissue left out" if found.empty else ""
    return f"none of {found.held_out} held-out frames is a copy of a training frame{empty}"


def check_near(found: Duplicates) -> str:
    """Check the share of near-copies."""
    if found.near is None:
        return "not told: no probe is at rest, or there is no frame to compare with"
    by_frame = found.near_frame_split or 0.0
    limit = max(NEAR_LIMIT * by_frame, NEAR_FLOOR)
    said = (
        f"{found.near:.1%} of {found.held_out} held-out frames are nearer to a training frame "
        f"than two frames at rest ({found.threshold:.2f} gray levels); {by_frame:.1%} under a "
        f"random split of frames; limit {limit:.1%}"
    )
    if found.near > limit:
        raise RacinesError(said)
    return said
