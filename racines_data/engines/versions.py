"""What a worker has to have in common with the machine that sends it tasks."""

import hashlib
import importlib.util
import platform
from functools import cache
from importlib import metadata
from pathlib import Path

PACKAGES = ("racines_data", "racines_models", "racines_envs", "racines_leaderboard")


@cache
def versions() -> dict[str, str]:
    """Return the versions of racines, torch and Python here, and a hash of our own code."""
    python = ".".join(platform.python_version_tuple()[:2])
    found = {name: metadata.version(name) for name in ("racines", "torch")}
    # A CPU build and a CUDA build of one version round alike on a CPU.
    return {**found, "torch": found["torch"].partition("+")[0], "python": python, "code": _code()}


def _code() -> str:
    """Return a hash of the code of our packages; a checkout keeps its version as it changes."""
    digest = hashlib.sha256()
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        for place in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(Path(place).rglob("*.py")):
                digest.update(path.relative_to(place).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def described(found: dict[str, str]) -> str:
    """Return versions in words."""
    return ", ".join(f"{name} {version}" for name, version in found.items())
