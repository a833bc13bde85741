"""What a registry of plug-ins finds, suggests and refuses."""

import re
import sys
from pathlib import Path

import pytest

from racines_data.errors import RacinesError
from racines_data.plugins import Plugins
from tests.plugins.packages import install

KINDS = Plugins("kind", "racines.kinds_of_a_test", ("speak",))
MODULE = """
class Cat:
    @staticmethod
    def speak():
        return "meow"

class Stone:
    pass
"""


@pytest.fixture
def theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A package that registers one of a kind, what is none, and what cannot be imported."""
    (tmp_path / "their_kinds.py").write_text(MODULE)
    (tmp_path / "their_broken.py").write_text("1 / 0")
    (tmp_path / "their_needy.py").write_text("import a_package_that_nobody_has")
    points = {"cat": "their_kinds:Cat", "stone": "their_kinds:Stone", "dog": "their_kinds:Dog"}
    points |= {"broken": "their_broken:Cat", "needy": "their_needy:Cat"}
    install(tmp_path, "their_kinds", {KINDS.group: points})
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in ("their_kinds", "their_broken", "their_needy"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("spec", ["cat", "their_kinds:Cat"])
def test_found_by_name_and_by_module(theirs: Path, spec: str):
    assert KINDS.load(spec).speak() == "meow"
    assert KINDS.names() == ("broken", "cat", "dog", "needy", "stone")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("catt", "unknown kind 'catt': did you mean 'cat'? choose one of broken, cat, "),
        (
            "horse",
            "unknown kind 'horse': choose one of broken, cat, dog, needy, stone, or give mod",
        ),
        ("stone", "their_kinds:Stone is not a kind: lacks speak"),
        ("dog", "kind 'dog' (entry point of racines.kinds_of_a_test): their_kinds has no 'Dog'"),
        (
            "broken",
            "kind 'broken' (entry point of racines.kinds_of_a_test): cannot import their_br",
        ),
        ("broken", "division by zero"),
        ("needy", "pip install a_package_that_nobody_has"),
        ("nowhere:Cat", "kind 'nowhere:Cat': cannot import nowhere: No module named 'nowhere'"),
    ],
)
def test_refusals_name_the_entry_point_and_the_reason(theirs: Path, spec: str, message: str):
    with pytest.raises(RacinesError, match=re.escape(message)):
        KINDS.load(spec)


def test_where_a_file_names_it_no_module_is_imported(theirs: Path):
    closed = Plugins("kind", KINDS.group, or_give="")
    with pytest.raises(RacinesError, match="unknown kind 'their_broken:Cat'.*stone$"):
        closed.load("their_broken:Cat")
    assert "their_broken" not in sys.modules


def test_a_plugin_goes_when_its_package_goes(theirs: Path, monkeypatch: pytest.MonkeyPatch):
    assert "cat" in KINDS.names()
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(theirs)])
    assert KINDS.names() == ()
    with pytest.raises(RacinesError, match="choose one of none, for no installed package"):
        KINDS.load("cat")


def test_two_packages_with_one_name_are_refused(theirs: Path, tmp_path: Path, monkeypatch):
    install(tmp_path / "more", "others", {KINDS.group: {"cat": "pathlib:Path"}})
    monkeypatch.syspath_prepend(str(tmp_path / "more"))
    with pytest.raises(RacinesError, match="kind 'cat' is registered twice, as"):
        KINDS.load("dog")
