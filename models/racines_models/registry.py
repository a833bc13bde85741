"""Generators by name: entry points of the group `racines.generators`, or `module:Class`."""

import importlib
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from racines_data.errors import RacinesError
from racines_models.protocol import Generator

GROUP = "racines.generators"
MEMBERS = ("name", "Config", "card", "fit", "generate", "save", "load")
"""What a class needs to be a generator."""


def _points() -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=GROUP):
        # The same package listed twice (a wheel beside an editable install) is no conflict.
        if point.name in found and found[point.name].value != point.value:
            raise RacinesError(
                f"generator {point.name!r} is registered twice, as {found[point.name].value} and "
                f"{point.value}: rename one entry point of {GROUP}"
            )
        found[point.name] = point
    return found


def generator_names() -> list[str]:
    """Return the names that installed packages register, sorted."""
    return sorted(_points())


def generator_class(spec: str) -> type[Generator]:
    """Return the class of a registered name or of `module:Class`.

    Raises:
        RacinesError: unknown name (the known ones are listed), or a class that is no generator.
    """
    points = _points()
    if spec in points:
        target = points[spec].value
    elif ":" in spec:
        target = spec
    else:
        raise RacinesError(
            f"unknown generator {spec!r}: choose one of {', '.join(sorted(points))}, "
            "or give module:Class"
        )
    cls = _import(target)
    missing = [member for member in MEMBERS if not hasattr(cls, member)]
    if missing:
        raise RacinesError(f"{target} is not a generator: it lacks {', '.join(missing)}")
    return cls


def _import(target: str) -> type[Generator]:
    module, _, attribute = target.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute.strip())
    except ImportError as error:
        raise RacinesError(f"generator {target}: cannot import {module}: {error}") from error
    except AttributeError as error:
        raise RacinesError(f"generator {target}: {module} has no {attribute!r}") from error


def load_generator(spec: str, run_dir: Path | str, device: str = "cpu") -> Generator:
    """Return the fitted generator that a run left in `run_dir`.

    Raises:
        RacinesError: unknown name, or no such model in the folder.
    """
    return generator_class(spec).load(Path(run_dir), device)
