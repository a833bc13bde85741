"""The notebooks of the documentation: how they are run, and what of them is kept."""

import os
import re
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

from tests.conftest import BIN, ROOT

FOLDER = ROOT / "docs/notebooks"
SECONDS = 600
"""A cell that takes longer hangs."""
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def run(path: Path) -> Any:
    """Return a notebook with the outputs of a run in a kernel of its own, and no more."""
    notebook = nbformat.read(path, as_version=4)
    environment = os.environ | {
        "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "100",
        "TERM": "dumb",
        # A bar that moves once on a quick machine moves twice on a slow one.
        "HF_DATASETS_DISABLE_PROGRESS_BARS": "1",
        "PYTHONWARNINGS": "ignore:IProgress not found",  # widgets of a bar that is not shown
    }
    client = NotebookClient(notebook, timeout=SECONDS, kernel_name="python3", record_timing=False)
    client.execute(env=environment)
    return tidied(notebook)


def tidied(notebook: Any) -> Any:
    """Return a notebook without what differs from run to run or from machine to machine."""
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number}", {}
        if cell.cell_type == "code":
            cell.outputs = _joined(cell.outputs)
        for output in cell.get("outputs", ()):
            output.get("metadata", {}).clear()
            if "image/png" in output.get("data", {}):
                output.data = {"image/png": output.data["image/png"]}
            if output.output_type == "stream":
                output.text = ESCAPES.sub("", output.text.replace("\r\n", "\n"))
    return notebook


def _joined(outputs: list[Any]) -> list[Any]:
    """Return outputs with what was printed in pieces as one, however it arrived."""
    joined: list[Any] = []
    for output in outputs:
        last: Any = joined[-1] if joined else {}
        if output.output_type == "stream" and last.get("name") == output.name:
            last.text += output.text
        else:
            joined.append(output)
    return joined


def texts(notebook: Any) -> list[str]:
    """Return what each cell of code printed or answered, without pictures."""
    told = []
    for cell in notebook.cells:
        if cell.cell_type == "code":
            parts = (o.get("text") or o.get("data", {}).get("text/plain", "") for o in cell.outputs)
            told.append("".join(parts))
    return told
