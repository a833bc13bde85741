"""The notebooks run from an empty folder, and what is committed of them is what they print."""

import re
import shlex
from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.conftest import ROOT
from tests.notebooks import FOLDER, run, texts

PATHS = sorted(FOLDER.glob("*.ipynb"))
NAMES = [path.stem for path in PATHS]
QUICK = "data"
"""The one that `.ci/run` runs; the others score for longer, and are run each week."""
PLACE = re.compile(r"(?<![\w.])/(?:work|home|root|tmp|Users|usr|opt)/|site-packages|\\Users\\")
NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?|\b[0-9a-f]{16,}\b|-{2,}")
LARGEST = 1_000_000
FACTS = {
    "data": ["900 frames in 40 trajectories", "A4C", "ejection fraction"],
    "generator": ["noise-ceiling", "best width on validation", "kind: predictions"],
    "agent": ["Discrete(13)", "looking-tour", "servo"],
    "audit": [
        "holds (exit code 0)",
        "does not hold (exit code 1)\n  seal",
        "does not hold (exit code 1)\n  evidence",
        "metrics.final_grade.value: recomputed: differs by 0.3",
    ],
}
"""What each has to print, whatever the processor."""


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def masked(text: str) -> str:
    """Return a text without its numbers, which differ from processor to processor."""
    return " ".join(NUMBER.sub("#", text).split())


def test_each_is_in_the_menu_and_has_its_facts():
    menu = (ROOT / "mkdocs.yml").read_text()
    assert all(f"notebooks/{name}.ipynb" in menu for name in NAMES)
    assert set(NAMES) == set(FACTS) and QUICK in NAMES


@pytest.mark.parametrize("path", PATHS, ids=NAMES)
def test_what_is_committed_is_small_and_names_no_machine(path: Path):
    notebook = read(path)
    nbformat.validate(notebook)
    assert path.stat().st_size < LARGEST
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [o for o in outputs if o.output_type == "error" or o.get("name") == "stderr"]
    shown = "\n".join([*texts(notebook), *(cell.source for cell in notebook.cells)])
    assert not PLACE.search(shown), PLACE.search(shown)
    assert sum("image/png" in o.get("data", {}) for o in outputs) >= 1
    assert all(cell.metadata == {} for cell in notebook.cells), "python -m tests.notebooks"
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1)), "run as a whole: python -m tests.notebooks"


@pytest.mark.parametrize("path", PATHS, ids=NAMES)
def test_each_begins_with_the_way_to_install_and_warns(path: Path):
    first, second, *_ = read(path).cells
    assert "pip install -e ." in first.source and "OWNER/REPOSITORY" in first.source
    assert "not a medical device" in first.source and f"notebooks/{path.name}" in first.source
    assert second.source.startswith("# !git clone") and "RACINES_QUIET" in second.source


@pytest.mark.parametrize("path", PATHS, ids=NAMES)
def test_pages_that_are_named_are_there_and_commands_are_commands(path: Path):
    from tests.test_docs import parse

    for cell in read(path).cells:
        if cell.cell_type == "markdown":
            for target in re.findall(r"\]\(([\w./-]+)\)", cell.source):
                assert (FOLDER / target).is_file(), target
        for line in re.findall(r"^\s*!(racines [^>\n]*)", cell.source, re.MULTILINE):
            parse(shlex.split(line.replace("{name}", "mean-image"))[1:])


@pytest.mark.parametrize("path", PATHS, ids=NAMES)
def test_the_facts_stand_in_what_is_committed(path: Path):
    shown = "\n".join(texts(read(path)))
    assert [fact for fact in FACTS[path.stem] if fact not in shown] == []


@pytest.mark.docs
@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.thorough] * (p.stem != QUICK)) for p in PATHS],
)
def test_a_notebook_runs_and_prints_what_is_committed(path: Path):
    committed, made = texts(read(path)), run(path)
    printed = texts(made)
    assert [masked(text) for text in printed] == [masked(text) for text in committed]
    shown = "\n".join(printed)
    assert [fact for fact in FACTS[path.stem] if fact not in shown] == []
    assert not [o for c in made.cells for o in c.get("outputs", ()) if o.get("name") == "stderr"]
