"""The kinds of artefact: their ending, the tracks that they serve, which can be scored again."""

import contextlib
import importlib.util
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.submissions.file_checks import check_name

GENERATORS, AGENTS = "generators", "agents"


@dataclass(frozen=True)
class Kind:
    """What a kind of artefact is."""

    suffix: str
    tracks: tuple[str, ...]
    told: str
    rescored: bool = False
    """Whether scores can be made of it without code of its maker."""


KINDS = {
    "predictions": Kind(".parquet", (GENERATORS,), "images of the test poses", True),
    "generator": Kind(".onnx", (GENERATORS,), "a network that draws", True),
    "policy": Kind(".onnx", (AGENTS,), "a network that steers", True),
    "trace": Kind(".json", (AGENTS,), "the actions of every episode", True),
    "weights": Kind(".safetensors", (GENERATORS, AGENTS), "weights of merged code"),
    "scores": Kind(".json", (GENERATORS, AGENTS), "the submitter's own scores"),
    "adapter": Kind("", (GENERATORS, AGENTS), "merged code"),
}
YAML = "submission.yaml"
PACKAGES = ("racines_data", "racines_models", "racines_envs", "racines_leaderboard")
GROUPS = ("racines.generators", "racines.agents")


def files_of(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the artefacts that are files."""
    return [each for each in document["artefacts"] if each["kind"] != "adapter"]


def rescored(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the artefacts that scores are made of again; all of one kind."""
    return [each for each in document["artefacts"] if KINDS[each["kind"]].rescored]


def check_artefacts(document: dict[str, Any], where: str) -> None:
    """Check kinds, names and adapters of a document that fits the schema; nothing is opened.

    Raises:
        RacinesError: a kind of the other track, a name that is no bare file name or stands twice,
            another ending than the kind's, an adapter that is not merged, no plain choice of what
            is scored, or a tier that cannot be reached.
    """
    seen = {YAML}
    for i, artefact in enumerate(document["artefacts"]):
        field, kind = f"{where}: artefacts.{i}", KINDS[artefact["kind"]]
        if document["track"] not in kind.tracks:
            raise RacinesError(f"{field}.kind: {artefact['kind']} is none of {document['track']}")
        if "adapter" in artefact:
            _check_adapter(artefact["adapter"], f"{field}.adapter")
            continue
        name = check_name(artefact["path"], f"{field}.path")
        if Path(name).suffix != kind.suffix:
            raise RacinesError(
                f"{field}.path: {name!r} refused: {artefact['kind']} is a {kind.suffix} file"
            )
        if name.lower() in seen:
            raise RacinesError(f"{field}.path: {name!r} stands twice: one entry a file")
        seen.add(name.lower())
    if files_of(document) and "digest" not in document["dataset"]:
        raise RacinesError(
            f"{where}: dataset.digest: missing: the content or recipe digest of the data"
        )
    kinds = [each["kind"] for each in rescored(document)]
    if len(set(kinds)) > 1 or (len(kinds) > 1 and kinds[0] != "generator"):
        raise RacinesError(
            f"{where}: artefacts: {', '.join(kinds)}: give one that is scored again; only "
            "generators may be several, the seeds of one method"
        )
    merged, tier = any("adapter" in each for each in document["artefacts"]), document["tier"]
    if tier == "recomputed" and not kinds:
        needs = "predictions, a generator, a policy or a trace"
        raise RacinesError(f"{where}: tier: {tier} needs {needs}")
    if tier == "reproduced" and not merged:
        raise RacinesError(f"{where}: tier: {tier} needs merged code, an adapter")


def _check_adapter(target: str, where: str) -> None:
    """Check that `module:Class` is code of this repository; nothing of it is imported."""
    with contextlib.suppress(PackageNotFoundError):
        points = distribution("racines").entry_points
        if target in {point.value for point in points if point.group in GROUPS}:
            return
    module = target.partition(":")[0].split(".")
    if module[0] not in PACKAGES:
        raise RacinesError(
            f"{where}: {target!r} refused: only merged code is run; give a class of "
            f"{', '.join(PACKAGES)}, or predictions, an ONNX file or a trace"
        )
    spec = importlib.util.find_spec(module[0])
    root = Path(spec.origin).parent if spec and spec.origin else Path()
    file = root.joinpath(*module[1:])
    if not (file.with_suffix(".py").is_file() or (file / "__init__.py").is_file()):
        raise RacinesError(f"{where}: {target!r}: no such module in {module[0]}")
