"""The import law: racines_data <- racines_models <- racines_envs <- racines_leaderboard."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

ORDER = ("racines_data", "racines_models", "racines_envs", "racines_leaderboard")
FOLDERS = dict(zip(ORDER, (".", "models", "envs", "leaderboard"), strict=True))
OUTER = {"models", "envs", "leaderboard", "data"}


def imported(source: str) -> Iterator[str]:
    """Yield the top-level package of every import, those inside functions included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").split(".")[0] if node.level == 0 else ""
        elif isinstance(node, ast.Call) and _names_import(node.func) and node.args:
            name = node.args[0]
            if isinstance(name, ast.Constant) and isinstance(name.value, str):
                yield name.value.split(".")[0]


def _names_import(function: ast.expr) -> bool:
    name = getattr(function, "attr", getattr(function, "id", ""))
    return name in ("import_module", "__import__", "lazy_import")


def faults(package: str, source: str) -> set[str]:
    right = set(ORDER[ORDER.index(package) + 1 :])
    return set(imported(source)) & (right | OUTER)


@pytest.mark.parametrize("package", ORDER)
def test_nothing_imports_to_its_right(package: str):
    files = sorted((ROOT / FOLDERS[package] / package).rglob("*.py"))
    assert files, f"{package} is not where it belongs"
    found = {
        str(path.relative_to(ROOT)): names
        for path in files
        if (names := faults(package, path.read_text()))
    }
    assert not found


@pytest.mark.parametrize(
    "source",
    [
        "import racines_envs",
        "from racines_leaderboard.board.rank import rank",
        "def f():\n    from racines_envs import core",
        "import importlib\nimportlib.import_module('racines_envs.task.core')",
        "from models.racines_models import grader",
    ],
)
def test_the_law_sees_every_kind_of_import(source: str):
    assert faults("racines_models", source)
    assert not faults("racines_models", "from racines_data.views import VIEWS\nimport torch")


def test_importing_the_packages_makes_no_file_and_no_random_state(tmp_path: Path):
    """Importing does nothing: no folders, no global seeds (STYLE rule 13)."""
    code = (
        "import torch, random, numpy as np\n"
        "def state():\n"
        "    return torch.get_rng_state().tolist(), random.getstate(), "
        "np.random.get_state()[1].tolist()\n"
        "before = state()\n"
        f"import {', '.join(ORDER)}\n"
        "assert state() == before, 'importing changed a global random state'\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    assert not list(tmp_path.iterdir())
