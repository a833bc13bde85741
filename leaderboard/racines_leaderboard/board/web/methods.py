"""A card for each method of a ranking: what it is, a picture or its figures, its record."""

import base64
import io
import shlex
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.escape import html
from racines_leaderboard.board.rank import Ranked, Record, metric_of, verdict_of
from racines_leaderboard.board.standing import anchor
from racines_leaderboard.board.web.content import Section
from racines_leaderboard.board.web.drawing import Bar, bars_svg
from racines_leaderboard.records.columns import PERCENT
from racines_leaderboard.records.pins import anchored, read_pin
from racines_leaderboard.records.verdicts import DOES_NOT_HOLD, HOLDS, NOT_VERIFIED

PICTURES = "pictures"
"""Folder of a board with `<track>/<name>.webp`: left true frames, right the same ones drawn."""
LARGEST = (520, 260)
MEANING = {
    HOLDS: "the last audit made its numbers again from what lies beside the record",
    DOES_NOT_HOLD: "the last audit found that it says something else than its evidence",
    NOT_VERIFIED: "the last audit lacked something to check it with",
    "": "not audited as it stands now",
}
_FOUND = ("success_declared", "success_true")
Shown = dict[tuple[str, str], list[tuple[str, dict[str, Any]]]]


def found_by_view(sections: list[Section]) -> Shown:
    """Return of each agent of a board, by submission and sight, its views and its success there."""
    found: Shown = defaultdict(list)
    for section in sections:
        for ranked in section.ranking if section.track.steers else ():
            told = (metric_of(ranked.record, key) for key in _FOUND)
            metric = next((each for each in told if each is not None), None)
            if metric is None:
                continue
            entry = ranked.record["scores"]["task"]["view"], metric
            views = found[_family(ranked.record)]
            if entry not in views:
                views.append(entry)
    return found


def _family(record: Record) -> tuple[str, str]:
    scores = record["scores"]
    name = (record.get("submission") or {}).get("name") or scores.get("submission")
    name = name or record["name"]
    return str(name), str(scores["task"].get("observation"))


def card(section: Section, ranked: Ranked, key: str, results: Path, found: Shown) -> str:
    """Return the card of a method, to which its row's name leads."""
    record = ranked.record
    told: dict[str, Any] = record.get("submission") or {}
    verdict = verdict_of(record)
    where = f"{record['board']}/{record['track']}/{record['name']}.json"
    audit = f"racines audit {shlex.quote(record['name'])} --board {shlex.quote(record['board'])}"
    about = [
        f"<h4>{html(record['name'])}</h4>",
        f'<p class="pale">{html(told.get("method", "no submission"))}</p>',
        picture(section, ranked, results, found),
        f"<p>{html(told['description'])}</p>" if told.get("description") else "",
        f"<p><b>{html(verdict or 'no verdict')}</b>: {MEANING.get(verdict, '')}. "
        f"Tier: {html(record['tier'])}.</p>",
        f"<p>Record: <code>{html(f'leaderboard/results/{where}')}</code><br>"
        f"Audit: <code>{html(audit)}</code></p>",
    ]
    return f'<article class="card" id="{key}">{"".join(about)}</article>'


def picture(section: Section, ranked: Ranked, results: Path, found: Shown) -> str:
    """Return what there is to see of a method: a drawn frame, or its figures as bars."""
    record = ranked.record
    path = results / section.board / PICTURES / record["track"] / f"{record['name']}.webp"
    if path.is_file():
        return (
            f'<figure><img src="{_packed(path)}" alt="held-out poses: left the truth, right drawn '
            f'by {html(record["name"])}"><figcaption>Held-out poses: left the truth, right the '
            "same drawn by this method.</figcaption></figure>"
        )
    if section.track.steers:
        views = found.get(_family(record), [])
        bars = [_share(view, metric) for view, metric in views]
        counts = sorted({f"{metric['n']:,}" for _, metric in views})
        n = f"n = {' or '.join(counts)} starts a view; lines are {PERCENT} intervals"
        return _charted("Found, by view", bars, n)
    bars = list(_between_anchors(section, record, results))
    return _charted("Between the anchors", bars, "0 and 1 are the anchors of the board")


def _charted(title: str, bars: list[Bar], note: str) -> str:
    if not bars:
        return ""
    return f"<figure>{bars_svg(title, bars)}<figcaption>{title}. {note}.</figcaption></figure>"


def _share(view: str, metric: dict[str, Any]) -> Bar:
    name = view.partition("-")[0]
    told = f"{100 * metric['value']:.0f} %"
    return name, metric["value"], metric.get("low"), metric.get("high"), told


def _between_anchors(section: Section, record: Record, results: Path) -> list[Bar]:
    track = section.track
    part = anchored(record["scores"], track, read_pin(results, section.board))
    metrics = [metric_of(record, key) for key in track.ranked_by]
    if part is None or any(metric is None for metric in metrics):
        return []
    values = [[metric["value"]] for metric in metrics if metric is not None]
    shares = anchor(np.array(values, np.float64), track, part["anchors"]["values"])[:, 0]
    columns = track.ranked_columns()
    return [(column.label, float(share), None, None, f"{round(share, 2) + 0.0:.2f}")
            for column, share in zip(columns, shares, strict=True)]  # fmt: skip


def _packed(path: Path) -> str:
    """Return a picture as a data URL, packed anew so that nothing but pixels is passed on."""
    try:
        with Image.open(path, formats=["WEBP"]) as opened:
            picture = opened.convert("L")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise RacinesError(f"{path}: no WebP picture: {error}; remove it") from error
    picture.thumbnail(LARGEST)
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", quality=70, method=6)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
