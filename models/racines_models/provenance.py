"""Where a number comes from: hashes of files, version of the code, machine."""

import hashlib
import json
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.manifest import UNKNOWN_SCALE, scale_known
from racines_data.processor import processor
from racines_data.store.frames import FrameStore

PASSING = ("seconds", "environment", "code")
"""Of scores: what differs from one run of the same measurement to the next."""
SPEEDS = ("latency", "images_per_second_1", "images_per_second_64", "seconds_to_adapt")
"""Metrics of which the same holds."""


def sha256_bytes(*parts: bytes) -> str:
    """Return the SHA-256 of the concatenated bytes in hexadecimal."""
    return hashlib.sha256(b"".join(parts)).hexdigest()


def weights_sha256(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each safetensors and ONNX file right inside a folder, by name."""
    files = sorted(p for p in folder.glob("*") if p.suffix in (".safetensors", ".onnx"))
    return {file.name: sha256_file(file) for file in files}


def dataset_card(store: FrameStore) -> dict[str, Any]:
    """Return what names a dataset: source, version and the two digests.

    And, where it is so, that the scale of its positions is unknown, and that phases are known.
    """
    keys = ("source", "version", "digest", "recipe_digest")
    told = {key: store.manifest.get(key) for key in keys}
    scale = {} if scale_known(store.manifest) else {"scale": UNKNOWN_SCALE}
    return told | scale | ({"phase": True} if store.phased else {})


def code_version() -> dict[str, Any]:
    """Return the package's version, and the git commit where the code lies in a checkout."""
    command, folder = ["git", "rev-parse", "HEAD"], Path(__file__).parent
    try:
        told = subprocess.check_output(command, cwd=folder, stderr=subprocess.DEVNULL, timeout=10)
        commit = told.decode().strip() or None
    except (OSError, subprocess.SubprocessError):
        commit = None
    return {"version": metadata.version("racines"), "commit": commit}


def same_result(a: Any, b: Any) -> bool:
    """Return whether two documents of scores say the same; times, machine and code do not count."""
    return _lasting(a) == _lasting(b)


def result_sha256(scores: Any) -> str:
    """Return the SHA-256 of what a document of scores says, equal where `same_result` holds."""
    text = json.dumps(_lasting(scores), sort_keys=True, separators=(",", ":"))
    return sha256_bytes(text.encode())


def _lasting(scores: Any) -> Any:
    """Return what does not change when the same is measured again, as JSON gives it back."""
    kept = {key: value for key, value in dict(scores).items() if key not in PASSING}
    metrics = kept.get("metrics", {})
    kept["metrics"] = {key: value for key, value in metrics.items() if key not in SPEEDS}
    return json.loads(json.dumps(kept))


def check_replaces(path: Path, scores: dict[str, Any], force: bool) -> None:
    """Refuse to write scores over others, unless told to; the same ones may be written again.

    Raises:
        RacinesError: the file holds another result, or is no result.
    """
    if force or not path.is_file():
        return
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
        same = same_result(before, scores)
    except (OSError, ValueError, TypeError) as error:
        raise RacinesError(
            f"{path}: is there and holds no scores: --force to replace it"
        ) from error
    if not same:
        raise RacinesError(
            f"{path}: holds another result, of {_of_what(before)}; this one is of "
            f"{_of_what(scores)}: --force to replace it, or write elsewhere"
        )


def check_name(path: Path, kind: str, name: str, force: bool) -> None:
    """Refuse before any work what `check_replaces` would refuse after it, as far as a name tells.

    `kind` is the key of the name: `agent`, `generator` or `motion`.

    Raises:
        RacinesError: the file holds a result of another name.
    """
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return  # nothing there; or what is there is told of once there is something to write
    if not force and isinstance(before, dict) and before.get(kind, name) != name:
        raise RacinesError(
            f"{path}: holds another result, of {_of_what(before)}; this one would be of {name}: "
            "--force to replace it, or write elsewhere"
        )


def _of_what(scores: dict[str, Any]) -> str:
    """Return in a few words what scores were made of."""
    task, data = scores.get("task") or {}, scores.get("dataset") or {}
    made = (scores.get(key) for key in ("generator", "agent", "motion"))
    words = [str(next((each for each in made if each), None))]
    words += [str(task[key]) for key in ("view", "backend") if key in task]
    starts = task.get("start_set")
    if isinstance(starts, dict):
        words.append(f"{starts.get('starts')} starts of sets {starts.get('seeds')}")
    words += [str(data["split"])] if "split" in data else []
    weights = sha256_bytes(json.dumps(scores.get("weights"), sort_keys=True).encode())
    return f"{' '.join(words)} (weights {weights[:8]})"


def environment(device: str = "cpu") -> dict[str, Any]:
    """Return what a floating-point result may depend on: versions, processor, threads."""
    import torch

    described = {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "platform": platform.platform(),
        "cpu": processor(),
        "threads": torch.get_num_threads(),
        "device": device,
    }
    if device.startswith("cuda"):
        described["gpu"] = torch.cuda.get_device_name(device)
    return described
