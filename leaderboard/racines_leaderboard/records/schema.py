"""JSON Schemas of the leaderboard's files, and reading a file against one."""

import functools
import json
import math
from importlib import resources
from pathlib import Path
from typing import Any, NoReturn

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from referencing import Registry, Resource

from racines_data.errors import RacinesError
from racines_data.files import write_atomic

EXPERT_KINDS = ("expert-kit", "expert-key", "expert-rating", "expert-scores", "expert-record")
KINDS = (
    "any",
    "generator-scores",
    "agent-scores",
    "submission",
    "submission-1",
    "record",
    "audit",
    *EXPERT_KINDS,
)


def check(document: Any, kind: str, where: str) -> None:
    """Check a document against the schema of a kind.

    Raises:
        RacinesError: the first fault, with the file, the field and what was expected.
    """
    error = best_match(validator(kind).iter_errors(document))
    if error is None:
        return
    field = ".".join(str(part) for part in error.absolute_path) or "top level"
    raise RacinesError(f"{where}: {field}: {error.message}")


def read_json(path: Path, kind: str) -> dict[str, Any]:
    """Read a JSON file of a kind.

    Raises:
        RacinesError: missing or damaged file, NaN or infinity, or a field against the schema.
    """
    try:
        document = json.loads(
            path.read_text(),
            parse_constant=lambda text: _not_finite(path, text),
            parse_float=lambda text: _finite(path, text),
        )
    except FileNotFoundError as error:
        raise RacinesError(f"{path}: no such file") from error
    except (OSError, ValueError, RecursionError) as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}") from error
    check(document, kind, str(path))
    return document


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write a record as it lies on a board."""
    write_atomic(path, json.dumps(record, indent=2, ensure_ascii=False) + "\n")


def _finite(path: Path, text: str) -> float:
    """Return a number; JSON's grammar has 1e999, which Python reads as infinity."""
    value = float(text)
    return value if math.isfinite(value) else _not_finite(path, text[:80])


def _not_finite(path: Path, constant: str) -> NoReturn:
    raise RacinesError(f"{path}: holds {constant}; write null for a figure that does not exist")


@functools.cache
def validator(kind: str) -> Draft202012Validator:
    """Return what checks documents of a kind, to be kept where there are many."""
    folder = resources.files("racines_leaderboard") / "schemas"
    contents = {
        name: json.loads((folder / f"{name}.json").read_text())
        for name in (*KINDS, "common", "metric")
    }
    registry = Registry().with_resources(
        (schema["$id"], Resource.from_contents(schema)) for schema in contents.values()
    )
    return Draft202012Validator(contents[kind], registry=registry)
