"""The tab in which generators stand side by side at a pose of twelve sliders."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import gradio as gr
from gradio.context import Context

from racines_data.errors import RacinesError
from racines_leaderboard.studio import side_by_side
from racines_leaderboard.studio.html import missing, refusal, text
from racines_leaderboard.studio.inputs import whole
from racines_leaderboard.studio.parts import load_store, trained_generators
from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.side_by_side import CSS, cards_page
from racines_leaderboard.studio.tabs import one_at_a_time, refusing

TICKED = 4
"""Generators that are ticked at first: those that lead a board."""
ONE = one_at_a_time("generators")
"""One pose after the other, for all visitors."""
INTRODUCTION = (
    '<p class="rc-note">What each generator draws at a pose, beside the phantom and the nearest '
    "frame of the dataset. SSIM and PSNR are against the phantom's image, whose noise is drawn "
    "from the seed. Simulated images.</p>"
)
TITLES = {"position": "Position", "rotation": "Rotation", "force": "Force", "torque": "Torque"}


def build(place: Place) -> None:
    """Build the tab."""
    tab, offered = Context.block, list(trained_generators(place))
    try:
        handles, names = side_by_side.sliders(place), side_by_side.presets(place)
        values = side_by_side.first(place)
    except RacinesError as error:  # a damaged dataset is no reason to close the other tabs
        gr.HTML(refusal(error))
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
    turn, note = gr.State(0), gr.HTML(elem_id="generators-note")
    cards = gr.HTML(css_template=CSS, elem_id="generators-cards")
    moved = _sliders(handles, values)
    busy: dict[str, Any] = ONE | {"show_progress_on": [cards]}
    quiet: dict[str, Any] = ONE | {"show_progress": "hidden"}
    draw: dict[str, Any] = {
        "fn": refusing(partial(_draw, place)), "inputs": [seed, ticked, *moved], "outputs": [cards],
    }  # fmt: skip
    gr.on(
        [go.click, preset.input], refusing(partial(_preset, place)), [preset], [note, *moved],
        api_name="generators_set", **busy,
    ).success(**draw, api_name="generators_draw_set", **busy)  # fmt: skip
    again.click(
        refusing(partial(_frame, place)), [turn], [turn, note, *moved],
        api_name="generators_frame", **busy,
    ).success(**draw, api_name="generators_draw_frame", **busy)  # fmt: skip
    triggers = [each.input for each in moved] + [ticked.input, seed.submit, seed.blur]
    gr.on(triggers, **draw, trigger_mode="always_last", api_name="generators_draw", **quiet)
    if isinstance(tab, gr.Tab):
        tab.select(**draw, api_name="generators_open", **busy)


def _sliders(handles: Sequence[side_by_side.Slider], values: Sequence[float]) -> list[gr.Slider]:
    """Return the twelve sliders at their values, three a group."""
    made, pairs = [], list(zip(handles, values, strict=True))
    for first in range(0, len(handles), 3):
        group = handles[first].name.rpartition("_")[0]
        with gr.Accordion(f"{TITLES[group]}, {handles[first].unit}", open=first < 6), gr.Row():
            for handle, value in pairs[first : first + 3]:
                label = f"{handle.name.rpartition('_')[2]}, {handle.unit}"
                slider = gr.Slider(
                    handle.low, handle.high, value, step=handle.step, label=label,
                    elem_id=f"generators-{handle.name}", min_width=240,
                )  # fmt: skip
                made.append(slider)
    return made


def _missing(place: Place, offered: Sequence[str]) -> str:
    """Return what is not there, and which command makes it."""
    said = ""
    if not offered:
        said += missing(
            f"No trained generator in {place.weights} or {place.runs}. Train one:",
            "racines train generator cgan",
        )
    if load_store(place) is None:
        said += missing(
            f"No dataset in {place.data}, so no nearest frame. Build it:", "racines data build"
        )
    return said


def _preset(place: Place, name: Any) -> list[Any]:
    return [f'<p class="rc-note">{text(name)} pose</p>', *side_by_side.preset(place, name)]


def _frame(place: Place, turn: Any) -> list[Any]:
    turn = whole(turn, 0, 2**31, "turn")
    values, which = side_by_side.frame(place, turn)
    return [turn + 1, f'<p class="rc-note">test split, {text(which)}</p>', *values]


def _draw(place: Place, seed: Any, ticked: Any, *values: Any) -> str:
    return cards_page(side_by_side.draw_cards(place, values, seed, ticked))
