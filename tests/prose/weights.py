"""The weights that the repository carries: how large, what for, who rests on them.

What is tracked is asked of git, so that no file is there without a line, and no line without one.
"""

import json
import subprocess
from collections import Counter
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from racines_data.files import sha256_file
from racines_data.tables import Markdown
from racines_models.provenance import sha256_bytes
from racines_models.weights import SMALL
from tests.prose.markers import ROOT

ENDINGS = (".safetensors", ".onnx")
MOST, LARGEST = 160e6, 25e6
"""Bytes that all may have together, and one."""
GROUPS = {
    "models/weights/grader": "view and grade of one heart's pictures: the judge of its boards",
    "models/weights/student": "the same, at a fraction of the time",
    "models/weights/pose": "the pose of one heart's pictures: the judge of its boards",
    "models/weights/encoder": "what one heart's policies see pictures through, a file for all",
    "models/weights/patients/*": "generators that adapt to a patient, three trainings each",
    "models/weights/phantom-patients/*": "judges of patients: two graders, pose, segmentation",
    "models/weights/scene-field": "generator, reference profile",
    "models/weights/flow": "generator, reference profile",
    "models/weights/vae-gan": "generator, reference profile, three trainings",
    "models/weights/*gan": "further generators, reference profile, the first training of each",
    "models/weights/phantom-default/scene-field": "generator, default profile, further trainings: "
    "the first is what `make repro` trains",
    "models/weights/phantom-default/vae-gan": "generator, default profile, three trainings",
    "envs/weights/servo": "agent on patients, three trainings, one network for all views",
    "envs/weights/servo-full": "the servo at all pixels, three trainings",
    "envs/weights/servo-memory": "agent on patients that sees through the servo, three trainings",
    "envs/weights/servo-memory-full": "the same through `servo-full`, three trainings, in eight "
    "bits",
    "envs/weights/servo-memory-plus": "the same, taught by twice as many, likewise",
    "envs/weights/patients/ppo-*": "policies on still patients that see the pose, three trainings "
    "a view, in eight bits",
    "envs/weights/beating/ppo-*": "the same on beating hearts",
    "envs/weights/patients/behaviour-cloning-*": "policy that imitates sweeps of patients, three "
    "trainings",
    "envs/weights/beating/behaviour-cloning-*": "the same three policies, set to beating hearts",
    "envs/weights/ppo-belief": "policy on patients that sees through the servo, three trainings",
    "envs/weights/constant-pose": "floor on patients: a pose for each view",
    "envs/weights/blind-tour": "floor on patients: poses for each view",
    "envs/weights/phantom-default/*": "policies, default profile, three trainings each",
    "envs/weights/*-image*": "policies that see the encoder's answer, trained in phantom or in "
    "a generator's pictures",
    "envs/weights/ppo-multimodal*": "policies that see picture and pose",
    "envs/weights/*": "policies that see the pose, up to three trainings each",
    "envs/weights": "such a policy as an ONNX file",
}
"""What is in a folder, the first pattern that fits; folders of further trainings belong to it."""


class Weights(NamedTuple):
    """One tracked file."""

    path: str
    size: int
    sha256: str
    wide: int
    """Bytes of large float32 tensors, of which half precision would save half."""


@cache
def tracked(root: Path = ROOT) -> tuple[Weights, ...]:
    """Return the weights that git tracks in a checkout."""
    asked = ["git", "ls-files", "-z", "--", *(f"*{ending}" for ending in ENDINGS)]
    listed = subprocess.run(asked, cwd=root, check=True, capture_output=True, text=True).stdout
    paths = [name for name in listed.split("\0") if name and (root / name).is_file()]
    return tuple(
        Weights(name, (root / name).stat().st_size, sha256_file(root / name), wide(root / name))
        for name in sorted(paths)
    )


def header(path: Path) -> dict[str, Any]:
    """Return what a safetensors file says of its tensors."""
    with path.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        found = json.loads(stream.read(length))
    found.pop("__metadata__", None)
    return found


def wide(path: Path) -> int:
    """Return the bytes of the float32 tensors that `racines_models.weights.publish` would halve."""
    if path.suffix != ".safetensors":
        return 0
    sizes = [
        told["data_offsets"][1] - told["data_offsets"][0]
        for told in header(path).values()
        if told["dtype"] == "F32"
    ]
    return sum(size for size in sizes if size // 4 > SMALL)


def group_of(path: str) -> str | None:
    """Return the pattern that a tracked file falls under, or None."""
    folder = str(Path(path).parent)
    folder = folder.rpartition("/")[0] if "/seed-" in folder else folder
    fitting = (each for each in GROUPS if each.count("/") == folder.count("/"))
    return next((each for each in fitting if fnmatch(folder, each)), None)


@cache
def named(root: Path = ROOT) -> dict[str, set[str]]:
    """Return the boards whose files name a tracked file, by its sha256."""
    hashes = {each.sha256 for each in tracked(root)}
    found: dict[str, set[str]] = {sha256: set() for sha256 in hashes}
    for path in (root / "leaderboard/results").glob("*/**/*.json"):
        board = path.relative_to(root / "leaderboard/results").parts[0]
        text = path.read_text()
        for sha256 in hashes:
            if sha256 in text:
                found[sha256].add(board)
    return found


def table() -> dict[str, Any]:
    """Return the budget: a line a group, in the order of `GROUPS`, and their sum."""
    rows = []
    for pattern, what in GROUPS.items():
        files = [each for each in tracked() if group_of(each.path) == pattern]
        boards = sorted(set().union(*(named()[each.sha256] for each in files)))
        rows.append([Markdown(f"`{pattern}`"), *_sizes(files), what, ", ".join(boards) or "–"])
    rows.append(["all", *_sizes(list(tracked())), "", ""])
    columns = ["folder", "files", "MB", "of it in float32", "what for", "boards that name them"]
    return {"columns": columns, "rows": rows}


def _sizes(files: list[Weights]) -> list[str]:
    told = [sum(each.size for each in files), sum(each.wide for each in files)]
    return [str(len(files)), *(f"{size / 1e6:.2f}" if size >= 5e3 else "–" for size in told)]


def free() -> int:
    """Return the bytes of float32 that no board's file names."""
    return sum(each.wide for each in tracked() if not named()[each.sha256])


def twice() -> int:
    """Return the bytes of tensors that lie in several files, but for the first of each."""
    seen: Counter[str] = Counter()
    sizes: dict[str, int] = {}
    for each in tracked():
        if not each.path.endswith(ENDINGS[0]):
            continue
        content = (ROOT / each.path).read_bytes()
        start = 8 + int.from_bytes(content[:8], "little")
        for told in header(ROOT / each.path).values():
            first, last = told["data_offsets"]
            digest = sha256_bytes(content[start + first : start + last])
            seen[digest], sizes[digest] = seen[digest] + 1, last - first
    return sum((count - 1) * sizes[digest] for digest, count in seen.items())


def __getattr__(name: str) -> Any:
    """Measure when a page asks: `TABLE`, and `TOTAL`, `WIDE`, `FREE` and `TWICE` in MB."""
    if name == "TABLE":
        return table()
    sizes = {
        "TOTAL": lambda: sum(each.size for each in tracked()),
        "WIDE": lambda: sum(each.wide for each in tracked()),
        "FREE": free,
        "TWICE": twice,
        "FURTHER": lambda: sum(each.size for each in tracked() if "scene-field/seed-" in each.path),
    }
    if name not in sizes:
        raise AttributeError(name)
    return sizes[name]() / 1e6
