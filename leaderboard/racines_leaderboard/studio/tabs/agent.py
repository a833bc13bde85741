"""The tab in which a visitor watches an agent, with what moved it."""

from functools import partial
from typing import Any

import gradio as gr
from gradio.context import Context

from racines_envs.robots.arm import FREE
from racines_leaderboard.studio import links, watching
from racines_leaderboard.studio.driving import robots
from racines_leaderboard.studio.html import missing, note
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.scene import image_panel, panels
from racines_leaderboard.studio.tabs import wiring
from racines_leaderboard.studio.worlds import (
    FIRST_PATIENT,
    FIXED_STARTS,
    PATIENTS_OFFERED,
    on_patients,
)

INTRODUCTION = note(
    "An agent acts from a fixed start of the evaluation; then move through its steps. Attributions "
    "(Integrated Gradients) say what in the image moved it: red spoke for, blue against. Those of "
    "the chosen action are there for policies that look at images themselves; of the servo, what "
    f"speaks for the view as it reads it. Patients by split: {PATIENTS_OFFERED}."
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
    last = FIXED_STARTS - 1
    first = next((name for name in offered if name.startswith("servo")), offered[0])
    tasks = watching.tasks_of(place, first)
    task_first = "A4C-beating" if "A4C-beating" in tasks else tasks[0]
    with gr.Row():
        agent = gr.Dropdown(
            offered, value=first, label="Agent", elem_id="agent-name", min_width=150
        )  # fmt: skip
        task = gr.Dropdown(
            tasks, value=task_first, label="Task", elem_id="agent-task", min_width=130
        )  # fmt: skip
        patient = gr.Number(
            FIRST_PATIENT, label="Patient", precision=0, minimum=1,
            elem_id="agent-patient", min_width=110, visible=on_patients(task_first),
        )  # fmt: skip
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
    wire(agent.input, "tasks", partial(_tasks, place), [agent], [task, patient], **quiet)
    wire(task.change, "patient", _patient, [task], [patient], **quiet)
    shown = [watched, step, what, image, side]
    started = partial(_watch, place)
    asked = [agent, task, number, robot, patient]
    wire(watch.click, "watch", started, asked, shown, show_progress_on=[image])
    assert (page := Context.root_block) is not None

    def linked(request: gr.Request) -> tuple[Any, ...]:
        """Show the episode and the step that the page's address tells of."""
        if (fields := links.told(request, "agent")) is None:
            return tuple(gr.skip() for _ in (*asked, *shown))
        return _linked(place, fields)

    wire(page.load, "linked", linked, None, [*asked, *shown], show_progress_on=[image])
    wire(
        [step.input, what.input], "show", partial(_show, place), shown[:3], shown[3:],
        trigger_mode="always_last", **quiet,
    )  # fmt: skip


def _tasks(place: Place, agent: Any) -> tuple[Any, Any]:
    """Offer the tasks of an agent, and a patient where they are of patients."""
    tasks = watching.tasks_of(place, agent)
    first = next((name for name in ("A4C-beating", "SC") if name in tasks), tasks[0])
    return gr.Dropdown(choices=tasks, value=first), _patient(first)


def _patient(task: Any) -> Any:
    return gr.Number(visible=on_patients(str(task)))


def _watch(place: Place, *asked: Any) -> tuple[Any, ...]:
    """Run the episode; the visitor's state says which it is, and does not hold it."""
    episode = watching.watch(place, *asked)
    slider = gr.Slider(maximum=episode.steps, value=0, interactive=True)
    what = gr.Radio(choices=list(episode.explainable), value=watching.OFF)
    return asked, slider, what, *_panels(episode, asked, 0, watching.OFF)


def _linked(place: Place, fields: dict[str, str]) -> tuple[Any, ...]:
    asked = (
        fields.get("agent"), fields.get("task"), links.number(fields, "number"),
        fields.get("robot", FREE), links.number(fields, "patient", FIRST_PATIENT),
    )  # fmt: skip
    episode = watching.watch(place, *asked)
    step, what = links.number(fields, "step"), fields.get("attributions", watching.OFF)
    halves = _panels(episode, asked, step, what)
    tasks = watching.tasks_of(place, asked[0])
    slider = gr.Slider(maximum=episode.steps, value=step, interactive=True)
    offered = gr.Radio(choices=list(episode.explainable), value=what)
    agent, task, number, robot, who = asked
    patient = gr.Number(value=who, visible=on_patients(str(task)))
    chosen = (agent, gr.Dropdown(choices=tasks, value=task), number, robot, patient)
    return *chosen, asked, slider, offered, *halves


def _show(place: Place, watched: Any, step: Any, what: Any) -> tuple[Any, Any]:
    if watched is None:
        return gr.skip(), gr.skip()
    return _panels(watching.watch(place, *watched), watched, step, what)


def _panels(episode: watching.Episode, asked: Any, step: Any, what: Any) -> tuple[str, str]:
    """Return the two halves of the page, with a link to this moment."""
    scene = watching.moment(episode, step)
    image, side = panels(scene)
    if what != watching.OFF:
        drawn, p = watching.explain(episode, step, what)
        image = image_panel(scene, watching.overlay(scene.image, drawn)) + note(
            f"{what}: p {p:.2f}"
        )
    agent, task, number, robot, patient = asked
    fields = {"agent": agent, "task": task, "number": number, "step": scene.step}
    fields |= {"patient": patient} if on_patients(task) else {}
    fields |= {"robot": robot} if robot != FREE else {}
    fields |= {"attributions": what} if what != watching.OFF else {}
    return image + links.link("agent", **fields), side
