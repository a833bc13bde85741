"""Making a kit: poses of the test split, images of each system, blind names, the sealed key."""

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.imaging import ImageSource
from racines_data.store.frames import Batch, FrameStore
from racines_leaderboard.expert.blinding import Plan, blind, write_images
from racines_leaderboard.expert.kit import (
    IMAGES,
    KEY,
    KIT,
    Kit,
    described,
    digest_of,
    images_sha256,
)
from racines_leaderboard.expert.strata import stratify
from racines_leaderboard.records.experts import TRUE_FRAMES
from racines_leaderboard.records.schema import check
from racines_models.exchange.naming import check_name
from racines_models.judges.grader.model import Grader
from racines_models.provenance import code_version, dataset_card
from racines_models.sample import Progress, draw


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


def make_kit(
    out: Path,
    store: FrameStore,
    systems: Sequence[System],
    study: Study,
    grader: Grader | None = None,
    progress: Progress | None = None,
) -> Kit:
    """Draw a study's images and write its kit; every system draws the same poses.

    Args:
        out: The kit's folder, which must not exist: ratings may rest on an older one.
        store: The dataset.
        systems: Who draws.
        study: How many images, and the seed.
        grader: Its view and grade of each image are put into the key.
        progress: Told of images drawn, as they come.

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
    batches = [Batch(*(column[:share] for column in frames)) for share in shares]
    drawn = [
        _images(system, batch, study.seed, progress)
        for system, batch in zip(systems, batches, strict=True)
    ]
    answers = [
        answer
        for system, batch, images in zip(systems, batches, drawn, strict=True)
        for answer in _answers(system, batch, images, store, grader)
    ]
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
    return _write(out, torch.cat(drawn).numpy()[plan.entries], plan, key, store.labels)


def _check(out: Path, systems: Sequence[System], study: Study) -> None:
    if out.exists():
        raise RacinesError(f"{out}: is there already; name another folder")
    names = [check_name(system.name, "generator") for system in systems]
    if not names:
        raise RacinesError("nothing to show: give --generator, --truth, or both")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RacinesError(f"generator {twice[0]} is named twice")
    if any(system.name == TRUE_FRAMES and system.source is not None for system in systems):
        raise RacinesError(
            f"generator {TRUE_FRAMES}: the name is kept for the dataset's own frames"
        )
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


def _images(system: System, frames: Batch, seed: int, progress: Progress | None) -> Tensor:
    if system.source is not None:
        return draw(system.source, frames, seed, progress)
    if progress is not None:
        progress(len(frames.images))
    return frames.images


def _answers(
    system: System, frames: Batch, images: Tensor, store: FrameStore, grader: Grader | None
) -> list[dict[str, Any]]:
    views, grades = frames.views, frames.grades
    seen, graded = (None, None) if grader is None else grader.judge(images)[:2]
    return [
        {
            "system": system.name,
            "row": int(row),
            "trajectory": store.trajectories[int(store.trajectory_index[row])],
            "frame": int(store.frame[row]),
            "pose": [None if np.isnan(x) else round(x, 6) for x in frames.parameters[i].tolist()],
            "truth": _answer(views[i], grades[i], store.labels),
            "grader": None
            if seen is None or graded is None
            else _answer(seen[i], graded[i], store.labels),
        }
        for i, row in enumerate(frames.index)
    ]


def _answer(view: Tensor, grade: Tensor, labels: Sequence[str]) -> dict[str, Any] | None:
    if int(view) < 0:
        return None
    graded = round(float(grade), 4) if bool(grade.isfinite()) else None
    return {"view": labels[int(view)], "grade": graded}


def _write(
    out: Path, images: np.ndarray, plan: Plan, key: dict[str, Any], labels: Sequence[str]
) -> Kit:
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    try:
        paths = write_images(folder / IMAGES, plan.names, images)
        write_json(folder / KEY, key)
        os.chmod(folder / KEY, 0o600)
        document = described(labels) | {"blocks": plan.blocks}
        document["images_sha256"] = images_sha256(paths)
        document["key_sha256"] = sha256_file(folder / KEY)
        document["digest"] = digest_of(document)
        check(document, "expert-kit", str(out / KIT))
        write_json(folder / KIT, document)
        os.chmod(folder, 0o755)
        os.rename(folder, out)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return Kit.open(out)
