"""How real the phantom looks: its A4C frames beside real ones, and real ones beside each other.

A distance to real frames means nothing alone. So each figure stands beside the same figure of two
halves of the real set, split by patient, at equal n: a perfect simulator would reach that.
"""

import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import MULTI_PHANTOM
from racines_data.store.frames import FrameStore
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress
from racines_models.scores import metrics
from racines_models.scores.features import Extractor
from racines_models.studies.realism.figures import RULES, Sector, Summary, description, differences

SCHEMA = "racines.realism/1"


@dataclass(frozen=True)
class RealismConfig:
    """How the phantom's frames are held beside real ones."""

    real: str = ""
    """Parquet of real frames: columns `patient`, `image` (128 x 128 8-bit PNG)."""
    frames: int = 125
    """Frames of each set, fewer where there are fewer patients or frames."""
    view: str = "A4C"
    grade: float = 5.0
    """Frames of the view below this grade are left out: nobody would keep them."""
    splits: int = 20
    """Random halves of the real patients, one frame each; figures are means over them."""
    support: float = 0.9
    """A pixel is in the real sector if it is not black in this share of the real frames."""
    seed: int = 0


class RealFrames(NamedTuple):
    """Real frames for comparison."""

    images: Tensor
    """(N, 128, 128) uint8."""
    patient: np.ndarray
    """(N,) integer."""
    sha256: str


class Realism(NamedTuple):
    """The report, and the frames it speaks of, as they were before masking."""

    content: dict[str, Any]
    real: Tensor
    phantom: Tensor


def read_real(path: Path) -> RealFrames:
    """Read real frames from a Parquet file, as `RealismConfig.real` describes it."""
    import polars as pl

    if not path.is_file():
        raise RacinesError(f"{path}: no such file; realism needs real frames, see docs/scores.md")
    try:
        table = pl.read_parquet(path, columns=["patient", "image"])
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RacinesError(f"{path}: no Parquet with columns patient and image: {error}") from error
    arrays = [np.asarray(Image.open(io.BytesIO(png)).convert("L")) for png in table["image"]]
    if any(array.shape != (IMAGE_SIZE, IMAGE_SIZE) for array in arrays):
        raise RacinesError(f"{path}: images are not all {IMAGE_SIZE} x {IMAGE_SIZE}")
    patient = np.unique(table["patient"].to_numpy(), return_inverse=True)[1]
    return RealFrames(torch.from_numpy(np.stack(arrays)), patient, sha256_file(path))


def take_phantom(store: FrameStore, config: RealismConfig) -> Tensor:
    """Return (n, 128, 128) frames of the view; see `choose_rows`."""
    return store.take(choose_rows(store, config)).images


def choose_rows(store: FrameStore, config: RealismConfig) -> Tensor:
    """Return the (n,) rows of the frames of the view to compare, two or more, of all splits.

    Hearts have equal shares, as far as each has frames; the frames of one are at even distances.
    """
    if config.view not in store.labels:
        raise RacinesError(
            f"realism.view {config.view}: the dataset's views are {', '.join(store.labels)}; name "
            "no real frames where there are none of this organ (realism: {})"
        )
    of_view = store.views == store.labels.index(config.view)
    rows = (of_view & (store.grades >= config.grade)).nonzero()[:, 0]
    if len(rows) < 2:
        raise RacinesError(
            f"realism: {len(rows)} frames of {config.view} with grade >= {config.grade:g} in the "
            "dataset; lower realism.grade or build more frames"
        )
    return _spread(rows, _hearts(store)[rows], min(config.frames, len(rows)))


def _hearts(store: FrameStore) -> Tensor:
    """Return the (N,) int64 heart of each frame: the anatomy's seed, 0 in a set of one heart."""
    if store.config != MULTI_PHANTOM:
        return torch.zeros(len(store.views), dtype=torch.int64)
    seeds = torch.tensor([seed or 0 for seed in store.phantoms], dtype=torch.int64)
    return seeds[store.trajectory_index]


def _spread(rows: Tensor, heart: Tensor, count: int) -> Tensor:
    """Pick `count` of (R,) rows: from each heart as many, within a heart at even distances."""
    groups = [rows[heart == seed] for seed in heart.unique()]
    shares = torch.zeros(len(groups), dtype=torch.int64)
    sizes = torch.tensor([len(group) for group in groups])
    while (left := count - int(shares.sum())) > 0:
        open_ = (shares < sizes).nonzero()[:, 0]
        number = min(left, len(open_))
        shares[open_[torch.arange(number) * len(open_) // number]] += 1
    taken = zip(groups, shares.tolist(), strict=True)
    return torch.cat([g[torch.arange(share) * len(g) // max(share, 1)] for g, share in taken])


def common_sector(real: Tensor, phantom: Tensor, support: float) -> Tensor:
    """Return the (H, W) mask of pixels in the sector of both sets.

    Real: not black in a share `support` of the frames, as scanners crop differently. Phantom: not
    black in any frame, as its sector is the same in all.
    """
    inside = ((real > 0).float().mean(0) >= support) & (phantom > 0).any(0)
    if int(inside.sum()) < 1000:
        raise RacinesError("realism: the sectors of real and phantom frames do not overlap")
    return inside


def not_compared(config: str, reason: str) -> dict[str, Any]:
    """Return the report on a config of which there is nothing to compare."""
    return {"schema": SCHEMA, "compared": False, "config": config, "reason": reason}


def compare_with_real(
    real: RealFrames,
    store: FrameStore,
    config: RealismConfig,
    extractor: Extractor,
    progress: Progress | None = None,
) -> Realism:
    """Hold the phantom's frames beside the real ones."""
    began = time.perf_counter()
    rows = choose_rows(store, config)
    phantom, real = store.take(rows).images, one_each(real, 2 * config.frames)
    mask = common_sector(real.images, phantom, config.support)
    sector = Sector.of(mask)
    ours, theirs = (images * mask for images in (phantom, real.images))
    a, b = (Summary.of(images, sector, extractor(images, progress)) for images in (ours, theirs))
    n, figures = _over_splits(a, b, config)
    content = {
        "schema": SCHEMA,
        "compared": True,
        "config": store.config,
        "dataset": dataset_card(store) | {"digest": store.digest},
        "real": {"sha256": real.sha256, "frames": len(theirs), "patients": len(set(real.patient))},
        "view": config.view,
        "grade_at_least": config.grade,
        "phantom_frames": len(ours),
        "phantom_hearts": len(_hearts(store)[rows].unique()),
        "n": n,
        "splits": config.splits,
        "mask": {"pixels": int(mask.sum()), "support": config.support},
        "figures": figures,
        "gray": {"phantom": description(a), "real": description(b)},
        "extractor": extractor.settings,
        "code": code_version(),
        "environment": environment(),
        "seconds": round(time.perf_counter() - began, 3),
    }
    return Realism(content, real.images, phantom)


def one_each(real: RealFrames, count: int) -> RealFrames:
    """Keep one frame a patient, the phase by turns, of at most `count` patients."""
    order = np.argsort(real.patient, kind="stable")
    patient, first, frames = np.unique(real.patient[order], return_index=True, return_counts=True)
    rows = order[first + np.arange(len(patient)) % frames]
    if len(rows) > count:
        rows = rows[np.arange(count) * len(rows) // count]
    return RealFrames(real.images[torch.from_numpy(rows)], real.patient[rows], real.sha256)


def _over_splits(
    phantom: Summary, real: Summary, config: RealismConfig
) -> tuple[int, dict[str, Any]]:
    """Return n, and each figure's mean and range over random halves of the patients."""
    random = np.random.default_rng(config.seed)
    n = min(len(phantom.profile), len(real.profile) // 2, config.frames)
    rows: dict[str, list[dict[str, float]]] = {"phantom": [], "real": []}
    for _ in range(config.splits):
        order = torch.from_numpy(random.permutation(len(real.profile)))
        one, other = real.take(order[:n]), real.take(order[n : 2 * n])
        ours = phantom.take(torch.from_numpy(random.permutation(len(phantom.profile))[:n]))
        rows["phantom"].append(differences(ours, one))
        rows["real"].append(differences(other, one))
    figures: dict[str, Any] = {name: {"rule": rule} for name, rule in RULES.items()}
    for name, figure in figures.items():
        for key, found in rows.items():
            figure[key] = metrics.over_splits([each[name] for each in found])
    return n, figures
