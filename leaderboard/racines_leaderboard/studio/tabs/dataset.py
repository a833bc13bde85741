"""Tab: the dataset, trajectory by trajectory and frame by frame."""

from functools import partial
from typing import Any

import gradio as gr
from gradio.context import Context

from racines_data.schema import SPLITS
from racines_leaderboard.studio import browsing
from racines_leaderboard.studio.html import missing, note
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.tabs import wiring


def build(place: Place) -> None:
    """Build the tab."""
    configs = browsing.configs(place.data)
    if not configs:
        what = f"{place.data}: no dataset here. Build one, or fetch one:"
        gr.HTML(missing(what, f"racines data build --out {place.data}", "dvc pull"))
        return
    store = browsing.opened(place.data, configs[0])
    with gr.Row():
        config = gr.Radio(configs, value=configs[0], label="Data", visible=len(configs) > 1)
        split = gr.Radio(list(SPLITS), value=SPLITS[0], label="Split", min_width=260)
        views = [browsing.ALL, *store.labels]
        view = gr.Dropdown(views, value=browsing.ALL, label="Aimed at")
    names = browsing.trajectories(store, SPLITS[0], browsing.ALL)
    name = gr.Dropdown(names, value=names[0], label="Trajectory", elem_id="data-trajectory")
    facts = gr.HTML(elem_id="data-facts")
    frame = gr.Slider(1, 2, value=1, step=1, label="Frame", elem_id="data-frame")
    with gr.Row():
        with gr.Column(min_width=280):
            image = gr.HTML(elem_id="data-image")
            parameters = gr.HTML(elem_id="data-parameters")
        with gr.Column(min_width=280):
            figures = gr.HTML(elem_id="data-figures")
    filters, shown = [config, split, view], [facts, frame, image, parameters, figures]
    wire, page = wiring("data", show_progress="hidden"), Context.root_block
    wire([each.change for each in filters], "listed", partial(_listed, place), filters, name)
    assert page is not None
    # Not at a change of `config`: the name is the old one's until the filters have run.
    wire([page.load, name.change], "show", partial(_show, place), [config, name], shown)
    move, at = partial(_move, place), [config, name, frame]
    wire(frame.input, "move", move, at, shown[2:], trigger_mode="always_last")


def _listed(place: Place, config: Any, split: Any, view: Any) -> Any:
    names = browsing.trajectories(browsing.opened(place.data, config), split, view)
    return gr.Dropdown(choices=names, value=names[0] if names else None)


def _show(place: Place, config: Any, name: Any) -> list[Any]:
    if name is None:  # a filter that no trajectory passes
        return ["", gr.Slider(), "", "", note("No trajectory fits.")]
    trajectory = browsing.trajectory(browsing.opened(place.data, config), name)
    slider = gr.Slider(maximum=max(trajectory.frames, 2), value=1)
    return [browsing.facts_html(trajectory), slider, *_move(place, config, name, 1)]


def _move(place: Place, config: Any, name: Any, frame: Any) -> list[Any]:
    trajectory = browsing.trajectory(browsing.opened(place.data, config), name)
    at = browsing.frame_of(trajectory, frame)
    makers = (browsing.image_html, browsing.parameters_html, browsing.figures_html)
    return [make(trajectory, at) for make in makers]
