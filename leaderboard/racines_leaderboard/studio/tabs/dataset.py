"""Tab: the dataset, trajectory by trajectory and frame by frame."""

from typing import Any

import gradio as gr
from gradio.context import Context

from racines_data.schema import SPLITS
from racines_leaderboard.studio.html import missing
from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.tabs import PRIVATE, refusing


def build(place: Place) -> None:
    """Build the tab."""
    from racines_leaderboard.studio import browsing

    configs = browsing.configs(place.data)
    if not configs:
        gr.HTML(
            missing(
                f"{place.data}: no dataset here. Build one, or fetch one:",
                f"racines data build --out {place.data}",
                "dvc pull",
            )
        )
        return
    labels = browsing.opened(place.data, configs[0]).labels
    with gr.Row():
        config = gr.Radio(configs, value=configs[0], label="Data", visible=len(configs) > 1)
        split = gr.Radio(list(SPLITS), value=SPLITS[0], label="Split", min_width=260)
        view = gr.Dropdown([browsing.ALL, *labels], value=browsing.ALL, label="Aimed at")
    names = browsing.trajectories(browsing.opened(place.data, configs[0]), SPLITS[0], browsing.ALL)
    name = gr.Dropdown(names, value=names[0], label="Trajectory", elem_id="data-trajectory")
    facts = gr.HTML(elem_id="data-facts")
    frame = gr.Slider(1, 2, value=1, step=1, label="Frame", elem_id="data-frame")
    with gr.Row():
        with gr.Column(min_width=280):
            image = gr.HTML(elem_id="data-image")
            parameters = gr.HTML(elem_id="data-parameters")
        with gr.Column(min_width=280):
            figures = gr.HTML(elem_id="data-figures")
    filters = [config, split, view]
    _wire(place, filters, name, frame, [facts, frame, image, parameters, figures])


def _wire(place: Place, filters: list[Any], name: Any, frame: Any, shown: list[Any]) -> None:
    from racines_leaderboard.studio import browsing, trajectory_page

    config = filters[0]

    def listed(config: Any, split: Any, view: Any) -> Any:
        names = browsing.trajectories(browsing.opened(place.data, config), split, view)
        return gr.Dropdown(choices=names, value=names[0] if names else None)

    def at(config: Any, name: Any, frame: Any) -> tuple[Any, int]:
        trajectory = browsing.trajectory(browsing.opened(place.data, config), name)
        return trajectory, browsing.frame_of(trajectory, frame)

    def show(config: Any, name: Any) -> list[Any]:
        if name is None:  # a filter that no trajectory passes
            return ["", gr.Slider(), "", "", '<p class="rc-note">No trajectory fits.</p>']
        trajectory, first = at(config, name, 1)
        slider = gr.Slider(maximum=max(trajectory.frames, 2), value=1)
        return [trajectory_page.facts_html(trajectory), slider, *_pictures(trajectory, first)]

    def move(config: Any, name: Any, frame: Any) -> list[Any]:
        return _pictures(*at(config, name, frame))

    def _pictures(trajectory: Any, frame: int) -> list[str]:
        makers = (
            trajectory_page.image_html,
            trajectory_page.parameters_html,
            trajectory_page.figures_html,
        )
        return [make(trajectory, frame) for make in makers]

    gr.on(
        [each.change for each in filters], refusing(listed), filters, name,
        api_name="data_listed", **PRIVATE,
    )  # fmt: skip
    page = Context.root_block
    assert page is not None
    # Not at a change of `config`: the name is the old one's until the filters have run.
    triggers = [page.load, name.change]
    gr.on(triggers, refusing(show), [config, name], shown, api_name="data_show", **PRIVATE)
    frame.input(
        refusing(move), [config, name, frame], shown[2:], api_name="data_move",
        trigger_mode="always_last", **PRIVATE,
    )  # fmt: skip
