"""The tab in which a visitor watches an agent, with what moved it."""

from functools import partial
from typing import Any

import gradio as gr

from racines_envs.robots.arm import FREE
from racines_leaderboard.studio import watching
from racines_leaderboard.studio.driving import FIXED_STARTS, robots
from racines_leaderboard.studio.html import missing, note
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.scene import image_panel, panels, side_panel
from racines_leaderboard.studio.tabs import wiring

INTRODUCTION = note(
    "An agent acts from a fixed start of the evaluation; then move through its steps. Attributions "
    "(Integrated Gradients) say what in the image moved it: red spoke for, blue against. Those of "
    "the chosen action are there for policies that look at images."
)


def build(place: Place) -> None:
    """Build the tab."""
    offered = list(watching.agents(place))
    watched = gr.State(None)
    said = INTRODUCTION
    if len(offered) == len(watching.UNTRAINED):
        train = "racines train agent ppo --observation image"
        said += missing(f"No trained agent in {place.agents}. Train one:", train)
    gr.HTML(said)
    tasks, last = watching.tasks_of(place, offered[0]), FIXED_STARTS - 1
    with gr.Row():
        agent = gr.Dropdown(
            offered, value=offered[0], label="Agent", elem_id="agent-name", min_width=150
        )  # fmt: skip
        task = gr.Dropdown(tasks, value="SC", label="Task", elem_id="agent-task", min_width=110)
        number = gr.Number(
            0, label=f"Start, 0 to {last}", precision=0, minimum=0, maximum=last, min_width=110
        )  # fmt: skip
        robot = gr.Dropdown(
            list(robots()), value=FREE, label="Carried by", elem_id="agent-robot", min_width=110
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
            image = gr.HTML(elem_id="agent-image")
        with gr.Column(scale=4, min_width=320):
            side = gr.HTML(elem_id="agent-side")
    wire, quiet = wiring("agent", in_turn=True), {"show_progress": "hidden"}
    wire(agent.input, "tasks", partial(_tasks, place), [agent], [task], **quiet)
    shown = [watched, step, what, image, side]
    started = partial(_watch, place)
    wire(
        watch.click, "watch", started, [agent, task, number, robot], shown, show_progress_on=[image]
    )
    wire(
        [step.input, what.input], "show", partial(_show, place), shown[:3], shown[3:],
        trigger_mode="always_last", **quiet,
    )  # fmt: skip


def _tasks(place: Place, agent: Any) -> Any:
    """Offer the tasks of an agent."""
    tasks = watching.tasks_of(place, agent)
    return gr.Dropdown(choices=tasks, value="SC" if "SC" in tasks else tasks[0])


def _watch(place: Place, agent: Any, task: Any, number: Any, robot: Any) -> tuple[Any, ...]:
    """Run the episode; the visitor's state says which it is, and does not hold it."""
    episode = watching.watch(place, agent, task, number, robot)
    slider = gr.Slider(maximum=episode.steps, value=0, interactive=True)
    what = gr.Radio(choices=list(episode.explainable), value=watching.OFF)
    return (agent, task, number, robot), slider, what, *panels(watching.moment(episode, 0))


def _show(place: Place, watched: Any, step: Any, what: Any) -> tuple[Any, Any]:
    if watched is None:
        return gr.skip(), gr.skip()
    episode = watching.watch(place, *watched)
    scene = watching.moment(episode, step)
    if what == watching.OFF:
        return panels(scene)
    drawn, p = watching.explain(episode, step, what)
    image = image_panel(scene, watching.overlay(scene.image, drawn))
    return image + note(f"{what}: p {p:.2f}"), side_panel(scene)
