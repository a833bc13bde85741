"""The tab in which a visitor watches an agent, with what moved it."""

from functools import partial
from typing import Any

import gradio as gr

from racines_leaderboard.studio import watching
from racines_leaderboard.studio.driving import FIXED_STARTS
from racines_leaderboard.studio.html import missing, text
from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.scene import CSS, image_panel, panels, side_panel
from racines_leaderboard.studio.tabs import one_at_a_time, refusing
from racines_leaderboard.studio.watching import overlay

ONE = one_at_a_time("agent")
"""One episode after the other, for all visitors."""
INTRODUCTION = (
    '<p class="rc-note">An agent acts from a fixed start of the evaluation; then move through its '
    "steps. Attributions (Integrated Gradients) say what in the image moved it: red spoke for, "
    "blue against. Those of the chosen action are there for policies that look at images.</p>"
)


def build(place: Place) -> None:
    """Build the tab."""
    offered = list(watching.agents(place))
    watched = gr.State(None)
    gr.HTML(INTRODUCTION + _missing(place, offered))
    tasks = watching.tasks_of(place, offered[0])
    with gr.Row():
        agent = gr.Dropdown(
            offered, value=offered[0], label="Agent", elem_id="agent-name", min_width=150
        )  # fmt: skip
        task = gr.Dropdown(tasks, value="SC", label="Task", elem_id="agent-task", min_width=110)
        number = gr.Number(
            0, label=f"Start, 0 to {FIXED_STARTS - 1}", precision=0, minimum=0,
            maximum=FIXED_STARTS - 1, min_width=110,
        )  # fmt: skip
    watch = gr.Button("Watch", variant="primary", elem_id="agent-watch")
    with gr.Row():
        step = gr.Slider(
            0, 1, 0, step=1, label="Step", elem_id="agent-step", interactive=False, min_width=260
        )  # fmt: skip
        what = gr.Radio(
            list(watching.EXPLAINED), value=watching.OFF, label="Attributions",
            elem_id="agent-explained", min_width=260,
        )  # fmt: skip
    with gr.Row():
        with gr.Column(scale=5, min_width=320):
            image = gr.HTML(css_template=CSS, elem_id="agent-image")
        with gr.Column(scale=4, min_width=320):
            side = gr.HTML(css_template=CSS, elem_id="agent-side")
    agent.input(
        refusing(partial(_tasks, place)), [agent], [task], api_name="agent_tasks",
        show_progress="hidden", **ONE,
    )  # fmt: skip
    watch.click(
        refusing(partial(_watch, place)), [agent, task, number],
        [watched, step, what, image, side], api_name="agent_watch", show_progress_on=[image], **ONE,
    )  # fmt: skip
    gr.on(
        [step.input, what.input], refusing(partial(_show, place)), [watched, step, what],
        [image, side], api_name="agent_show", trigger_mode="always_last",
        show_progress="hidden", **ONE,
    )  # fmt: skip


def _missing(place: Place, offered: list[str]) -> str:
    if len(offered) > len(watching.UNTRAINED):
        return ""
    return missing(
        f"No trained agent in {place.agents}. Train one:",
        "racines train agent ppo --observation image",
    )


def _tasks(place: Place, agent: Any) -> Any:
    """Offer the tasks of an agent."""
    tasks = watching.tasks_of(place, agent)
    return gr.Dropdown(choices=tasks, value="SC" if "SC" in tasks else tasks[0])


def _watch(place: Place, agent: Any, task: Any, number: Any) -> tuple[Any, ...]:
    """Run the episode; the visitor's state says which it is, and does not hold it."""
    episode = watching.watch(place, agent, task, number)
    slider = gr.Slider(maximum=episode.steps, value=0, interactive=True)
    what = gr.Radio(choices=list(episode.explainable), value=watching.OFF)
    return (agent, task, number), slider, what, *panels(watching.moment(episode, 0))


def _show(place: Place, watched: Any, step: Any, what: Any) -> tuple[Any, Any]:
    if watched is None:
        return gr.skip(), gr.skip()
    episode = watching.watch(place, *watched)
    scene = watching.moment(episode, step)
    if what == watching.OFF:
        return panels(scene)
    drawn, p = watching.explain(episode, step, what)
    explained = f'<p class="rc-note">{text(what)}: p {p:.2f}</p>'
    return image_panel(scene, overlay(scene.image, drawn)) + explained, side_panel(scene)
