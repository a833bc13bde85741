"""The files that a mapping names: inside the folder, regular, and of a size that makes sense."""

import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from string import Formatter
from typing import Any

from racines_data.errors import RacinesError

_PLAIN = re.compile(r"[^{}.\[\]!]+")
_SPEC = re.compile(r"0?\d{0,2}d?")
_MOST = 200_000
"""Files that a folder may hold."""
_ABSENT = "no such file"


@dataclass(frozen=True)
class Folder:
    """A folder of recordings; nothing outside it is ever opened."""

    root: Path
    """Resolved."""

    def file(self, name: str, field: str) -> Path:
        """Return a file by its name relative to the folder.

        Args:
            name: The name, with `/` between folders.
            field: Field of the mapping that led to it, for the message.

        Raises:
            RacinesError: the name leads out of the folder, by itself or by a link, or there is no
                such file, or it is a folder, a FIFO or a device.
        """
        found = self.find(name, field)
        if found is None:
            raise RacinesError(f"{field}: {name}: no such file in {self.root}")
        return found

    def find(self, name: str, field: str) -> Path | None:
        """Return a file as `file` does, or None where there is none of that name."""
        where = f"{field}: {name}"
        if not name or "\0" in name:
            raise RacinesError(f"{where}: not a file name; check the column or the pattern")
        path = Path(name.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts:
            raise RacinesError(
                f"{where}: leads out of {self.root}: name files relative to the folder"
            )
        return self._inside(self.root / path, where)

    def _inside(self, path: Path, where: str) -> Path | None:
        reason = self.fault(path)
        if reason == _ABSENT:
            return None
        if reason:
            raise RacinesError(f"{where}: {reason}")
        return path

    def fault(self, path: Path) -> str:
        """Return why a path in the folder is no file that may be opened, or nothing."""
        reason = _fault(path)
        if not reason and not (real := path.resolve()).is_relative_to(self.root):
            reason = f"a link out of the folder, to {real}"
        return reason if reason in ("", _ABSENT) else f"{reason}: put the file itself there"

    def match(self, template: str, field: str, **values: str) -> list[Path]:
        """Return the files that a pattern with `*` matches, or the one that a name names.

        In natural order: 2 before 10. No sign but `*` and `?` of the template is a wildcard.

        Args:
            template: The name or pattern.
            field: Of the mapping, for messages.
            values: What stands in the place of names in braces, if any, to the letter.

        Raises:
            RacinesError: as for `file`, or nothing matches.
        """
        pattern = fill_in(template, values, field) if values else template
        if "*" not in template and "?" not in template:
            return [self.file(pattern, field)]
        if pattern.startswith("/") or ".." in Path(pattern).parts or "**" in template:
            raise RacinesError(f"{field}: {pattern}: give a pattern inside the folder, without **")
        searched = template.replace("[", "[[]")
        if values:
            literal = {name: escape(value) for name, value in values.items()}
            searched = fill_in(searched, literal, field)
        found = sorted(self.root.glob(searched), key=lambda path: natural(self.name(path)))
        found = [path for path in found if not path.name.startswith(".")]
        if not found:
            raise RacinesError(f"{field}: no file in {self.root} matches {pattern}")
        inside = [self._inside(path, f"{field}: {self.name(path)}") for path in found]
        return [path for path in inside if path is not None]

    def name(self, path: Path) -> str:
        """Return how a file is named: relative to the folder."""
        return path.relative_to(self.root).as_posix()

    def walk(self) -> list[Path]:
        """Return all regular files inside, hidden ones and links out of the folder aside."""
        found = []
        for path in self.root.rglob("*"):
            if any(part.startswith(".") for part in path.relative_to(self.root).parts):
                continue
            real = path.resolve()
            if real.is_relative_to(self.root) and real.is_file():
                found.append(path)
            if len(found) > _MOST:
                raise RacinesError(f"{self.root}: more than {_MOST} files: name a smaller folder")
        return sorted(found, key=lambda path: natural(self.name(path)))


def open_folder(path: Path) -> Folder:
    """Return a folder that is there; else raise `RacinesError`."""
    if not path.is_dir():
        raise RacinesError(f"{path}: no such folder")
    return Folder(path.resolve())


def named_file(path: Path, remedy: str) -> Path:
    """Return a file that a user names, wherever it lies.

    Raises:
        RacinesError: there is none of that name, or it is a folder, a FIFO or a device; with the
            remedy. A FIFO would be waited for without end.
    """
    if reason := _fault(path):
        raise RacinesError(f"{path}: {reason}: {remedy}")
    return path


def _fault(path: Path) -> str:
    """Return why a path leads to no regular file, or nothing. It is not opened."""
    try:
        kind = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return "a link to nothing" if path.is_symlink() else _ABSENT
    except (OSError, ValueError) as error:
        return f"cannot be opened ({error})"
    if stat.S_ISREG(kind):
        return ""
    what = "a folder" if stat.S_ISDIR(kind) else "a FIFO, a socket or a device"
    return f"{what}, where a file is needed"


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which names sort as people count: img2 before img10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts]


def fields_of(template: str, field: str) -> list[str]:
    """Return the names in braces of a path.

    Raises:
        RacinesError: braces that do not close, or that hold more than a name and a width.
    """
    try:
        parts = list(Formatter().parse(template))
    except ValueError as error:
        raise RacinesError(f"{field}: {template}: {error}") from error
    names = []
    for _, name, spec, conversion in parts:
        if name is None:
            continue
        if conversion or not _PLAIN.fullmatch(name) or not _SPEC.fullmatch(spec or ""):
            raise RacinesError(
                f"{field}: {template}: in braces stands a column's name, or one with a width as "
                "{row:04d}"
            )
        names.append(name)
    return names


def fill_in(template: str, values: Mapping[str, Any], field: str) -> str:
    """Return a path with the values of one row in the place of the names in braces.

    Digits that stand as text, which have zeros before them in a table, are numbers to a width.
    """
    widths = {name for _, name, spec, _ in Formatter().parse(template) if name and spec}
    numbers = {
        name: int(value)
        for name, value in values.items()
        if name in widths and isinstance(value, str) and value.isascii() and value.isdigit()
    }
    try:
        return template.format_map({**values, **numbers})
    except (ValueError, KeyError) as error:
        raise RacinesError(f"{field}: {template}: {error}; values {dict(values)}") from error
