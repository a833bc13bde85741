"""The YAML of a submission as what a stranger wrote: plain data, bounded, one meaning only."""

import math
import unicodedata
from pathlib import Path
from typing import Any

import yaml

from racines_data.errors import RacinesError
from racines_leaderboard.submissions.file_checks import read_bounded

MAX_BYTES = 64 * 2**10
MAX_DEPTH = 12
CONTROLS = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Unicode categories that cannot be seen, or that turn the text around them."""


class _PlainLoader(yaml.SafeLoader):
    """Safe YAML without what makes it more than data: aliases, merges, doubled keys, depth."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are refused: write the value out")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.YAMLError(f"nested more than {MAX_DEPTH} deep")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value]
        for key in keys:
            if not isinstance(key, str) or key == "<<" or keys.count(key) > 1:
                raise yaml.YAMLError(f"key {str(key)[:80]!r}: refused, or stands twice")
        return super().construct_mapping(node, deep)


def read_yaml(folder: Path, name: str) -> Any:
    """Read a YAML file of plain data.

    Raises:
        RacinesError: no such regular file, over 64 KiB, not YAML, or more than data.
    """
    path = folder / name
    content = read_bounded(folder, name, str(folder), MAX_BYTES)
    try:
        document = yaml.load(content.decode(), _PlainLoader)
    except (UnicodeDecodeError, ValueError, yaml.YAMLError, RecursionError) as error:
        raise RacinesError(f"{path}: not readable as YAML: {error}") from error
    check_text(document, str(path))
    return document


def check_text(value: Any, where: str) -> None:
    """Check that every text can be shown on one line as it is, and every number is finite.

    Raises:
        RacinesError: an invisible character, or a number that no field can mean.
    """
    if isinstance(value, dict):
        for key, each in value.items():
            check_text(key, where)
            check_text(each, f"{where}: {key}")
    elif isinstance(value, list):
        for i, each in enumerate(value):
            check_text(each, f"{where}.{i}")
    elif isinstance(value, str):
        bad = next((c for c in value if unicodedata.category(c) in CONTROLS), None)
        if bad is not None:
            raise RacinesError(f"{where}: character U+{ord(bad):04X} refused: visible text only")
    elif isinstance(value, float) and not math.isfinite(value):
        raise RacinesError(f"{where}: {value}: give a finite number, or leave it out")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise RacinesError(f"{where}: a number beyond 64 bits")
