"""Checks of files and rows against the manifest: bytes, card, recipe, counts, splits, clock."""

from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import yaml
from PIL import Image

from racines_data.digest import content_digest, recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.manifest import CARD, MULTI_PHANTOM, config_digest, describe, read_manifest
from racines_data.schema import SPLITS
from racines_data.validate.survey import Survey

RATE_TOLERANCE = 0.01  # largest departure of a time step from the median one, as a share
TOLERANCE = 1  # gray levels by which canonical frames of one version may differ


def rehash_files(root: Path, manifest: dict[str, Any], workers: int = 1) -> str:
    """Hash every file again, whatever an earlier check found."""
    files = manifest["files"]
    for config, splits in manifest["configs"].items():
        for name in chain.from_iterable(splits.values()):
            if name not in files:
                raise RacinesError(f"{name} of config {config} is not among the manifest's files")
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
    text = (root / CARD).read_text()
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
    for split in SPLITS:
        sweeps = [sweep for sweep in survey.sweeps if sweep.split == split]
        found = {"trajectories": len(sweeps), "frames": sum(len(sweep) for sweep in sweeps)}
        if many:
            found["hearts"] = len({sweep.phantom for sweep in sweeps})
        wanted = {key: recorded.get(split, {}).get(key, 0) for key in found}
        if found != wanted:
            raise RacinesError(f"{split} has {found}, recorded {wanted}")
    return f"{len(survey)} frames in {len(survey.sweeps)} trajectories"


def check_content(survey: Survey, manifest: dict[str, Any]) -> str:
    """Check the content digest."""
    rows = ((sweep.split, sweep.id, sweep.digest) for sweep in survey.sweeps)
    wanted = config_digest(manifest, survey.config)
    if content_digest(rows) != wanted:
        raise RacinesError("the rows do not have the recorded content digest")
    return wanted[:16]


def check_splits(survey: Survey, root: Path, manifest: dict[str, Any]) -> str:
    """Check that no trajectory, and in `multi_phantom` no heart, is in two splits."""
    _check_apart("trajectory", [(sweep.id, sweep.split) for sweep in survey.sweeps])
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


def check_times(survey: Survey) -> str:
    """Check that time goes forward in each trajectory."""
    for sweep in survey.sweeps:
        halts = np.flatnonzero(np.diff(sweep.timestamps) <= 0)
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

    Floating point differs in the last bit between processors, so that a rebuild elsewhere may
    differ by one gray level in a few pixels, and its content digest with it. It is the same version
    if it has the same recipe, and canonical frames within one gray level.
    """
    one, two = read_manifest(root), read_manifest(other)
    for key in ("source", "version", "recipe_digest"):
        if one[key] != two[key]:
            raise RacinesError(f"{key} is {one[key]} here and {two[key]} in {other}")
    more = [manifest.get(MULTI_PHANTOM, {}) for manifest in (one, two)]
    if one["digest"] == two["digest"] and more[0].get("digest") == more[1].get("digest"):
        return "equal, byte for byte"
    furthest = 0
    for frame in [*one["canonical"], *more[0].get("canonical", [])]:
        images = [np.asarray(Image.open(folder / frame["file"]), int) for folder in (root, other)]
        furthest = max(furthest, int(np.abs(images[0] - images[1]).max()))
    if furthest > TOLERANCE:
        raise RacinesError(f"canonical frames differ by {furthest} gray levels from {other}")
    return f"same recipe; content differs, canonical frames by {furthest} gray level at most"
