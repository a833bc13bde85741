"""Tab: the boards, filtered, with intervals and charts, and where each record comes from."""

from functools import partial
from typing import Any

import gradio as gr

from racines_leaderboard.board.collect import boards
from racines_leaderboard.records.tracks import TIERS, TRACK
from racines_leaderboard.studio import boards as shown
from racines_leaderboard.studio.html import missing
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.tabs import wiring

ROW_CLICKED = """
element.addEventListener('click', (event) => {
  const row = event.target.closest('tr[data-name]');
  if (row) trigger('click', {name: row.dataset.name});
});
"""


def build(place: Place) -> None:
    """Build the tab."""
    names = boards(place.results)
    if not names:
        what = f"{place.results}: no results of any board yet. Score a system and collect it:"
        collect = "racines leaderboard --board my-board --collect models/runs/scores"
        gr.HTML(missing(what, "racines eval generator nearest-pose", collect))
        return
    with gr.Row():
        board = gr.Dropdown(names, value=names[0], label="Board", min_width=200)
        held = shown.held(place.results, names[0])
        first = held[0]
        track = gr.Radio(held, value=first, label="Track")
    with gr.Row(visible=TRACK[first].steers) as of_agents:
        views = [shown.ALL, *shown.views(place.results, names[0], first)]
        view = gr.Dropdown(views, value=shown.ALL, label="View", min_width=300)
        sights = [shown.ALL, *shown.SIGHT]
        sees = gr.Radio(sights, value=shown.ALL, label="The agent sees", min_width=300)
    tiers = gr.CheckboxGroup(list(TIERS), value=list(TIERS), label="Tier")
    details = gr.Checkbox(False, label="Further figures", elem_id="boards-details")
    tables = gr.HTML(js_on_load=ROW_CLICKED, elem_id="boards-tables")
    charts = gr.HTML(elem_id="boards-charts")
    system = gr.Dropdown([], label="Where a result comes from (or click its row)")
    record = gr.HTML(elem_id="boards-record")
    chosen, outputs = [board, track, view, sees, tiers, details], [tables, charts, system, record]
    wire = wiring("boards", show_progress="minimal")
    filters = partial(_filters, place)
    wire(board.change, "track", partial(_track, place), chosen[:2], track)
    wire([board.change, track.change], "filters", filters, chosen[:2], [of_agents, view])
    wire(None, "show", partial(_show, place), chosen, outputs)
    wire(tables.click, "clicked", _clicked, None, system)
    wire(system.change, "record", partial(_record, place), [system, *chosen], record)


def _track(place: Place, board: Any, track: Any) -> Any:
    """Offer the board's tracks; chosen stays what was, or else is one that the board has."""
    wanted = shown.selected(place.results, board, track, shown.ALL, shown.ALL, [], False)
    held = shown.held(place.results, wanted.board)
    return gr.Radio(choices=held, value=shown.track_held(place.results, wanted.board, wanted.track))


def _filters(place: Place, board: Any, track: Any) -> tuple[Any, Any]:
    wanted = shown.selected(place.results, board, track, shown.ALL, shown.ALL, [], False)
    offered = [shown.ALL, *shown.views(place.results, wanted.board, wanted.track)]
    update = gr.Dropdown(choices=offered, value=shown.ALL)
    return gr.Row(visible=TRACK[wanted.track].steers), update


def _show(place: Place, *values: Any) -> tuple[str, str, Any, str]:
    wanted = shown.selected(place.results, *values)
    systems = gr.Dropdown(choices=shown.names(place.results, wanted), value=None)
    tables = shown.tables_html(place.results, wanted)
    return tables, shown.charts_html(place.results, wanted), systems, ""


def _record(place: Place, name: Any, *values: Any) -> str:
    if name is None:
        return ""
    wanted = shown.selected(place.results, *values)
    return shown.provenance_html(shown.record_of(place.results, wanted, name))


def _clicked(event: gr.EventData) -> Any:
    return getattr(event, "name", None)
