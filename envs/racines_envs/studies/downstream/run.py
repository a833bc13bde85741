"""What a servo is worth that learned from a generator's images, beside the generator's metrics.

    point ──> its images of train patients ──> a small servo ──> found on validation patients
      └─────> its images at the board's poses of the same patients ──> the board's metrics

All points have the same patients, poses, trainings and starts; what differs is who draws. A point
is a task of minutes, whose result lies in a file of its own: a study that was killed goes on.
"""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.scouts import SCOUTS_VERSION
from racines_data.patients.splits import seeds_of
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.studies.downstream.config import DownstreamConfig
from racines_envs.studies.downstream.judge import (
    asked_of,
    found_by,
    open_judges,
    score_images,
    true_extractor,
)
from racines_envs.studies.downstream.lessons import lesson
from racines_envs.studies.downstream.points import Point, open_point, open_points
from racines_envs.studies.downstream.teach import teach, true_frames
from racines_models.networks.servo import SIDE
from racines_models.provenance import code_version, environment

SCHEMA = "racines.downstream-point/1"
KEYS = {
    "schema", "kind", "spec", "weights", "metrics", "pseudo", "reading", "outcome", "found", "code",
    "environment", "training_seconds", "seconds",
}  # fmt: skip
"""What is told of a point."""
LATER = "widths", "blocks", "grown", "processes"
LATER_VISITS = "beside", "batch_size", "learning_rate"
"""Settings of a servo that came after points were published."""
State = tuple[DownstreamConfig, Path]


def measure_points(
    config: DownstreamConfig, folder: Path, engine: Engine | None = None,
    advance: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Measure all points; return what is told of each, in the order of the settings.

    Args:
        config: all settings.
        folder: keeps what patients have been examined, and a file a point.
        engine: runs a point a task; None: one after the other, here.
        advance: told what is done.

    Raises:
        RacinesError: points, generators, judges or published points that are not there, before
            anybody is examined; a generator that refuses a scout, or images that are none.
    """
    points = open_points(config.points)
    open_judges(config)
    paths = [point_file(point, config, folder) for point in points]
    if len(set(paths)) < len(paths):
        raise RacinesError("downstream.points: two of them draw the same: leave one out")
    own = paths
    paths = [_published(path, config) or path for path in paths]
    missing = [spec for spec, path in zip(config.points, paths, strict=True) if not path.is_file()]
    state, pool = (config, folder), engine or LocalEngine()
    whom = [("train", each) for each in seeds_of("train")[: config.patients]]
    whom += [(config.split, each) for each in config.readers]
    if missing:
        asked_of(config, folder, engine)
    parts: list[tuple[Callable[[State, Any], str], Sequence[Any]]] = [
        (_prepare, whom), (_look, ["true images"]), (_measure, missing)
    ]  # fmt: skip
    for work, tasks in parts if missing else ():
        for title in pool.map(work, state, tasks, remedy="to go on"):
            if advance is not None:
                advance(title)
    return [
        _read(path, each, path != mine) for each, path, mine in zip(points, paths, own, strict=True)
    ]


def _published(path: Path, config: DownstreamConfig) -> Path | None:
    """Return the file of a point as it was published; None if it was measured here, or is not."""
    if not config.published or path.is_file():
        return None
    folder = Path(config.published)
    if not folder.is_dir():
        raise RacinesError(f"downstream.published: {folder}: no such folder: leave it empty")
    found = folder / path.name
    return found if found.is_file() else None


def _read(path: Path, point: Point, published: bool) -> dict[str, Any]:
    """Return what is told of a point, measured here or published.

    Raises:
        RacinesError: a file that is damaged, or of something else.
    """
    remedy = "get it again, or leave downstream.published empty" if published else "remove it"
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RacinesError(f"{path}: not readable as JSON: {remedy}, and run again") from error
    here = {"schema": SCHEMA, "spec": point.spec, "kind": point.kind(), "weights": point.weights}
    whole = isinstance(told, dict) and told.keys() >= KEYS
    if not whole or any(told[key] != value for key, value in here.items()):
        raise RacinesError(f"{path}: not a result of {point.spec!r}: {remedy}, and run again")
    return told | {"label": point.label}


def steps_of(config: DownstreamConfig) -> int:
    """Return how often `measure_points` tells of something done, if nothing is there yet."""
    return config.patients + config.read + 1 + len(config.points)


def point_file(point: Point, config: DownstreamConfig, folder: Path) -> Path:
    """Return where a point's result lies: its name tells all that decides it."""
    aside = ("points", "published", "anchors", "pose", "segmentation")
    settings = {key: value for key, value in asdict(config).items() if key not in aside}
    told = {"schema": SCHEMA, "spec": point.spec, "weights": point.weights, "settings": settings}
    told |= {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "side": SIDE}
    told |= {"learning": _learning(config.servo)}
    told |= {"judges": [_files(config.pose), _files(config.segmentation)]}
    digest = recipe_digest(json.loads(json.dumps(told)))[:16]
    return folder / "points" / f"{digest}.json"


def _learning(servo: ServoConfig) -> dict[str, Any]:
    """Return a servo's settings by which points are told apart.

    Those that came after points were published are left out where they change nothing.
    """
    plain, told = asdict(ServoConfig()), asdict(servo)
    parts = (told, plain, LATER), (told["visits"], plain["visits"], LATER_VISITS)
    for kept, usual, later in parts:
        for name in later:
            if kept[name] == usual[name]:
                del kept[name]
    return told


def _files(folder: str) -> list[str]:
    """Return the SHA-256 of a judge's weights and settings."""
    files = [*sorted(Path(folder).glob("*.safetensors")), Path(folder) / "config.json"]
    return [sha256_file(each) for each in files if each.is_file()]


def _prepare(state: State, whom: tuple[str, int]) -> str:
    config, folder = state
    split, patient = whom
    if split == "train":
        lesson(patient, config.lessons, folder / "lessons")
    else:
        true_frames(patient, config, folder)
    return f"patient {patient}"


def _look(state: State, title: str) -> str:
    """Look at the true images, with as many threads as the tasks that ask for it again."""
    true_extractor(asked_of(*state), state[1])
    return title


def _measure(state: State, spec: str) -> str:
    """Measure one point, and write its file; return its label."""
    config, folder = state
    began, point = time.perf_counter(), open_point(spec)
    path = point_file(point, config, folder)
    own = path.with_suffix("")
    servos, reading, seconds = teach(point, config, folder, own)
    outcome, found = found_by(servos, config)
    metrics, spread = score_images(point, config, folder)
    told = {"schema": SCHEMA, "kind": point.kind(), "spec": point.spec, "weights": point.weights}
    told |= {"metrics": metrics, "pseudo": spread, "reading": reading, "outcome": outcome}
    told |= {"found": found, "code": code_version(), "environment": environment("cpu")}
    told |= {"training_seconds": round(seconds, 1)}
    write_json(path, told | {"seconds": round(time.perf_counter() - began, 1)})
    shutil.rmtree(own, ignore_errors=True)
    return point.label
