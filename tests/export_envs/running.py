"""Scripts that run in the environment of a library that our packages do not fit beside."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

HERE = Path(__file__).parent


def run_in(library: str, *words: str, **variables: str) -> str:
    """Run a script with the interpreter of a library's own environment; skip if there is none.

    Returns what it wrote to stdout.
    """
    python = ROOT / f".venv-{library}" / "bin" / "python"
    if not python.exists():
        pytest.skip(f"no environment {python.parents[1].name}: make test-exports makes it")
    # Nothing of this interpreter's path, and no hub.
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    environment = {**kept, "HF_HUB_OFFLINE": "1", **variables}
    done = subprocess.run(
        [str(python), *words], env=environment, capture_output=True, text=True, cwd=HERE
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
