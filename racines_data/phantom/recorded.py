"""The phantom that a dataset was acquired from, as its recipe names it."""

from collections.abc import Mapping
from typing import Any

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.manifest import MULTI_PHANTOM
from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig


def phantom_settings(manifest: Mapping[str, Any], config: str) -> dict[str, Any] | None:
    """Return the phantom's settings and version as the recipe names them; None for others."""
    recipe = manifest.get("recipe") or {}
    part = recipe.get(MULTI_PHANTOM if config == MULTI_PHANTOM else "settings") or {}
    settings = (part.get("acquisition") or {}).get("phantom")
    return settings and {"version": part.get("phantom"), "phantom": settings}


def recorded_phantom(manifest: dict[str, Any]) -> PhantomConfig:
    """Return the phantom that a dataset was acquired from.

    Raises:
        RacinesError: the frames are no phantom's, or of another version of it.
    """
    found = phantom_settings(manifest, "frames")
    if found is None:
        raise RacinesError(
            f"the dataset's source is {manifest.get('source')}: only a simulated "
            "phantom can be scanned again; leave noise-ceiling out of `generators`"
        )
    if found["version"] != PHANTOM_VERSION:
        raise RacinesError(
            f"the dataset is of phantom {found['version']}, this is phantom "
            f"{PHANTOM_VERSION}: build it again with racines data build"
        )
    return fill(PhantomConfig, found["phantom"], "manifest.json: recipe: phantom")
