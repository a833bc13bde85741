"""The page: tables of every board in HTML, and what its script needs as JSON."""

import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

from racines_data.errors import RacinesError
from racines_data.escape import html, json_in_html
from racines_data.files import write_atomic
from racines_leaderboard.board.about import about
from racines_leaderboard.board.rank import Ranked, tied, verdict_of
from racines_leaderboard.board.table import (
    REPORTED,
    Table,
    figure_text,
    place_of,
    reported_tables,
    shown_metric,
    steady,
)
from racines_leaderboard.board.web.content import (
    Section,
    axis_of,
    kind_of,
    pairs,
    read_sections,
)
from racines_leaderboard.board.web.drawing import interval_svg
from racines_leaderboard.board.web.methods import Shown, card, found_by_view
from racines_leaderboard.records.tracks import Column

LARGEST = 1_500_000
"""Bytes of the page of the published boards at most, a sixth of it compressed; a test holds it."""


def write_html(path: Path, results: Path) -> None:
    """Write the page of all boards.

    Raises:
        RacinesError: no results, or a damaged record.
    """
    write_atomic(path, html_page(results))


def html_page(results: Path) -> str:
    """Return the page of all boards as HTML, with its style, script and data inside."""
    found = read_sections(results)
    if not found:
        raise RacinesError(f"{results}: no results of any board")
    parts, told = [], {}
    for number, (board, sections) in enumerate(found.items()):
        parts.append(_board(board, sections, f"b{number}", results))
        for place, section in enumerate(sections):
            told[f"b{number}-{place}"] = {
                "names": section.names, "pairs": list(pairs(section)),
            }  # fmt: skip
    tabs = "".join(
        f'<a href="#b{number}" id="tab-b{number}">{html(board)}</a>'
        for number, board in enumerate(found)
    )
    verdicts = sorted({verdict_of(each.record) for sections in found.values()
                       for section in sections for each in section.ranking})  # fmt: skip
    options = "".join(
        f'<option value="{html(each or "none")}">{html(each or "no verdict")}</option>'
        for each in verdicts
    )
    folder = files("racines_leaderboard.board.web")
    style, script = (
        folder.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js")
    )
    page = Template(folder.joinpath("page.html").read_text(encoding="utf-8"))
    return page.substitute(
        style=style, script=script, tabs=tabs, boards="\n".join(parts), verdicts=options,
        content=json_in_html({"sections": told}),
    )  # fmt: skip


def _board(board: str, sections: Sequence[Section], key: str, results: Path) -> str:
    found = found_by_view(list(sections))
    parts = [
        f'<section class="board" id="{key}" aria-labelledby="{key}-h">',
        f'<h2 id="{key}-h">{html(board)}</h2><p>{html(about(board))}</p>',
    ]
    for place, section in enumerate(sections):
        parts.append(_section(section, f"{key}-{place}", results, found))
    for track in {section.track.name: section.track for section in sections}.values():
        parts += [_reported(table) for table in reported_tables(track)]
    return "".join([*parts, "</section>"])


def _section(section: Section, key: str, results: Path, found: Shown) -> str:
    axes = {column: axis_of(column, section.ranking) for column in section.columns}
    shared = tied(section.ranking)
    head = ("#", "System", "Kind", *(column.title for column in section.columns),
            "Trainings", section.track.unit.capitalize(), "Verdict", "Tier")  # fmt: skip
    rows = [
        _row(section, ranked, place_of(ranked, shared), f"{key}-{row}", axes)
        for row, ranked in enumerate(section.ranking)
    ]
    cards = [
        card(section, ranked, f"{key}-{row}", results, found)
        for row, ranked in enumerate(section.ranking)
    ]
    notes = "".join(f"<p>{html(note)}</p>" for note in section.table.notes)
    return (
        f'<div class="ranking" data-key="{key}"><h3 id="{key}-h">{html(section.title)}</h3>'
        f'<div class="scroll" tabindex="0" role="region" aria-labelledby="{key}-h"><table>'
        f"<thead><tr>{_heads(head)}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        '<p class="empty" hidden>No row passes the filters.</p>'
        f'<div class="compare" role="status" aria-live="polite"></div>'
        f'<details class="about"><summary>Methods of this table</summary><div class="cards">'
        f"{''.join(cards)}</div></details>"
        f'<details class="notes"><summary>How to read it</summary>{notes}</details></div>'
    )


def _heads(titles: Sequence[str]) -> str:
    return "".join(f'<th scope="col"{_sticky(title)}>{html(title)}</th>' for title in titles)


def _sticky(title: str) -> str:
    return ' class="name"' if title == "System" else ""


def _row(
    section: Section, ranked: Ranked, place: str, key: str, axes: dict[Column, tuple[float, float]]
) -> str:
    record, standing, kind = ranked.record, ranked.standing, kind_of(ranked)
    verdict = verdict_of(record)
    cells = [
        f'<td class="place"{_value(ranked.place)}>{html(place)}</td>',
        f'<th scope="row" class="name"><a href="#{key}">{html(record["name"])}</a></th>',
        f"<td>{kind}</td>",
        *(_figure(ranked, column, axes[column]) for column in section.columns),
        f'<td class="n"{_value(standing.trainings)}>{standing.trainings or "–"}</td>',
        f'<td class="n"{_value(standing.units)}>{standing.units or "–"}</td>',
        f'<td><span class="v {_class(verdict)}">{html(verdict or "–")}</span></td>',
        f"<td>{html(record['tier'])}</td>",
    ]
    method = (record.get("submission") or {}).get("method", "")
    return (
        f'<tr class="{kind}" data-kind="{kind}" data-trainings="{standing.trainings or 0}" '
        f'data-verdict="{html(verdict or "none")}" data-text="{html(method)}">{"".join(cells)}</tr>'
    )


def _class(verdict: str) -> str:
    return re.sub(r"[^a-z]+", "-", verdict) or "none"


def _value(number: float | None) -> str:
    return "" if number is None else f' data-v="{steady(number):.6g}"'


def _figure(ranked: Ranked, column: Column, axis: tuple[float, float]) -> str:
    metric = shown_metric(ranked.record, column)
    if metric is None:
        return '<td class="f">–</td>'
    value, low, high = (
        None if metric[key] is None else metric[key] * column.scale
        for key in ("value", "low", "high")
    )
    assert value is not None
    number, _, between = figure_text(metric, column).partition(" ")
    return (
        f'<td class="f"{_value(value)}><b>{html(number)}</b> <small>{html(between)}</small>'
        f"{interval_svg(value, low, high, axis)}</td>"
    )


def _reported(table: Table) -> str:
    """Return the paper's own figures: without places, apart from the ranking."""
    rows = "".join(
        f'<tr><th scope="row" class="name">{html(name)}</th>'
        f"{''.join(f'<td>{html(cell)}</td>' for cell in cells)}</tr>"
        for _, name, *cells in table.rows
    )
    notes = "".join(f"<p>{html(note)}</p>" for note in table.notes)
    return (
        f'<details class="paper"><summary>{html(table.title)}</summary><p><b>{html(REPORTED)}:</b> '
        "nothing here is compared with the rows above.</p>"
        f'<div class="scroll" tabindex="0" role="region" aria-label="{html(table.title)}"><table>'
        f"<thead><tr>{_heads(table.head[1:])}</tr></thead><tbody>{rows}</tbody></table></div>"
        f"{notes}</details>"
    )
