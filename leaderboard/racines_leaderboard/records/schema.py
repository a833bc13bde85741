"""What the leaderboard's files are checked against: their JSON Schemas, and a record's seal.

The seal is the sha256 of what a record says, written when the record is. It notices that a record
was edited, or damaged, afterwards. Whoever edits a record can seal it again; that is noticed by
recomputing the numbers alone (`racines audit`).
"""

import functools
import hashlib
import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from referencing import Registry, Resource

from racines_data.digest import canonical_json
from racines_data.errors import RacinesError
from racines_data.files import write_atomic

KEY = "seal"


def check(document: Any, kind: str, where: str) -> None:
    """Check a document against the schema of a kind.

    Raises:
        RacinesError: the first fault, with the file, the field and what was expected.
    """
    if (error := best_match(validator(kind).iter_errors(document))) is not None:
        field = ".".join(map(str, error.absolute_path)) or "top level"
        raise RacinesError(f"{where}: {field}: {error.message}")


def read_json(path: Path, kind: str) -> dict[str, Any]:
    """Read a JSON file of a kind.

    Raises:
        RacinesError: missing or damaged file, NaN or infinity, or a field against the schema.
    """
    finite = functools.partial(_finite, path)
    try:
        document = json.loads(
            path.read_text(encoding="utf-8"), parse_constant=finite, parse_float=finite
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
    if not math.isfinite(value):
        raise RacinesError(
            f"{path}: holds {text[:80]}; write null for a figure that does not exist"
        )
    return value


@functools.cache
def validator(kind: str) -> Draft202012Validator:
    """Return what checks documents of a kind, to be kept where there are many."""
    folder = resources.files("racines_leaderboard") / "schemas"
    contents = {
        path.name: json.loads(path.read_text(encoding="utf-8")) for path in folder.iterdir()
    }
    registry = Registry().with_resources(
        (schema["$id"], Resource.from_contents(schema)) for schema in contents.values()
    )
    return Draft202012Validator(contents[f"{kind}.json"], registry=registry)


def seal_of(record: dict[str, Any]) -> str:
    """Return the sha256 of a record but for its seal; neither order nor spaces count."""
    told = {key: value for key, value in record.items() if key != KEY}
    return hashlib.sha256(canonical_json(told).encode()).hexdigest()


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with the seal of what it says."""
    return {key: value for key, value in record.items() if key != KEY} | {KEY: seal_of(record)}
