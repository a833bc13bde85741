"""The published weights, and whether their files are whole: `models/weights/manifest.json`.

The manifest says of each set what it is, what its files are, and which boards and records name
them. Nothing heavy is imported.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_models.published.places import CARRIED, WEIGHTS, published

SCHEMA = "racines.weights/1"
CATALOGUE = WEIGHTS / "manifest.json"
NONE_HERE = (
    "no published weights here: they come with a checkout of the repository; run in one, or "
    "install the package from a wheel, which carries a few"
)


@dataclass(frozen=True)
class WeightsSet:
    """A published set of weights: one method, its further seeds included."""

    name: str
    folder: str
    """Where its files lie, from the root of the checkout."""
    what: str
    files: dict[str, dict[str, Any]]
    """`bytes` and `sha256` of each file, by its path in the folder."""
    boards: list[str]
    """Boards that name a file of it: in a row, or as a judge."""
    records: list[str]
    """Records whose weights they are, from the root of the checkout."""

    def paths(self, root: Path) -> Iterator[Path]:
        """Yield where its files lie under a root."""
        return (root / self.folder / name for name in self.files)

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(each["bytes"] for each in self.files.values())

    def to_json(self) -> dict[str, Any]:
        """Return the set as JSON, with its size."""
        return {**asdict(self), "bytes": self.bytes}


@dataclass(frozen=True)
class Catalogue:
    """The sets of a checkout, or those that an installed wheel carries, by name."""

    root: Path
    """The checkout, or the folder in the package that is laid out as one."""
    sets: dict[str, WeightsSet]
    hub: str | None = None
    """Who has the repositories of the sets on the Hub; None where nobody is named."""
    elsewhere: int = 0
    """How many more sets a checkout has than this wheel."""

    def restore(self, path: Path | str) -> str:
        """Return the command that brings a file or folder, named from the root, back."""
        if self.root == CARRIED:
            return "pip install --force-reinstall --no-deps racines"
        return f"git -C {self.root} restore {path}"

    def named(self, name: str) -> WeightsSet:
        """Return a set by name; raises `RacinesError` if there is none, with those nearest."""
        if name in self.sets:
            return self.sets[name]
        near = get_close_matches(name, self.sets) or [
            each for each in self.sets if name in each.split("/")
        ]
        meant = f"did you mean {' or '.join(near)}?" if near else "see racines weights list"
        raise RacinesError(f"weights {name!r}: none of that name; {meant}")


def read_catalogue() -> Catalogue:
    """Read the manifest of the current folder's weights, or else of the code's checkout.

    Raises:
        RacinesError: there is none, or it is damaged.
    """
    path = published(CATALOGUE)
    if not path.is_file():
        raise RacinesError(f"{path}: {NONE_HERE}")
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        if told["schema"] != SCHEMA:
            raise ValueError(f"schema {told['schema']!r}, not {SCHEMA}")
        sets = {name: WeightsSet(name, **each) for name, each in told["sets"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RacinesError(
            f"{path}: damaged ({error}); get it again: git restore {path}"
        ) from error
    root = path.parents[len(CATALOGUE.parts) - 1]
    here = sets
    if root == CARRIED:
        here = {
            name: each for name, each in sets.items() if any(map(Path.is_file, each.paths(root)))
        }
    return Catalogue(root, here, told.get("hub"), len(sets) - len(here))


def broken_files(
    catalogue: Catalogue, sets: Iterable[WeightsSet], full: bool = True
) -> list[dict[str, str]]:
    """Return the files that are not as published: `file`, `problem` and `remedy` of each.

    With `full` every file is hashed; or else sizes alone are compared.
    """
    found = []
    for each in sets:
        for name, told in each.files.items():
            path = Path(each.folder, name)
            if problem := problem_of(catalogue.root / path, told, full):
                remedy = f"get it again: {catalogue.restore(path)}"
                found.append({"file": str(path), "problem": problem, "remedy": remedy})
    return found


def problem_of(path: Path, told: dict[str, Any], full: bool = True) -> str:
    """Return what is wrong with a file, or nothing."""
    if not path.is_file():
        return "missing"
    if (size := path.stat().st_size) != told["bytes"]:
        return f"damaged ({size} bytes, expected {told['bytes']})"
    if full and (found := sha256_file(path)) != told["sha256"]:
        return f"damaged (sha256 {found[:12]}, expected {told['sha256'][:12]})"
    return ""
