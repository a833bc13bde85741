"""Tab: the boards, filtered, with intervals and charts, and where each record comes from."""

from typing import Any

import gradio as gr

from racines_leaderboard.board.collect import boards
from racines_leaderboard.records.tracks import TIERS
from racines_leaderboard.studio import boards as shown
from racines_leaderboard.studio.boards import charts_html, tables_html
from racines_leaderboard.studio.html import missing
from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.provenance import provenance_html
from racines_leaderboard.studio.tabs import refusing

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
        gr.HTML(
            missing(
                f"{place.results}: no results of any board yet. Score a system and collect it:",
                "racines eval generator nearest-pose",
                "racines leaderboard --board my-board --collect models/runs/scores",
            )
        )
        return
    with gr.Row():
        board = gr.Dropdown(names, value=names[-1], label="Board", min_width=200)
        track = gr.Radio(shown.TRACK_NAMES, value=shown.TRACK_NAMES[0], label="Track")
    with gr.Row(visible=False) as of_agents:
        view = gr.Dropdown([shown.ALL], value=shown.ALL, label="View", min_width=300)
        sees = gr.Radio(
            [shown.ALL, *shown.SIGHT], value=shown.ALL, label="The agent sees", min_width=300
        )
    tiers = gr.CheckboxGroup(list(TIERS), value=list(TIERS), label="Tier")
    details = gr.Checkbox(False, label="Further figures")
    tables = gr.HTML(js_on_load=ROW_CLICKED, elem_id="boards-tables")
    charts = gr.HTML(elem_id="boards-charts")
    system = gr.Dropdown([], label="Where a result comes from (or click its row)")
    record = gr.HTML(elem_id="boards-record")
    chosen = [board, track, view, sees, tiers, details]
    _wire(place, chosen, of_agents, (tables, charts), system, record)


def _wire(
    place: Place, chosen: list[Any], of_agents: gr.Row, pictures: Any, system: Any, record: Any
) -> None:
    board, track, view, _, _, _ = chosen
    tables, charts = pictures

    def filters(board: Any, track: Any) -> tuple[Any, Any]:
        wanted = shown.selected(place.results, board, track, shown.ALL, shown.ALL, [], False)
        offered = [shown.ALL, *shown.views(place.results, wanted.board, wanted.track)]
        update = gr.Dropdown(choices=offered, value=shown.ALL)
        return gr.Row(visible=wanted.track == "agents"), update

    def show(*values: Any) -> tuple[str, str, Any, str]:
        wanted = shown.selected(place.results, *values)
        tables, charts = (make(place.results, wanted) for make in (tables_html, charts_html))
        offered = shown.names(place.results, wanted)
        return tables, charts, gr.Dropdown(choices=offered, value=None), ""

    def provenance(name: Any, *values: Any) -> str:
        if name is None:
            return ""
        wanted = shown.selected(place.results, *values)
        return provenance_html(shown.record_of(place.results, wanted, name))

    def clicked(event: gr.EventData) -> Any:
        return getattr(event, "name", None)

    private: dict[str, Any] = {"api_visibility": "private", "show_progress": "minimal"}
    gr.on(
        [board.change, track.change], refusing(filters), [board, track], [of_agents, view],
        api_name="boards_filters", **private,
    )  # fmt: skip
    outputs = [tables, charts, system, record]
    gr.on(None, refusing(show), chosen, outputs, api_name="boards_show", **private)
    tables.click(refusing(clicked), None, system, api_name="boards_clicked", **private)
    system.change(
        refusing(provenance), [system, *chosen], record, api_name="boards_record", **private
    )
