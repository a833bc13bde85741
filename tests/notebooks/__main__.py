"""Run notebooks and keep their outputs: `python -m tests.notebooks [NAME …]`."""

import sys

import nbformat

from racines_data.files import write_atomic
from tests.notebooks import FOLDER, run

if __name__ == "__main__":
    wanted = sys.argv[1:]
    for path in sorted(FOLDER.glob("*.ipynb")):
        if not wanted or path.stem in wanted:
            write_atomic(path, nbformat.writes(run(path)) + "\n")
            print(f"run: docs/notebooks/{path.name}, {path.stat().st_size / 1024:.0f} KiB")
