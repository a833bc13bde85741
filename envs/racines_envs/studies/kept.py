"""What a long study keeps of itself on the way, so that one that was killed goes on."""

import json
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError


def read_kept(path: Path, study: str, force: bool = False) -> dict[str, Any]:
    """Return what a JSON file holds of a study; nothing where there is none.

    Args:
        path: The file.
        study: A digest of all that decides the study's figures; the file has it as `study`.
        force: What the file holds is to be replaced, and counts as nothing.

    Raises:
        RacinesError: without `force`, a file of another study, or a damaged one.
    """
    if force or not path.is_file():
        return {}
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}; remove it") from error
    if isinstance(kept, dict) and kept.get("study") == study:
        return kept
    raise RacinesError(f"{path}: holds another study: give another --out, or --force")
