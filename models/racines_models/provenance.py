"""Where a number comes from: hashes of files, version of the code, machine."""

import hashlib
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

from racines_data.files import sha256_file
from racines_data.store.frames import FrameStore


def sha256_bytes(*parts: bytes) -> str:
    """Return the SHA-256 of the concatenated bytes in hexadecimal."""
    return hashlib.sha256(b"".join(parts)).hexdigest()


def weights_sha256(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each safetensors and ONNX file right inside a folder, by name."""
    files = sorted(p for p in folder.glob("*") if p.suffix in (".safetensors", ".onnx"))
    return {file.name: sha256_file(file) for file in files}


def dataset_card(store: FrameStore) -> dict[str, Any]:
    """Return what names a dataset: source, version and the two digests."""
    keys = ("source", "version", "digest", "recipe_digest")
    return {key: store.manifest.get(key) for key in keys}


def code_version() -> dict[str, Any]:
    """Return the package's version, and the git commit where the code lies in a checkout."""
    command, folder = ["git", "rev-parse", "HEAD"], Path(__file__).parent
    try:
        told = subprocess.check_output(command, cwd=folder, stderr=subprocess.DEVNULL, timeout=10)
        commit = told.decode().strip() or None
    except (OSError, subprocess.SubprocessError):
        commit = None
    return {"version": metadata.version("racines"), "commit": commit}


def environment(device: str = "cpu") -> dict[str, Any]:
    """Return what a floating-point result may depend on: versions, processor, threads."""
    import torch

    described = {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "platform": platform.platform(),
        "cpu": _processor(),
        "threads": torch.get_num_threads(),
        "device": device,
    }
    if device.startswith("cuda"):
        described["gpu"] = torch.cuda.get_device_name(device)
    return described


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    for line in info.read_text().splitlines() if info.is_file() else ():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
