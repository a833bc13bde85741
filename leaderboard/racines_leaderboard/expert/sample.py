"""Making a kit: balanced poses, images of each system, blind names, the sealed key."""

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import image_bytes, write_atomic, write_json
from racines_data.imaging import ImageSource
from racines_data.store.frames import Batch, FrameStore
from racines_leaderboard.expert.kit import IMAGES, KEY, KIT, Kit, sealed_document
from racines_leaderboard.records.experts import TRUE_FRAMES
from racines_leaderboard.records.schema import check
from racines_models.exchange.naming import check_name
from racines_models.judges.grader.model import Grader
from racines_models.provenance import code_version, dataset_card
from racines_models.sample import Progress, draw

DATE = 315_532_800
"""Time of every image: 1 January 1980, the earliest that archives can hold."""
GRADE_EDGES = (4.0, 7.0)
"""Thirds of the scale of a view, 1-10: poor below 4, fair below 7, good from there on."""
RETOUCHED = 64
"""Pixels of each image that are changed by one gray level."""


@dataclass(frozen=True)
class Study:
    """How a kit is drawn."""

    images: int = 400
    """Different images, shared out evenly over the systems."""
    repeats: int = 40
    """Images shown a second time, under another name and far from the first."""
    seed: int = 0
    """Decides poses, noise, names and repeats. No rater should know it."""
    split: str = "test"


@dataclass(frozen=True)
class System:
    """One maker of images in a study."""

    name: str
    source: ImageSource | None
    """None: the frames of the dataset themselves."""
    weights: dict[str, str] | None = None
    """SHA-256 of its weights, by file."""


@dataclass(frozen=True)
class Plan:
    """The names of M = images + repeats entries, and the blocks in which they are shown."""

    entries: np.ndarray
    """(M,) which image each entry shows; the repeats come last."""
    names: list[str]
    """(M,) the blind name of each entry."""
    blocks: list[list[str]]
    """Three blocks of sorted names. The two of a repeated image lie in the first and the last, so
    that at least the middle block lies between them, however each block is shuffled."""

    def named(self, answers: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """Return the answer to each name, in order, with the name that it repeats."""
        named = {}
        for place, (entry, name) in enumerate(zip(self.entries, self.names, strict=True)):
            first = self.names[entry] if place >= len(answers) else None
            named[name] = answers[entry] | {"repeat_of": first}
        return dict(sorted(named.items()))


def make_kit(
    out: Path,
    store: FrameStore,
    systems: Sequence[System],
    study: Study,
    grader: Grader | None = None,
    progress: Progress | None = None,
) -> Kit:
    """Draw a study's images and write its kit; every system draws the same poses.

    The folder `out` must not exist: ratings may rest on an older kit. The grader's view and grade
    of each image are put into the key; `progress` is told of images as they are drawn.

    Raises:
        RacinesError: `out` is there, too few frames, or settings or systems that cannot be.
    """
    _check(out, systems, study)
    if grader is not None:
        grader.check_labels(store.labels, "the dataset")
    rng = np.random.default_rng([study.seed, 0])
    shares = [len(part) for part in np.array_split(np.arange(study.images), len(systems))]
    frames = _poses(store, study, max(shares), rng)
    if grader is None and bool((frames.views < 0).all()):
        raise RacinesError("the frames have no view, so there is nothing to agree with: --grader")
    drawn, answers = [], []
    for system, share in zip(systems, shares, strict=True):
        batch = Batch(*(column[:share] for column in frames))
        images = batch.images
        if system.source is not None:
            images = draw(system.source, batch, study.seed, progress)
        elif progress is not None:
            progress(len(images))
        drawn.append(images)
        answers += _answers(system, batch, images, store, grader)
    plan = blind([answer["system"] for answer in answers], study.repeats, rng)
    key = {
        "schema": "racines.expert-key/1",
        "warning": "The answers of a blinded study: keep them from its raters.",
        "study": asdict(study),
        "dataset": dataset_card(store),
        "truth": "oracle" if store.manifest.get("source") == "phantom" else "labels",
        "systems": {each.name: {"weights": each.weights} for each in systems},
        "grader": None if grader is None else grader.settings,
        "code": code_version(),
        "images": plan.named(answers),
    }
    check(key, "expert-key", str(out / KEY))
    shown = retouch(torch.cat(drawn).numpy()[plan.entries], study.seed)
    return _write(out, shown, plan, key, store.labels)


def _check(out: Path, systems: Sequence[System], study: Study) -> None:
    if out.exists():
        raise RacinesError(f"{out}: is there already; name another folder")
    names = [check_name(system.name, "generator") for system in systems]
    if not names:
        raise RacinesError("nothing to show: give --generator, --truth, or both")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise RacinesError(f"generator {twice[0]} is named twice")
    if any(system.name == TRUE_FRAMES and system.source is not None for system in systems):
        kept = "the name is kept for the dataset's own frames"
        raise RacinesError(f"generator {TRUE_FRAMES}: {kept}")
    if study.images < len(names):
        raise RacinesError(f"--images {study.images}: fewer than the {len(names)} systems")
    if not 0 <= 2 * study.repeats <= study.images:
        raise RacinesError(f"--repeats {study.repeats}: give 0 to {study.images // 2}")


def _poses(store: FrameStore, study: Study, count: int, rng: np.random.Generator) -> Batch:
    rows = store.split_indices(study.split)
    if count > len(rows):
        raise RacinesError(
            f"split {study.split} has {len(rows)} frames, {count} are wanted a system: "
            "ask for fewer with --images"
        )
    columns = (store.views, store.grades, store.trajectory_index)
    views, grades, trajectories = (column[rows].numpy() for column in columns)
    random = len(store.labels) - 1
    return store.take(rows[stratify(views, grades, trajectories, count, random, rng)])


def _answers(
    system: System, frames: Batch, images: Tensor, store: FrameStore, grader: Grader | None
) -> list[dict[str, Any]]:
    truth = _opinions(frames.views, frames.grades, store.labels)
    judged = [None] * len(truth)
    if grader is not None:
        judged = _opinions(*grader.judge(images)[:2], store.labels)
    return [
        {
            "system": system.name,
            "row": int(row),
            "trajectory": store.trajectories[int(store.trajectory_index[row])],
            "frame": int(store.frame[row]),
            "pose": [None if np.isnan(x) else round(x, 6) for x in frames.parameters[i].tolist()],
            "truth": truth[i],
            "grader": judged[i],
        }
        for i, row in enumerate(frames.index)
    ]


def _opinions(views: Tensor, grades: Tensor, labels: Sequence[str]) -> list[dict[str, Any] | None]:
    """Return each image's view by name and grade; None where no view is known."""
    opinions: list[dict[str, Any] | None] = []
    for view, grade in zip(views, grades, strict=True):
        graded = round(float(grade), 4) if bool(grade.isfinite()) else None
        opinions.append({"view": labels[int(view)], "grade": graded} if int(view) >= 0 else None)
    return opinions


def _write(
    out: Path, images: np.ndarray, plan: Plan, key: dict[str, Any], labels: Sequence[str]
) -> Kit:
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    try:
        paths = _write_images(folder / IMAGES, plan.names, images)
        write_json(folder / KEY, key)
        os.chmod(folder / KEY, 0o600)
        document = sealed_document(labels, plan.blocks, paths, folder / KEY)
        check(document, "expert-kit", str(out / KIT))
        write_json(folder / KIT, document)
        os.chmod(folder, 0o755)
        os.rename(folder, out)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return Kit.open(out)


def retouch(images: np.ndarray, seed: int) -> np.ndarray:
    """Change `RETOUCHED` pixels of each of (M, H, W) uint8 images by one gray level, by chance.

    So no two files are equal, nor their pixels, and a hash does not tell which image is a repeat.
    All are changed alike: what was changed would else be a repeat. Nobody sees it, at 70 dB.
    """
    rng, pixels = np.random.default_rng([seed, 1]), images.reshape(len(images), -1).copy()
    places = rng.integers(0, pixels.shape[1], (len(pixels), RETOUCHED))
    before = np.take_along_axis(pixels, places, 1).astype(np.int16)
    up = (rng.random(places.shape) < 0.5) | (before == 0)
    after = np.where(up & (before < 255), before + 1, before - 1).astype(np.uint8)
    np.put_along_axis(pixels, places, after, 1)
    return pixels.reshape(images.shape)


def _write_images(folder: Path, names: Sequence[str], images: np.ndarray) -> list[Path]:
    """Write (M, H, W) uint8 images as PNG files of one size and one date; return their paths.

    Uncompressed: the size of a compressed file would tell dark images from bright ones, and show
    which two are the same.
    """
    paths = [folder / f"{name}.png" for name in names]
    for path, image in sorted(zip(paths, images, strict=True), key=lambda pair: pair[0]):
        write_atomic(path, image_bytes(Image.fromarray(image), compress_level=0))
        os.utime(path, (DATE, DATE))
    return paths


def allocate(total: int, capacities: np.ndarray) -> np.ndarray:
    """Share `total` out over (G,) groups as evenly as their capacities allow; (G,) int64.

    What does not divide goes to the first groups that have room; RacinesError if all are too few.
    """
    capacities = np.asarray(capacities, np.int64)
    if total > capacities.sum():
        raise RacinesError(f"{total} wanted of {capacities.sum()}: ask for fewer images")
    shares = np.zeros_like(capacities)
    while left := total - int(shares.sum()):
        free = np.flatnonzero(shares < capacities)
        step = max(left // len(free), 1)
        for group in free[:left]:
            shares[group] += min(step, capacities[group] - shares[group])
    return shares


def stratify(
    views: np.ndarray,
    grades: np.ndarray,
    trajectories: np.ndarray,
    total: int,
    random: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Choose `total` of N frames, balanced over views, then grades, then trajectories.

    Views are (N,) labels, -1 where unknown, which counts as one more; `random` is the label of
    `Random`, whose frames have one grade. Grades are (N,), 0-10, NaN where unknown, trajectories
    (N,) integers. Returns (total,) int64 places in random order; RacinesError if they are fewer.
    """
    bins = np.digitize(np.nan_to_num(grades), GRADE_EDGES)
    bins[(views < 0) | (views == random)] = 0
    present, counts = np.unique(views, return_counts=True)
    chosen = []
    for view, count in zip(present, allocate(total, counts), strict=True):
        groups = [np.flatnonzero((views == view) & (bins == b)) for b in np.unique(bins)]
        shares = allocate(int(count), np.array([len(group) for group in groups]))
        for group, share in zip(groups, shares, strict=True):
            chosen.append(_spread(group, trajectories[group], int(share), rng))
    return rng.permutation(np.concatenate(chosen))


def _spread(
    places: np.ndarray, trajectories: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Take `count` of (n,) places, from each trajectory one before any gives a second."""
    order = rng.permutation(len(places))
    turn = np.empty(len(places), np.int64)
    for trajectory in np.unique(trajectories):
        own = order[trajectories[order] == trajectory]
        turn[own] = np.arange(len(own))
    return places[order[np.argsort(turn[order], kind="stable")][:count]]


def blind(systems: Sequence[str], repeats: int, rng: np.random.Generator) -> Plan:
    """Choose at most half of N images to repeat, as many of each system; name all by chance."""
    names = np.array(systems)
    present, counts = np.unique(names, return_counts=True)
    shares = zip(present, allocate(repeats, counts), strict=True)
    chosen = [rng.permutation(np.flatnonzero(names == name))[:share] for name, share in shares]
    again = np.concatenate(chosen)
    total = len(names) + repeats
    width = max(4, len(str(total)))
    blind_names = [f"{number:0{width}d}" for number in rng.permutation(total) + 1]
    twins = np.arange(len(names), total)
    # Which of the two comes in the first block is chance: the first is the one that is scored.
    swap = rng.random(repeats) < 0.5
    first, last = np.where(swap, twins, again), np.where(swap, again, twins)
    others = rng.permutation(np.setdiff1d(np.arange(len(names)), again))
    cut = np.array([total // 3 - repeats, total - 2 * (total // 3)]).cumsum()
    a, b, c = np.split(others, cut)
    blocks = [np.concatenate([first, a]), b, np.concatenate([last, c])]
    shown = [sorted(blind_names[entry] for entry in block) for block in blocks]
    return Plan(np.concatenate([np.arange(len(names)), again]), blind_names, shown)
