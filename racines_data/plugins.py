"""Plug-ins by name: the entry points of installed packages, ours and other people's alike.

    GENERATORS = Plugins("generator", "racines.generators")
    GENERATORS.load("vae-gan")          # what the entry point of that name stands for
    GENERATORS.load("module:Class")     # what no package registers

Nothing is imported before it is asked for.
"""

import difflib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from operator import attrgetter
from typing import Any

from racines_data.errors import RacinesError
from racines_data.extras import install_hint


@dataclass(frozen=True)
class Plugins:
    """The plug-ins of one kind."""

    noun: str
    """What one of them is called in messages."""
    group: str
    """The group of their entry points."""
    members: tuple[str, ...] = ()
    """Attributes that each must have."""
    or_give: str = "module:Class"
    """What may be given in place of a name; empty where only names of entry points are taken."""

    def points(self) -> Mapping[str, EntryPoint]:
        """Return the entry points by name, sorted.

        Raises:
            RacinesError: two packages register different things under one name.
        """
        found: dict[str, EntryPoint] = {}
        for point in _installed(tuple(sys.path)).select(group=self.group):
            # The same package listed twice (a wheel beside an editable install) is no conflict.
            if point.name in found and found[point.name].value != point.value:
                raise RacinesError(
                    f"{self.noun} {point.name!r} is registered twice, as {found[point.name].value} "
                    f"and {point.value}: rename one entry point of {self.group}"
                )
            found[point.name] = point
        return dict(sorted(found.items()))

    def names(self) -> tuple[str, ...]:
        """Return the registered names, sorted."""
        return tuple(self.points())

    def load(self, spec: str) -> Any:
        """Return what a registered name, or `module:attribute`, stands for.

        Raises:
            RacinesError: an unknown name, an import that fails, or an object that is none of these.
        """
        points = self.points()
        if spec in points:
            where, target = f" (entry point of {self.group})", points[spec].value.split("[")[0]
        elif self.or_give and ":" in spec:
            where, target = "", spec
        else:
            raise RacinesError(self._unknown(spec, list(points)))
        found = self._import(target.strip(), f"{self.noun} {spec!r}{where}")
        missing = [member for member in self.members if not hasattr(found, member)]
        if missing:
            article = "an" if self.noun[0] in "aeiou" else "a"
            raise RacinesError(f"{target} is not {article} {self.noun}: lacks {', '.join(missing)}")
        if undone := sorted(getattr(found, "__abstractmethods__", ())):
            raise RacinesError(f"{target}: {self.noun} lacks the methods {', '.join(undone)}")
        return found

    def _unknown(self, spec: str, names: list[str]) -> str:
        near = difflib.get_close_matches(spec, names, 1, 0.7)
        guess = f"did you mean {near[0]!r}? " if near else ""
        known = ", ".join(names) or f"none, for no installed package registers one ({self.group})"
        given = f", or give {self.or_give}" if self.or_give else ""
        return f"unknown {self.noun} {spec!r}: {guess}choose one of {known}{given}"

    def _import(self, target: str, what: str) -> Any:
        module, _, attribute = (part.strip() for part in target.partition(":"))
        try:
            found = import_module(module)
        except Exception as error:  # a plug-in is somebody else's code: it may raise anything
            remedy = ""
            absent = error.name if isinstance(error, ModuleNotFoundError) else None
            if absent and not f"{module}.".startswith(f"{absent}."):
                remedy = f"; it needs {absent}: {install_hint(absent)}"
            raise RacinesError(f"{what}: cannot import {module}: {error}{remedy}") from error
        try:
            return attrgetter(attribute)(found)
        except AttributeError as error:
            raise RacinesError(f"{what}: {module} has no {attribute!r}") from error


@cache
def _installed(path: tuple[str, ...]) -> Any:
    """Return the entry points of all packages on `sys.path`; reading them takes some 30 ms."""
    return entry_points()
