"""Configuration: documented dataclasses, filled from a section of a profile or a params file.

A value is checked against its field's annotation as JSON is: an integer does for a float and a list
for a tuple; nothing else is converted.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import MISSING
from importlib import resources
from pathlib import Path
from typing import Any, Required, TypeVar, get_type_hints

import yaml
from typing_extensions import TypedDict

from racines_data.errors import RacinesError

PROFILES = ("smoke", "default", "patients", "reference", "paper", "abdomen")
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class _Top:
    """What stands beside the sections."""

    seed: int = 0
    board: str | None = None
    patient_boards: tuple[str, ...] = ()
    """Tiers of patients whose boards, called like them, these settings are for as well."""


class Settings(dict[str, Any]):
    """Settings of a file; a section of them, and what `|` makes of them, still know its name."""

    def __init__(self, values: Mapping[str, Any], file: str) -> None:
        super().__init__(values)
        self.file = file

    def __or__(self, other: Any) -> "Settings":
        return Settings({**self, **other}, self.file)

    def __ror__(self, other: Any) -> "Settings":
        return Settings({**other, **self}, self.file)

    def of(self, *names: str) -> "Settings":
        """Return those of these names that are there."""
        return Settings({name: self[name] for name in names if name in self}, self.file)


# YAML writes its own dictionaries alone; settings are written as what they are.
yaml.SafeDumper.add_representer(Settings, yaml.SafeDumper.represent_dict)


def read_params(params: Path | None = None, profile: str | None = None) -> Settings:
    """Read a params file, or a packaged profile (`default` when neither is named).

    Raises:
        RacinesError: unknown profile, missing file, YAML that is not a mapping, or a `seed` or
            `board` of the wrong type.
    """
    if params is not None and profile is not None:
        raise RacinesError("give --params or --profile, not both")
    if params is not None:
        if not params.is_file():
            raise RacinesError(f"{params}: no such file; name a params.yaml or use --profile")
        text, name = params.read_text(encoding="utf-8"), str(params)
    else:
        name = profile or "default"
        if name not in PROFILES:
            raise RacinesError(f"unknown profile {name!r}: choose one of {', '.join(PROFILES)}")
        text = (resources.files("racines_data") / "profiles" / f"{name}.yaml").read_text(
            encoding="utf-8"
        )
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RacinesError(f"{name}: not valid YAML: {error}") from error
    if not isinstance(content, dict):
        raise RacinesError(f"{name}: expected a mapping of sections")
    content = Settings(content, name if params else f"profile {name}")
    fill(_Top, content.of("seed", "board", "patient_boards"), "")
    return content


def section(params: Mapping[str, Any], path: str | tuple[str, ...]) -> Settings:
    """Return the section at a dotted path, or at the names of one; what is absent is empty.

    Raises:
        RacinesError: what stands there is no mapping.
    """
    names = path.split(".") if isinstance(path, str) else path
    node, file = params, getattr(params, "file", "")
    for count, name in enumerate(names, start=1):
        node = node.get(name) or {}
        if not isinstance(node, Mapping):
            where = _prefix(file) + ".".join(names[:count])
            raise RacinesError(f"{where}: {node!r} is no mapping: give keys and values")
    return Settings(node, file)


def fill(config: type[T], values: Mapping[str, Any], where: str = "params") -> T:
    """Build a config dataclass from a mapping, nested dataclasses included.

    What a nested mapping leaves out keeps the default that the outer dataclass gives it.

    Raises:
        RacinesError: every unknown, missing or wrong key, by its full name, with what is allowed.
    """
    from pydantic import TypeAdapter, ValidationError

    text = json.dumps(values, default=str)
    try:
        checked = TypeAdapter(_shape(config)).validate_json(text, strict=True)
    except ValidationError as error:
        faults = "; ".join(_fault(config, dict(each), where) for each in error.errors())
        raise RacinesError(_prefix(getattr(values, "file", "")) + faults) from None
    return config(**_filled(config, checked))


def _prefix(file: str) -> str:
    return f"{file}: " if file else ""


def _shape(config: Any) -> Any:
    """Return the type of the mappings that fill a config, by the annotations of its fields."""
    kind = config if isinstance(config, type) else type(config)
    hints = get_type_hints(kind, include_extras=True)
    shapes = {}
    for name, default in _defaults(config).items():
        shapes[name] = _shape(default) if _is_config(default) else hints[name]
        if default is MISSING:
            shapes[name] = Required[hints[name]]
    shape = TypedDict("shape", shapes, total=False)  # pyright: ignore[reportArgumentType]
    settings = {"extra": "forbid", "arbitrary_types_allowed": True}
    setattr(shape, "__pydantic_config__", settings)  # noqa: B010
    return shape


def _filled(config: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that are given, nested ones in the place of those of the default."""
    filled = dict(values)
    for name, default in _defaults(config).items():
        if name in values and _is_config(default):
            filled[name] = dataclasses.replace(default, **_filled(default, values[name]))
    return filled


def _fault(config: Any, error: dict[str, Any], where: str) -> str:
    path = [str(part) for part in error["loc"]]
    place = ".".join([where, *path] if where else path)
    if error["type"] == "extra_forbidden":
        for name in path[:-1]:
            config = _defaults(config)[name]
        return f"{place}: unknown key; known: {', '.join(_defaults(config)) or 'none'}"
    if error["type"] == "missing":
        return f"{place}: needed, and left out"
    value, allowed = error["input"], error["msg"].removeprefix("Input should be ")
    return f"{place}: {value!r} is {type(value).__name__}, expected {allowed}"


def _is_config(default: Any) -> bool:
    return dataclasses.is_dataclass(default) and not isinstance(default, type)


def _defaults(config: Any) -> dict[str, Any]:
    """Return what the fields of an instance hold, or a class's defaults; `MISSING` for none."""
    fields = dataclasses.fields(config)
    if not isinstance(config, type):
        return {field.name: getattr(config, field.name) for field in fields}
    return {
        each.name: each.default if each.default_factory is MISSING else each.default_factory()
        for each in fields
    }
