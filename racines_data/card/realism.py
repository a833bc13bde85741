"""The section of a card on how near the simulated frames are to real ones.

It is written after the build, from reports of `racines study realism`; the manifest keeps them
under `realism`, and under `realism_pictures` the pictures shown with them.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from racines_data.card.frames import number
from racines_data.errors import RacinesError
from racines_data.manifest import MULTI_PHANTOM
from racines_data.tables import code, escape, markdown_table

SCHEMA = "racines.realism/1"
_DIGITS = {"kid": 4, "fid": 1, "local_contrast": 2}
_TITLES = {
    "kid": "KID, Inception pool3, equal n",
    "fid": "FID, Inception pool3, equal n",
    "gray": "gray histogram, Wasserstein, gray levels",
    "gray_by_cell": "the same in 3 × 3 cells of the sector",
    "gray_by_depth": "mean gray by depth, r.m.s., gray levels",
    "local_contrast": "local contrast (5 × 5), Wasserstein, gray levels",
}
_INTRODUCTION = (
    "A distance to real frames means nothing alone, so each figure stands beside that of two "
    "halves of the real set, which a perfect simulator would reach. Same sector mask, equal n; "
    "mean and range over random halves of the patients. The real frames are compared with and are "
    "not part of this dataset."
)


def read_realism(path: Path, manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Read a report and check that it is one, has figures, and measures this dataset.

    Raises:
        RacinesError: it does not.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RacinesError(f"{path}: no readable JSON ({error})") from error
    if not isinstance(content, dict):
        raise RacinesError(f"{path}: not a realism report; make one: racines study realism")
    if content.get("schema") != SCHEMA:
        raise RacinesError(f"{path}: schema is {content.get('schema')!r}, expected {SCHEMA!r}")
    if not content.get("compared", True) or "kid" not in content.get("figures", {}):
        raise RacinesError(f"{path}: holds no comparison; run: racines study realism --real FILE")
    many = manifest.get(MULTI_PHANTOM) or {}
    digest = content.get("dataset", {}).get("digest")
    if digest not in (None, manifest["digest"], many.get("digest")):
        raise RacinesError(
            f"{path}: measures another dataset (content {digest[:16]}, here "
            f"{manifest['digest'][:16]}); run racines study realism on this one"
        )
    return content


def realism_section(manifest: Mapping[str, Any]) -> str:
    """Return the section as Markdown, empty where nothing was measured."""
    reports = manifest.get("realism") or []
    if not reports:
        return ""
    told = (part for content in reports for part in _told(content))
    shown = (
        f"![{escape(Path(name).stem)}]({quote(name)})"
        for name in manifest.get("realism_pictures", [])
    )
    return "\n\n".join(["## Realism", _INTRODUCTION, *told, *shown])


def _told(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield what was measured, the figures, and, where the report has it, what each part brings."""
    yield _measured(content)
    rows = []
    for key, figure in content["figures"].items():
        cells = (_range(figure[side], _DIGITS.get(key, 1)) for side in ("phantom", "real"))
        rows.append((_TITLES.get(key, figure.get("rule", key)), *cells))
    yield markdown_table(("figure", "simulated to real", "real to real"), rows, right=1)
    parts = content.get("ablation") or []
    if parts:
        yield "What each part of the simulation brings (KID without it, and the change):"
        cells = [(part["name"], number(part["kid"]), _signed(part.get("change"))) for part in parts]
        yield markdown_table(("left out or changed", "KID", "change"), cells, right=1)


def _measured(content: Mapping[str, Any]) -> str:
    config = content.get("config") or content.get("dataset", {}).get("config")
    real = content.get("real", {})
    told = (
        f"{escape(content['phantom_frames'])} simulated"
        if "phantom_frames" in content
        else "Simulated"
    )
    told += f" {escape(content.get('view', ''))} frames"
    if "grade_at_least" in content:
        told += f" of grade {content['grade_at_least']:g} or more"
    if config:
        told += f" of {code(config)}"
    if "frames" in real:
        told += f" beside {escape(real['frames'])} real ones of "
        told += f"{escape(real.get('patients', '?'))} patients"
    if "n" in content:
        told += f"; n = {escape(content['n'])}"
    return f"{told}:"


def _range(value: Mapping[str, float], digits: int) -> str:
    low, high = (number(value[key], digits) for key in ("low", "high"))
    return f"{number(value['value'], digits)} ({low} – {high})"


def _signed(value: float | None) -> str:
    if value is None:
        return ""
    return f"+{number(value)}" if value > 0 else number(value)
