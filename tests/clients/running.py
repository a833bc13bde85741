"""A client's example or script, by the interpreter of the client's own environment."""

import os
import subprocess

from tests.clients.examples import ROOT, interpreter


def run_in(client: str, *words: str) -> str:
    """Run Python with words in a client's environment; return what it printed.

    Raises:
        FileNotFoundError: there is no such environment.
        AssertionError: the run failed, with all that it said.
    """
    python = interpreter(client)
    if not python.exists():
        raise FileNotFoundError(f"no {python}: `make test-clients` makes it")
    # Nothing of this interpreter's; one thread, so that clients are timed alike.
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    environment = {**kept, "OMP_NUM_THREADS": "1", "RAY_DEDUP_LOGS": "0"}
    done = subprocess.run(
        [str(python), *words], env=environment, capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
