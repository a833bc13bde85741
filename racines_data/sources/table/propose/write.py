"""A mapping as YAML with a comment a field: what it means, and why it was taken so."""

import textwrap
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Union, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from racines_data.sources.table import mapping as schema

_HEAD = """\
# What is what in this folder, for `racines data import --source table` (docs/table.md).
# Look at it with `racines data inspect` before you import. Lines that begin with # are defaults.
"""
_WIDTH = 100


def write_mapping(content: Mapping[str, Any], notes: Mapping[str, str]) -> str:
    """Return a document of a mapping as commented YAML.

    Args:
        content: The document, as `check_mapping` takes it; it may lack what was not found.
        notes: Why a field is as it is, by its path.
    """
    lines = _Writer(notes).lines(schema.Mapping, content, "", 0, None)
    return _HEAD + "\n".join(lines) + "\n"


@dataclass(frozen=True)
class _Writer:
    notes: Mapping[str, str]

    def lines(
        self, model: type[BaseModel], content: Any, path: str, depth: int, hidden: int | None
    ) -> Iterator[str]:
        """Yield the lines of a part; `hidden` is the depth from which on all is a comment."""
        for name, info in model.model_fields.items():
            place = f"{path}.{name}" if path else name
            given = isinstance(content, Mapping) and name in content
            value = content[name] if given else None
            inner = _model_of(info.annotation, value)
            nested = inner if value is None or isinstance(value, Mapping) else None
            said = _comment(info, inner)
            if place in self.notes:
                said += f"  [{self.notes[place]}]"
            needed = not given and info.is_required() and hidden is None
            off = hidden if hidden is not None or given or needed else depth
            yield from _line(name, said, depth, off, "" if nested else _shown(info, value, given))
            if nested is not None and not (needed and depth):
                yield from self.lines(nested, value, place, depth + 1, off)


def _comment(info: FieldInfo, inner: type[BaseModel] | None) -> str:
    return info.description or ((inner.__doc__ or "").split("\n")[0] if inner else "")


def _shown(info: FieldInfo, value: Any, given: bool) -> str:
    if given:
        return _flow(value)
    return "" if info.is_required() or info.default is None else _flow(info.default)


def _line(name: str, said: str, depth: int, off: int | None, value: str) -> Iterator[str]:
    """Yield a line, its comment above it where both are too long together."""
    before = "  " * depth if off is None else "  " * off + "# " + "  " * (depth - off)
    line = f"{before}{name}:{f' {value}' if value else ''}"
    if not said:
        yield line
    elif len(line) + len(said) + 4 <= _WIDTH:
        yield f"{line}  # {said}"
    else:
        indent = "  " * (depth if off is None else off)
        for part in textwrap.wrap(said, _WIDTH - len(indent) - 2, break_on_hyphens=False):
            yield f"{indent}# {part}"
        yield line


def _flow(value: Any) -> str:
    value = list(value) if isinstance(value, tuple) else value
    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=10_000)
    return text.removesuffix("\n").removesuffix("\n...")


def _model_of(annotation: Any, value: Any) -> type[BaseModel] | None:
    """Return the model of a field; of several kinds, the one that the value names."""
    if _is_model(annotation):
        return annotation
    if get_origin(annotation) not in (Union, types.UnionType):
        return None
    models = [each for each in get_args(annotation) if _is_model(each)]
    for model in models:
        kind = model.model_fields.get("kind")
        if kind is None:
            return model
        if isinstance(value, Mapping) and get_args(kind.annotation) == (value.get("kind"),):
            return model
    return models[0] if models else None


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
