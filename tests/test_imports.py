"""The import law: racines_data <- racines_models <- racines_envs <- racines_leaderboard."""

import ast
import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT, command
from tests.modules import FOLDERS as ROOTS
from tests.modules import circles, modules

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


def test_no_module_imports_itself_in_a_circle():
    assert not circles()


def test_a_package_shows_its_rooms():
    """At most 32 modules lie flat in the four roots, and no file has more than 400 lines."""
    flat = [
        name for name, path in modules().items() if name.count(".") == 1 and path.stem != "__init__"
    ]
    assert len(flat) <= 32, flat
    rooms = {
        name: [p for p in root.iterdir() if (p / "__init__.py").is_file()]
        for name, root in ROOTS.items()
    }
    assert all(5 <= len(found) <= 12 for found in rooms.values()), rooms
    long = {name for name, path in modules().items() if len(path.read_text().splitlines()) > 400}
    assert not long


@pytest.mark.parametrize("name", sorted(n for n, p in modules().items() if p.stem == "__init__"))
def test_a_room_says_what_it_is_for_and_what_it_offers(name: str):
    """Its text is there, and each name that it offers is found where the stub says."""
    module = importlib.import_module(name)
    assert module.__doc__ and len(module.__doc__.split()) >= 5
    if modules()[name].with_name("__init__.pyi").is_file():
        assert module.__all__ == sorted(module.__all__)
        assert all(getattr(module, offered) is not None for offered in module.__all__)


def test_old_names_import_the_very_same_modules(tmp_path: Path):
    """Every name that a module had, and every path that the documentation ever named."""
    named = (ROOT / "tests" / "documented_names.txt").read_text().split()
    assert len(named) >= 197
    code = """
import importlib, sys, warnings
from racines_data.renamed import renamed_modules
for old, new in renamed_modules().items():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert importlib.import_module(old) is importlib.import_module(new), old
    said = [str(each.message) for each in caught if each.category is DeprecationWarning]
    assert f"{old} is now {new}" in said, (old, said)
def resolve(name):
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            assert error.name and name.startswith(error.name), error
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise AssertionError(name)
for name in sys.argv[1:]:
    resolve(name)
"""
    command(tmp_path, "python", "-c", code, *named)


def test_an_unknown_name_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("racines_data.card_framez")
