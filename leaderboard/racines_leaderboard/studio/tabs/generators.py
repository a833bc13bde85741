"""The tab in which generators stand side by side at a pose of twelve sliders."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import gradio as gr
from gradio.context import Context

from racines_data.errors import RacinesError
from racines_leaderboard.studio import side_by_side
from racines_leaderboard.studio.html import missing, note, text
from racines_leaderboard.studio.inputs import whole
from racines_leaderboard.studio.parts import Place, load_store, trained_generators
from racines_leaderboard.studio.side_by_side import Slider, cards_page, draw_cards
from racines_leaderboard.studio.tabs import wiring

TICKED = 4
"""Generators that are ticked at first: those that lead a board."""
INTRODUCTION = note(
    "What each generator draws at a pose, beside the phantom and the nearest frame of the dataset. "
    "SSIM and PSNR are against the phantom's image, whose noise is drawn from the seed. Simulated "
    "images."
)


def build(place: Place) -> None:
    """Build the tab."""
    tab, offered = Context.block, list(trained_generators(place))
    try:
        handles, names = side_by_side.sliders(place), side_by_side.presets(place)
        values = side_by_side.first(place)
    except RacinesError as error:  # a damaged dataset is no reason to close the other tabs
        gr.HTML(f'<p class="rc-refused" role="alert">{text(error)}</p>')
        return
    gr.HTML(INTRODUCTION + _missing(place, offered))
    with gr.Row():
        preset = gr.Dropdown(names, value=names[0], label="Pose", min_width=150)
        seed = gr.Number(place.seed, label="Seed", precision=0, minimum=0, min_width=90)
    with gr.Row():
        go = gr.Button("Set this pose", variant="primary", elem_id="generators-set", min_width=140)
        again = gr.Button("Random test frame", elem_id="generators-frame", min_width=140)
    best = side_by_side.leading(place, offered)[:TICKED]
    ticked = gr.CheckboxGroup(offered, value=best, label="Generators")
    turn, said = gr.State(0), gr.HTML(elem_id="generators-note")
    cards = gr.HTML(elem_id="generators-cards")
    moved = _sliders(handles, values)

    def draw(seed: Any, ticked: Any, *values: Any) -> str:
        return cards_page(draw_cards(place, values, seed, ticked))

    wire, busy = wiring("generators", in_turn=True), {"show_progress_on": [cards]}
    drawn = draw, [seed, ticked, *moved], [cards]
    set_pose, next_frame = partial(_preset, place), partial(_frame, place)
    pose = wire([go.click, preset.input], "set", set_pose, [preset], [said, *moved], **busy)
    wire(pose.success, "draw_set", *drawn, **busy)
    frame = wire(again.click, "frame", next_frame, [turn], [turn, said, *moved], **busy)
    wire(frame.success, "draw_frame", *drawn, **busy)
    triggers = [each.input for each in moved] + [ticked.input, seed.submit, seed.blur]
    wire(triggers, "draw", *drawn, trigger_mode="always_last", show_progress="hidden")
    if isinstance(tab, gr.Tab):
        wire(tab.select, "open", *drawn, **busy)


def _sliders(handles: Sequence[Slider], values: Sequence[float]) -> list[gr.Slider]:
    """Return the twelve sliders at their values, three a group."""
    made, pairs = [], list(zip(handles, values, strict=True))
    for first in range(0, len(handles), 3):
        group, unit = handles[first].name.rpartition("_")[0].capitalize(), handles[first].unit
        with gr.Accordion(f"{group}, {unit}", open=first < 6), gr.Row():
            for handle, value in pairs[first : first + 3]:
                label = f"{handle.name.rpartition('_')[2]}, {unit}"
                slider = gr.Slider(
                    handle.low, handle.high, value, step=handle.step, label=label,
                    elem_id=f"generators-{handle.name}", min_width=240,
                )  # fmt: skip
                made.append(slider)
    return made


def _missing(place: Place, offered: Sequence[str]) -> str:
    """Return what is not there, and which command makes it."""
    trained = f"No trained generator in {place.weights} or {place.runs}. Train one:"
    data = f"No dataset in {place.data}, so no nearest frame. Build it:"
    said = "" if offered else missing(trained, "racines train generator cgan")
    return said + (missing(data, "racines data build") if load_store(place) is None else "")


def _preset(place: Place, name: Any) -> list[Any]:
    return [note(f"{name} pose"), *side_by_side.preset(place, name)]


def _frame(place: Place, turn: Any) -> list[Any]:
    turn = whole(turn, 0, 2**31, "turn")
    values, which = side_by_side.frame(place, turn)
    return [turn + 1, note(f"test split, {which}"), *values]
