"""Score files as the evaluations write them, with made-up figures."""

import copy
import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from racines_leaderboard.records.ranges import range_of

DIGEST = hashlib.sha256(b"made up").hexdigest()
ENVIRONMENT = {"python": "3.11.7", "torch": "2.13.0", "platform": "Linux", "cpu": "x86_64"}


def metric(value: float | None, n: int = 100, name: str = "") -> dict[str, Any]:
    least, most = range_of(name)
    low, high = value, value
    if value is not None:
        low, high = max(value - 0.1, least), min(value + 0.1, most)
    return {"value": value, "low": low, "high": high, "n": n}


def generator_scores(name: str, recipe: str = DIGEST, **figures: float | None) -> dict[str, Any]:
    values = {"ssim": 0.5, "psnr": 20.0, "fid": 100.0, "kid": 0.1} | figures
    return {
        "schema": "racines.generator-scores/1",
        "generator": name,
        "dataset": {
            "source": "phantom",
            "version": "1.0.0",
            "digest": DIGEST,
            "recipe_digest": recipe,
            "split": "test",
        },
        "seeds": [0],
        "metrics": {key: metric(value, name=key) for key, value in values.items()},
        "extractors": {},
        "weights": {"sha256": DIGEST},
        "code": {"version": "0.1.0"},
        "environment": ENVIRONMENT,
        "seconds": 1.0,
    }


def agent_scores(
    name: str,
    view: str = "SC",
    recipe: str = DIGEST,
    observation: str = "image",
    **figures: float,
) -> dict[str, Any]:
    values = {"success_true": 0.5, "steps": 50.0, "final_grade": 5.0, "return": 10.0} | figures
    return {
        "schema": "racines.agent-scores/1",
        "agent": name,
        "task": {
            "view": view,
            "backend": "phantom",
            "observation": observation,
            "reward": "paper",
            "start_set": "fixed-100",
        },
        "phantom": {"version": "1.0.0", "recipe_digest": recipe},
        "metrics": {key: metric(value, name=key) for key, value in values.items()},
        "seeds": [0],
        "weights": None,
        "code": {"version": "0.1.0"},
        "environment": ENVIRONMENT,
        "seconds": 1.0,
    }


SUBMISSION: dict[str, Any] = {
    "schema": "racines.submission/2",
    "name": "mine",
    "track": "generators",
    "authors": ["Somebody"],
    "method": "a method",
    "description": "What it is.",
    "licence": "MIT",
    "tier": "self-reported",
    "dataset": {"source": "phantom", "version": "1.0.0", "digest": DIGEST},
    "seeds": [0],
    "code": {"url": "https://example.org/mine", "commit": "abcdef0"},
    "training": {"budget": "1 image", "hardware": "one core"},
}
ADAPTER = {"kind": "adapter", "adapter": "racines_models.generators.vae_gan:VaeGan"}


def artefact(kind: str, file: Path, **changes: Any) -> dict[str, Any]:
    """Return the entry of a file; of one that is not there, with made-up figures."""
    content = file.read_bytes() if file.is_file() else b"x"
    sha256 = hashlib.sha256(content).hexdigest()
    entry = {"kind": kind, "path": file.name, "sha256": sha256, "size": len(content) or 1}
    return entry | changes


def write_submission(folder: Path, *artefacts: dict[str, Any], **changes: Any) -> Path:
    """Write a submission.yaml, of merged code if no artefact is given; None leaves a key out."""
    document = SUBMISSION | {"artefacts": list(artefacts) or [ADAPTER]} | changes
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "submission.yaml"
    kept = {key: copy.deepcopy(value) for key, value in document.items() if value is not None}
    path.write_text(yaml.safe_dump(kept, sort_keys=False))
    return path


@pytest.fixture
def ground(workplace, monkeypatch):
    """The ground of a tiny board, with block means in the place of Inception."""
    return lay_ground(workplace, monkeypatch)


SHORT = 30
"""Steps after which episodes of SC end on the tiny board."""


def lay_ground(workplace: Path, patch: pytest.MonkeyPatch):
    """Go to a workplace, and return the ground of a tiny board there."""
    from racines_envs.task.tasks import TASKS
    from racines_leaderboard.board.recompute import Ground
    from racines_leaderboard.submissions.confined.session import Limits
    from racines_models.scores import scoring
    from tests.conftest import TINY
    from tests.models.scores.test_scores import Coarse
    from tests.waiting import PATIENCE

    patch.chdir(workplace)
    patch.setitem(TASKS, "SC", replace(TASKS["SC"], max_steps=SHORT))
    patch.setattr(scoring, "InceptionFeatures", Coarse)
    limits = Limits(memory=2**30, open_seconds=int(PATIENCE), call_seconds=int(PATIENCE))
    return Ground("tiny", TINY, workplace / "data/racines", grader=None, limits=limits)


@pytest.fixture
def write_scores(tmp_path: Path) -> Callable[..., Path]:
    """Write scores documents into a folder, each under its system's name."""

    def write(folder: str, *documents: dict[str, Any]) -> Path:
        target = tmp_path / folder
        target.mkdir(parents=True, exist_ok=True)
        for document in documents:
            name = document.get("generator") or document.get("agent")
            (target / f"{name}.json").write_text(json.dumps(document))
        return target

    return write
