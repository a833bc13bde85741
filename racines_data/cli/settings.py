"""What commands read their settings from: a params file, a packaged profile, and options."""

from pathlib import Path
from typing import Any

import typer
import yaml

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


def overrides(pairs: list[str] | None) -> dict[str, Any]:
    """Return what `--set NAME=VALUE` gives; a value is read as in a params file."""
    values = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"{pair!r}: write NAME=VALUE", param_hint="--set")
        values[name] = yaml.safe_load(value)
    return values


def seed_of(settings: dict[str, Any], seed: int | None) -> int:
    """Return the seed that was given, or else that of the settings."""
    return settings.get("seed", 0) if seed is None else seed


def check_ending(out: Path, ending: str) -> None:
    """Refuse a file to write of another kind."""
    if out.suffix.lower() != ending:
        raise typer.BadParameter(f"{out}: end the name with {ending}", param_hint="--out")
