"""Scores on turns about the apex: by the angle to training, and what a real recording allows.

    drawn        the image of a test pose and phase              against the true frame there
    neighbour    the real frame of the next turn, same phase     likewise: the bound
    train        the real frame of the nearest training turn     likewise: the leak

Neighbouring turns show nearly the same slice, drawn by the same scanner at the same phase of
another beat: nothing that is drawn can be expected to be nearer to a frame than they are. The
nearest training turn is found by the angle alone, modulo half a turn, and its frame is mirrored
where it looks from the other side: what a model that only looks up could hand back.

Strata are of the angle from a test turn to the nearest training turn.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from racines_data.geometry import parameters_to_pose
from racines_data.store.frames import FrameStore
from racines_models.scores import metrics
from racines_models.scores.features import Extractor, reference_features
from racines_models.scores.scorer import AMOUNT, ANY, Scorer

EDGES = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 90.0)
"""Degrees between strata."""
HALF = 180.0
"""Degrees after which a plane is the same again, mirrored."""
_LATE = 1e4
"""Degrees that a beat weighs against an angle: a frame of the same phase is nearest."""
_RULES = {
    "neighbour": "the real frame of the next turn, at the same phase",
    "train": "the real frame of the nearest training turn, at the same phase",
}


def apart(one: Tensor, other: Tensor) -> Tensor:
    """Return the degrees, 0 to 90, between angles of turns, which count modulo 180."""
    return (torch.remainder(one - other + HALF / 2, HALF) - HALF / 2).abs()


def _late(store: FrameStore, rows: Tensor, others: Tensor) -> Tensor:
    """Return the (N, M) degrees that a difference of phases counts."""
    if store.phases is None:
        return torch.zeros(len(rows), len(others), dtype=torch.float64)
    off = (store.phases[rows, 0, None] - store.phases[others, 0]).abs()
    return _LATE * torch.minimum(off, 1.0 - off)


def next_turns(store: FrameStore, rows: Tensor) -> Tensor:
    """Return the (N,) rows of the nearest other turn in rotation, at the phase of (N,) rows."""
    every = torch.arange(len(store))
    turn = parameters_to_pose(store.parameters[:, :12].double()).rotation.flatten(1)
    chord = torch.cdist(turn[rows], turn, compute_mode="donot_use_mm_for_euclid_dist")
    cost = torch.rad2deg(2.0 * torch.asin((chord / 8.0**0.5).clamp_max(1.0)))
    same = store.trajectory_index[rows, None] == store.trajectory_index
    cost = (cost + _late(store, rows, every)).masked_fill(same, torch.inf)
    return cost.argmin(1)


def training_frames(store: FrameStore, rows: Tensor) -> Tensor:
    """Return (N, 128, 128) frames of the nearest training turns by angle, mirrored where needed."""
    assert store.turns is not None
    train = store.split_indices("train")
    cost = apart(store.turns[rows, 0, None], store.turns[train, 0]) + _late(store, rows, train)
    found = train[cost.argmin(1)]
    images = store.take(found).images
    across = parameters_to_pose(store.parameters[:, :12]).rotation[..., 0]
    behind = (across[rows] * across[found]).sum(-1) < 0
    return torch.where(behind[:, None, None], images.flip(-1), images)


def turn_figures(
    scorer: Scorer, extractor: Extractor, judge: Extractor | None = None
) -> dict[str, Any]:
    """Return the distance in features of drawn to true frames, the bound, and the leak.

    `feature_distance` is the mean Euclidean distance of the features of a drawn image and of the
    true frame at its pose and phase. `…_neighbour` and `…_train` say of the real frames what the
    figures of the same name say of drawn ones.

    Args:
        scorer: of a sample of turns.
        extractor: of published features.
        judge: whose features give `feature_distance_grader`, the same distance again.
    """
    rows = scorer.sample.frames.index
    true, drawn = scorer.features(extractor)
    figures = {"feature_distance": _distance(scorer, "feature_distance", true, drawn, extractor)}
    if judge is not None:
        name = "feature_distance_grader"
        figures[name] = _distance(scorer, name, *scorer.features(judge), judge)
    real = {
        "neighbour": scorer.store.take(next_turns(scorer.store, rows)).images,
        "train": training_frames(scorer.store, rows),
    }
    for name, images in real.items():
        key, rule = [scorer.store.manifest["digest"], name, rows.tolist()], _RULES[name]
        held = reference_features(extractor, images, key, scorer.cache)
        figures |= {
            f"ssim_{name}": _likeness(scorer, f"ssim_{name}", metrics.ssim, images, rule),
            f"psnr_{name}": _likeness(scorer, f"psnr_{name}", metrics.psnr, images, rule),
            f"feature_distance_{name}": _distance(
                scorer, f"feature_distance_{name}", true, [held], extractor, rule=rule
            ),
        }
        found = scorer.of_sets([scorer.fid_and_kid(true, held)], scorer.sample.trajectory)
        for key, ends in (("fid", AMOUNT), ("kid", ANY)):
            told = {"features": extractor.settings["id"], "rule": rule}
            figures[f"{key}_{name}"] = scorer.of_set(f"{key}_{name}", found[key], ends, **told)
    return figures


def _likeness(
    scorer: Scorer, name: str, metric: Callable[[Tensor, Tensor], Tensor], images: Tensor, rule: str
) -> dict[str, Any]:
    ends, unit = (-1.0, 1.0), None
    if name.startswith("psnr"):
        ends, unit = (0.0, metrics.PSNR_CAP), "dB"
    values = scorer.measure(name, metric, [images])
    return scorer.of_frames(name, "mean", values, ends, unit, rule=rule)


def _distance(
    scorer: Scorer,
    name: str,
    true: Tensor,
    sets: Sequence[Tensor],
    extractor: Extractor,
    **rule: str,
) -> dict[str, Any]:
    values = [(each.double() - true.double()).norm(dim=1) for each in sets]
    told = {"features": extractor.settings["id"], **rule}
    return scorer.of_frames(name, "mean", values, AMOUNT, **told)


def by_angle(scorer: Scorer, extractor: Extractor) -> dict[str, dict[str, Any]]:
    """Return SSIM, PSNR, distance in features, bound and leak, by the angle to training.

    FID and KID of a stratum are left out: they are biased by how few frames it has.
    """
    store, rows = scorer.store, scorer.sample.frames.index
    assert store.turns is not None
    angle = store.turns[rows, 1]
    told = {}
    for low, high in zip(EDGES, EDGES[1:], strict=False):
        places = ((angle >= low) & (angle < high)).nonzero().squeeze(1)
        if len(places) < 2:
            continue
        part = scorer.part(places)
        found = part.likeness() | turn_figures(part, extractor)
        told[f"{low:g}-{high:g}°"] = {key: each for key, each in found.items() if key in BY_ANGLE}
    return told


BY_ANGLE = tuple(
    f"{key}{of}"
    for key in ("ssim", "psnr", "feature_distance")
    for of in ("", "_neighbour", "_train")
)
"""Figures that are told of each stratum."""
