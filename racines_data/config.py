"""Configuration: documented dataclasses, filled from a section of a profile or a params file."""

import dataclasses
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml

from racines_data.errors import RacinesError

PROFILES = ("smoke", "default", "reference", "paper", "abdomen")
T = TypeVar("T")


def read_params(params: Path | None = None, profile: str | None = None) -> dict[str, Any]:
    """Read a params file, or a packaged profile (`default` when neither is named).

    Raises:
        RacinesError: unknown profile, missing file, or YAML that is not a mapping.
    """
    if params is not None and profile is not None:
        raise RacinesError("give --params or --profile, not both")
    if params is not None:
        if not params.is_file():
            raise RacinesError(f"{params}: no such file; name a params.yaml or use --profile")
        text, name = params.read_text(), str(params)
    else:
        name = profile or "default"
        if name not in PROFILES:
            raise RacinesError(f"unknown profile {name!r}: choose one of {', '.join(PROFILES)}")
        text = (resources.files("racines_data") / "profiles" / f"{name}.yaml").read_text()
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RacinesError(f"{name}: not valid YAML: {error}") from error
    if not isinstance(content, dict):
        raise RacinesError(f"{name}: expected a mapping of sections")
    return content


def section(params: dict[str, Any], path: str) -> dict[str, Any]:
    """Return the section at a dotted path; an absent or empty one is an empty mapping."""
    node: Any = params
    for key in path.split("."):
        node = (node or {}).get(key)
    return dict(node or {})


def fill(config: type[T], values: dict[str, Any], where: str = "params") -> T:
    """Build a config dataclass from a mapping, nested dataclasses included.

    What a nested mapping leaves out keeps the default that the outer dataclass gives it.

    Raises:
        RacinesError: an unknown key or a value of the wrong type, by its full name.
    """
    return config(**_filled(config, values, where))


def _filled(config: Any, values: dict[str, Any], where: str) -> dict[str, Any]:
    fields = {f.name: f for f in dataclasses.fields(config)}
    filled: dict[str, Any] = {}
    for key, value in values.items():
        if key not in fields:
            known = ", ".join(fields) or "none"
            raise RacinesError(f"{where}.{key}: unknown key; known: {known}")
        default = _default(config, fields[key])
        if (
            dataclasses.is_dataclass(default)
            and not isinstance(default, type)
            and isinstance(value, dict)
        ):
            filled[key] = dataclasses.replace(default, **_filled(default, value, f"{where}.{key}"))
        else:
            filled[key] = _coerce(value, default, f"{where}.{key}")
    return filled


def _default(config: Any, field: dataclasses.Field[Any]) -> Any:
    if not isinstance(config, type):
        return getattr(config, field.name)
    if field.default is not dataclasses.MISSING:
        return field.default
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return None


def _coerce(value: Any, default: Any, where: str) -> Any:
    if default is None or value is None:
        return value
    if isinstance(default, tuple) and isinstance(value, list):
        return tuple(value)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(default):
        raise RacinesError(
            f"{where}: {value!r} is {type(value).__name__}, expected {type(default).__name__}"
        )
    return value
