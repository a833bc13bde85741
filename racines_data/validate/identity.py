"""Checks of files and rows against the manifest, and of held-out frames against training frames.

A frame's *signature* is its 16 x 16 block means: speckle of one block averages out, what stays is
the picture. The distance of two frames is the root mean square of the difference, in gray levels.
The yardstick of near-copies is the distance of two consecutive frames of a sweep with the probe at
rest: a frame nearer than that to some training frame tells a model nothing new.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
import yaml
from PIL import Image
from torch import Tensor

from racines_data.digest import content_digest, recipe_digest, refuse_strays
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.geometry import geodesic, parameters_to_pose
from racines_data.manifest import (
    ADDED,
    CARD,
    MULTI_PHANTOM,
    config_digest,
    describe,
    digest_note,
    digest_version,
    read_manifest,
)
from racines_data.patients.splits import split_of
from racines_data.schema import SPLITS
from racines_data.sources.gate.numbers import runs_on
from racines_data.validate.canonical import compare
from racines_data.validate.survey import Survey

RATE_TOLERANCE = 0.01  # largest departure of a time step from the median one, as a share
NEAR_LIMIT = 0.5
"""Largest share of near-copies, as a part of what a random split of frames has. Sweeps over one
block cross now and then, the more of them the more often: that is no fault of the split."""
NEAR_FLOOR = 0.02  # a share of near-copies that is never too large
REST = (0.0005, 0.0087)
"""The probe is at rest if it moves less between two frames: m, rad (0.5 mm, 0.5 degrees)."""
EMPTY = 0.5  # a frame darker than this share of the upper quartile of brightness shows no tissue
COMPARED = 4096  # held-out frames of the random frame split that is given for comparison
QUERIES, KEYS = 1024, 32_768  # frames compared at a time: bounds the distances at 134 MB


def rehash_files(root: Path, manifest: dict[str, Any], workers: int = 1) -> str:
    """Hash every file again, whatever an earlier check found; refuse those of no use."""
    files = manifest["files"]
    for config, splits in manifest["configs"].items():
        for name in chain.from_iterable(splits.values()):
            if name not in files:
                raise RacinesError(f"{name} of config {config} is not among the manifest's files")
    refuse_strays(root, manifest)
    for name in files:
        if not (root / name).is_file():
            raise RacinesError(f"{name} is missing")
    with ThreadPoolExecutor(workers) as pool:  # hashing runs outside the interpreter's lock
        hashes = pool.map(lambda name: sha256_file(root / name), files)
        for (name, record), found in zip(files.items(), hashes, strict=True):
            if found != record["sha256"]:
                raise RacinesError(f"{name} is damaged: its sha256 differs")
    size = sum(record["bytes"] for record in files.values())
    return f"{len(files)} files, {size / 1e6:.1f} MB, every sha256 as recorded"


def check_card(root: Path, manifest: dict[str, Any]) -> str:
    """Check that the card describes this content, and names the manifest's configs and files."""
    text = (root / CARD).read_text(encoding="utf-8")
    try:
        head = yaml.safe_load(text.split("---\n", 2)[1])
        configs = {config["config_name"]: config for config in head["configs"]}
        named = {
            name: {part["split"]: part["path"] for part in config["data_files"]}
            for name, config in configs.items()
        }
    except (yaml.YAMLError, IndexError, KeyError, TypeError) as error:
        raise RacinesError(f"{CARD}: its YAML header cannot be read: {error}") from error
    for name, config in configs.items():
        if config.get("description") != describe(manifest, name):
            raise RacinesError(f"{CARD} describes another dataset: its digest or source differs")
    if named != manifest["configs"]:
        raise RacinesError(f"{CARD} names other configs, splits or files than the manifest")
    return f"names the source, the content digest and {len(named)} configs"


def check_recipe(manifest: dict[str, Any]) -> str:
    """Check the recipe digest."""
    if recipe_digest(manifest["recipe"]) != manifest["recipe_digest"]:
        raise RacinesError("the recipe does not have the recorded recipe digest")
    return manifest["recipe_digest"][:16]


def check_counts(survey: Survey, manifest: dict[str, Any]) -> str:
    """Check the numbers of frames and trajectories of each split against those recorded."""
    many = survey.config == MULTI_PHANTOM
    recorded = (manifest[MULTI_PHANTOM] if many else manifest["counts"])["splits"]
    wholes = "patients" if survey.config in ADDED else "hearts" if many else ""
    for split in SPLITS:
        sweeps = [sweep for sweep in survey.sweeps if sweep.split == split]
        found = {"trajectories": len(sweeps), "frames": sum(len(sweep) for sweep in sweeps)}
        if wholes:
            found[wholes] = len({sweep.session for sweep in sweeps})
        wanted = {key: recorded.get(split, {}).get(key, 0) for key in found}
        if found != wanted:
            raise RacinesError(f"{split} has {found}, recorded {wanted}")
    return f"{len(survey)} frames in {len(survey.sweeps)} trajectories"


def check_content(survey: Survey, manifest: dict[str, Any]) -> str:
    """Check the rows' source and the content digest, which older datasets have without it."""
    sources = sorted({sweep.source for sweep in survey.sweeps})
    if sources != [manifest["source"]]:
        raise RacinesError(f"the rows are of {', '.join(sources)}, recorded {manifest['source']}")
    rows = ((sweep.split, sweep.id, sweep.digest) for sweep in survey.sweeps)
    wanted = config_digest(manifest, survey.config)
    if content_digest(rows, manifest["source"], digest_version(manifest)) != wanted:
        raise RacinesError("the rows do not have the recorded content digest")
    note = digest_note(manifest)
    return wanted[:16] + (f" ({note})" if note else "")


def check_splits(survey: Survey, root: Path, manifest: dict[str, Any]) -> str:
    """Check that no trajectory, and in `multi_phantom` no heart, is in two splits."""
    _check_apart("trajectory", [(sweep.id, sweep.split) for sweep in survey.sweeps])
    if survey.config in ADDED:
        return _check_patients(survey)
    if survey.config == MULTI_PHANTOM:
        _check_apart("heart", [(f"{sweep.phantom}", sweep.split) for sweep in survey.sweeps])
        return f"{len({sweep.phantom for sweep in survey.sweeps})} hearts, each in one split"
    _check_listed(survey, root, manifest)
    held = manifest["held_out_session"]
    if "sessions" in manifest["configs"]:
        _check_held_out(root, manifest["configs"]["sessions"], held)
    note = f"; session {held} held out in `sessions`" if held else ""
    return f"{len(survey.sweeps)} trajectories, each in one split{note}"


def _check_apart(kind: str, pairs: list[tuple[str, str]]) -> None:
    seen: dict[str, str] = {}
    for name, split in pairs:
        if seen.setdefault(name, split) != split:
            raise RacinesError(f"{kind} {name} is in {split} and in {seen[name]}")
    if kind == "trajectory" and len(seen) < len(pairs):
        raise RacinesError("a trajectory occurs twice in its split")


def _check_patients(survey: Survey) -> str:
    """Check that each patient is in one split, the one to which the seed belongs."""
    _check_apart("patient", [(f"{sweep.patient}", sweep.split) for sweep in survey.sweeps])
    for sweep in survey.sweeps:
        if sweep.patient is None:
            raise RacinesError(f"trajectory {sweep.id}: has no patient")
        if (own := split_of(sweep.patient)) != sweep.split:
            raise RacinesError(f"patient {sweep.patient} of {own} is in {sweep.split}")
    return f"{len({sweep.patient for sweep in survey.sweeps})} patients, each in its own split"


def _check_listed(survey: Survey, root: Path, manifest: dict[str, Any]) -> None:
    keys = ("trajectory", "session", "target_view", "phantom", "split", "frames", "digest")
    listed = {
        row["trajectory"]: tuple(row[key] for key in keys)
        for name in chain.from_iterable(manifest["configs"]["trajectories"].values())
        for row in pq.read_table(root / name).to_pylist()
    }
    found = {
        s.id: (s.id, s.session, s.target_view, s.phantom, s.split, len(s), s.digest)
        for s in survey.sweeps
    }
    if found != listed:
        odd = sorted(name for name in {*found, *listed} if found.get(name) != listed.get(name))
        raise RacinesError(
            f"configs `frames` and `trajectories` disagree on {odd[0]} and {len(odd) - 1} others"
        )


def _check_held_out(root: Path, splits: dict[str, list[str]], held: str | None) -> None:
    for split, names in splits.items():
        for name in names:
            column = pq.read_table(root / name, columns=["session"])["session"]
            sessions = set(column.unique().to_pylist())
            if (sessions != {held}) if split == "test" else (held in sessions):
                raise RacinesError(
                    f"config `sessions` has {', '.join(sorted(sessions))} in {split}, where "
                    f"{held} is the one held out"
                )


def check_times(survey: Survey, repeats: bool = False) -> str:
    """Check that time goes forward in each trajectory; with `repeats` it may stand still."""
    for sweep in survey.sweeps:
        halts = np.flatnonzero(~runs_on(sweep.timestamps, repeats))
        if len(halts):
            raise RacinesError(f"trajectory {sweep.id}: time does not go on after frame {halts[0]}")
    total = sum(float(sweep.timestamps[-1] - sweep.timestamps[0]) for sweep in survey.sweeps)
    return f"increasing in every trajectory, {total:.0f} s in all"


def check_rate(survey: Survey) -> str:
    """Check that all frames are equally far apart in time."""
    sweeps = [sweep for sweep in survey.sweeps if len(sweep) > 1]
    if not sweeps:
        return "no trajectory has two frames"
    steps = [np.diff(sweep.timestamps) for sweep in sweeps]
    step = float(np.median(np.concatenate(steps)))
    for sweep, each in zip(sweeps, steps, strict=True):
        off = np.abs(each / step - 1)
        if not (off <= RATE_TOLERANCE).all():
            row = int(np.argmax(off))
            raise RacinesError(
                f"trajectory {sweep.id}: {each[row]:.4g} s after frame {row}, elsewhere {step:.4g}"
            )
    return f"{1 / step:.4g} frames a second throughout"


def same_version(root: Path, other: Path) -> str:
    """Check that two builds are of one version, and say how they differ.

    A rebuild on another processor has other bytes in a few pixels, and another content digest with
    them (see `validate.canonical`). It is the same version if it has the same recipe, and canonical
    frames no further off than processors are; those of recordings, by one gray level.
    """
    one, two = read_manifest(root), read_manifest(other)
    for key in ("source", "version", "recipe_digest"):
        if one[key] != two[key]:
            raise RacinesError(f"{key} is {one[key]} here and {two[key]} in {other}")
    _check_same_added(one, two, other)
    more = [
        [manifest[name] for name in (MULTI_PHANTOM, *ADDED) if name in manifest]
        for manifest in (one, two)
    ]
    digests = [[part["digest"] for part in parts] for parts in more]
    if one["digest"] == two["digest"] and digests[0] == digests[1]:
        return "equal, byte for byte"
    canonical = [*one["canonical"], *(each for part in more[0] for each in part["canonical"])]
    files = [frame["file"] for frame in canonical]
    frames = (
        np.stack([np.asarray(Image.open(folder / f)) for f in files]) for folder in (root, other)
    )
    found = compare(*frames)
    if not (found.holds if one["source"] == "phantom" else found.levels <= 1):
        raise RacinesError(f"canonical frames differ from those of {other} by {found}")
    if digest_version(one) != digest_version(two):
        return f"same recipe; the digests are of two versions, canonical frames differ by {found}"
    return f"same recipe; content differs, canonical frames by {found}"


def _check_same_added(one: dict[str, Any], two: dict[str, Any], other: Path) -> None:
    for name in ADDED:
        recipes = [manifest.get(name, {}).get("recipe_digest") for manifest in (one, two)]
        if recipes[0] != recipes[1]:
            told = " and ".join(str(each) for each in recipes)
            raise RacinesError(f"recipe_digest of {name}: {told}, the latter in {other}")


# --- copies of training frames --------------------------------------------------------------------


@dataclass(frozen=True)
class Duplicates:
    """Copies of training frames among the held-out ones."""

    held_out: int  # frames of validation and test that show tissue
    exact: int  # those whose pixels are those of a training frame
    near: float | None  # share nearer to a training frame than `threshold`, if any is compared
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
    return Duplicates(held_out, copies, near, by_frame, threshold, float(distance.median()), empty)


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
