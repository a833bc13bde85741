"""Whether the parts of an environment come from one dataset: generator, grader, frames, forces."""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError

ANY = "any"
"""The `data_version` that lets everything pass."""
_SHORTEST = 8  # characters of a digest that name a dataset


def trained_on(part: Any) -> dict[str, Any] | None:
    """Return the source, version and digests of the dataset that a part was made from, if it says.

    A part is a generator (its `data`, or the card in its ONNX file), a store's manifest, or the run
    folder of a grader.
    """
    if isinstance(part, dict):
        return part if part.get("digest") else None
    if isinstance(part, (str, Path)):
        from racines_models.judges.grader.model import read_config

        return trained_on(read_config(Path(part)).get("dataset") or {})
    card = getattr(getattr(part, "interface", None), "card", None)
    told = card.get("data") if isinstance(card, dict) else getattr(part, "data", None)
    return trained_on(told) if isinstance(told, dict) else None


def check_datasets(parts: dict[str, dict[str, Any] | None], wanted: str | None = None) -> None:
    """Check that the parts come from one dataset: equal digests, or equal recipes.

    `parts` names each one's dataset; None, where it does not say, passes unless one is `wanted`, by
    a version, a tag, or eight or more of a digest's first characters; `any` checks nothing.
    """
    if wanted == ANY:
        return
    hint = f"train on one dataset, or let it pass: data_version={ANY!r}"
    if wanted is not None:
        for name, data in parts.items():
            if data is None:
                raise RacinesError(f"{name} does not say which dataset it is from: {hint}")
            if not _named(data, wanted):
                raise RacinesError(f"{name} is from {_title(data)}, not {wanted}: {hint}")
    told = [(name, data) for name, data in parts.items() if data is not None]
    for name, data in told[1:]:
        first, known = told[0]
        if not _same(known, data):
            raise RacinesError(
                f"{first} is from {_title(known)} and {name} from {_title(data)}: {hint}"
            )


def _same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """A rebuild of one recipe on another processor is the same version."""
    recipe = a.get("recipe_digest")
    return a["digest"] == b["digest"] or (recipe is not None and recipe == b.get("recipe_digest"))


def _named(data: dict[str, Any], wanted: str) -> bool:
    version = data.get("version")
    names = (version, f"v{version}", f"{data.get('source')}-v{version}")
    digests = (data["digest"], data.get("recipe_digest") or "")
    begun = any(digest.startswith(wanted) for digest in digests)
    return wanted in names or (len(wanted) >= _SHORTEST and begun)


def _title(data: dict[str, Any]) -> str:
    return f"{data.get('source')} {data.get('version')} ({data['digest'][:_SHORTEST]}…)"
