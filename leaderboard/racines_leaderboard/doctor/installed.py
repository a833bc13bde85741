"""What is installed, held against what the package's metadata asks for."""

import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from typing import Any

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from racines_models.published.places import CHECKOUT

KEY = ("torch", "torchrl", "tensordict", "gymnasium", "datasets", "numpy", "polars", "monai")
"""Packages that are named in any case, since results hang on them most."""


def python() -> dict[str, Any]:
    """Return the version of Python, what is asked for, and whether they fit."""
    asked = next(iter(metadata("racines").get_all("Requires-Python") or [""]))
    here = platform.python_version()
    return {"version": here, "asked": asked, "fits": SpecifierSet(asked).contains(here, True)}


def packages() -> list[dict[str, Any]]:
    """Return each package that is needed in any case, as `_package` tells it."""
    return [_package(each) for each in _asked("")]


def extras() -> list[dict[str, Any]]:
    """Return each extra: whether it is usable, what it lacks, how to install it."""
    found = []
    for name in sorted(metadata("racines").get_all("Provides-Extra") or ()):
        parts = [_package(each) for each in _asked(name)]
        lacking = [each["name"] for each in parts if not each["fits"]]
        found.append({"name": name, "usable": not lacking, "lacking": lacking,
                      "install": install(name)})  # fmt: skip
    return found


def install(extra: str = "") -> str:
    """Return the pip command for the package, with an extra if one is named."""
    brackets = f"[{extra}]" if extra else ""
    if (CHECKOUT / "pyproject.toml").is_file():
        return f'pip install -e ".{brackets}" -c constraints.txt'
    return f'pip install "racines{brackets}"'


def _asked(extra: str) -> Iterator[Requirement]:
    """Yield what is asked for in any case, or by an extra alone; what is for other systems not."""
    for line in requires("racines") or ():
        asked = Requirement(line)
        marker = asked.marker
        always = marker is None or marker.evaluate({"extra": ""})
        of_it = marker is not None and not always and marker.evaluate({"extra": extra})
        if of_it if extra else always:
            yield asked


def _package(asked: Requirement) -> dict[str, Any]:
    """Return name, version (None if it is not there), range, and whether the one is in the other.

    What follows a `+`, as in `2.13.0+cpu`, names a build and no version.
    """
    try:
        here = version(asked.name)
    except PackageNotFoundError:
        here = None
    fits = here is not None and asked.specifier.contains(here, prereleases=True)
    return {"name": asked.name, "version": here, "asked": str(asked.specifier), "fits": fits}
