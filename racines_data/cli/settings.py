"""What commands read their settings from: a params file, a packaged profile, and options."""

from pathlib import Path
from typing import Any

from racines_data.config import read_params


def read_settings(params: Path | None, profile: str | None) -> dict[str, Any]:
    """Return the settings of a file or a profile; ./params.yaml, if it is there, for neither."""
    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    return read_params(params, profile)


def given(**options: Any) -> dict[str, Any]:
    """Return the options that were given on the command line, paths as text."""
    values = {name: value for name, value in options.items() if value is not None}
    return {name: str(each) if isinstance(each, Path) else each for name, each in values.items()}


def seed_of(settings: dict[str, Any], seed: int | None) -> int:
    """Return the seed that was given, or else that of the settings."""
    return settings.get("seed", 0) if seed is None else seed
