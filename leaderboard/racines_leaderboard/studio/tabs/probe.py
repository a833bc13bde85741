"""The tab in which a visitor drives the probe, by buttons and keys."""

import json
import math
from functools import partial
from typing import Any

import gradio as gr
from gradio.context import Context

from racines_data.errors import RacinesError
from racines_envs.driving.keyboard import KEYS
from racines_envs.robots.arm import FREE
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.tasks import TASKS
from racines_leaderboard.studio import driving, links, worlds
from racines_leaderboard.studio.html import note
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.scene import Scene, panels
from racines_leaderboard.studio.tabs import wiring

GROUPS = (("Move", ("x", "y", "z")), ("Turn", ("rx", "ry", "rz")))
"""Buttons, by what they do: an axis a column, a direction a row."""
PLAIN = {
    "+x": "right", "-x": "left", "+y": "out", "-y": "in", "+z": "press",
    "-z": "lift", "+rx": "tilt +", "-rx": "tilt −", "+ry": "rock +", "-ry": "rock −",
    "+rz": "turn +", "-rz": "turn −", "idle": "stay",
}  # fmt: skip
"""Each action in a word; the axes are the probe's, x to the right of its image."""
INTRODUCTION = note(
    "Steer the probe until the view is in sight: in the one heart for three steps in a row, in a "
    "patient until you declare it by staying three times. By the buttons, or by the keys on them. "
    "Directions are the probe's: right and left in its image, out of the image and into it, down "
    f"into the body and up. Patients by split: {worlds.PATIENTS_OFFERED}."
)
KEYS_JS = """
const keys = KEYS;
const fields = 'textarea, select, [contenteditable="true"], input';
const boxes = 'input[type=checkbox], input[type=radio]';
let last = 0;
function press(event) {
  const target = event.target, letter = event.key.length === 1 && event.key !== ' ';
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (target.matches && target.matches(fields) && !(letter && target.matches(boxes))) return;
  const id = keys[letter ? event.key.toLowerCase() : event.key];
  const button = id && document.getElementById(id);
  if (!button || button.offsetParent === null) return;
  event.preventDefault();
  // A button that was clicked has the focus, and space would click it again.
  if (document.activeElement) document.activeElement.blur();
  // A key that is held down must not run ahead of what the page shows.
  const now = performance.now();
  if (event.repeat && now - last < 160) return;
  last = now;
  button.click();
}
if (!window.racinesProbeKeys) {
  window.racinesProbeKeys = true;
  document.addEventListener('keydown', press);
}
"""


def build(place: Place) -> None:
    """Build the tab."""
    tab, lives, session = Context.block, driving.Lives(place), gr.State(None)
    gr.HTML(INTRODUCTION)
    with gr.Row():
        task = gr.Dropdown(
            list(worlds.tasks()), value="A4C-beating", label="Task", elem_id="probe-task",
            min_width=130,
        )  # fmt: skip
        patient = gr.Number(
            worlds.FIRST_PATIENT, label="Patient", precision=0,
            minimum=1, elem_id="probe-patient", min_width=110,
        )  # fmt: skip
        kind = gr.Dropdown(list(worlds.KINDS), value=worlds.FIXED, label="Start", min_width=120)
        number = gr.Number(0, label="Number", precision=0, minimum=0, min_width=90)
        robot = gr.Dropdown(
            list(driving.robots()), value=FREE, label="Carried by", elem_id="probe-robot",
            min_width=120,
        )  # fmt: skip
    with gr.Row():
        start = gr.Button("Start anew", variant="primary", elem_id="probe-start", min_width=120)
        truth = gr.Checkbox(False, label="Show the truth", elem_id="probe-truth", min_width=120)
    with gr.Row():
        with gr.Column(scale=5, min_width=320):
            image = gr.HTML(elem_id="probe-image")
            buttons = _buttons()
        with gr.Column(scale=4, min_width=320):
            side = gr.HTML(elem_id="probe-side")
    gr.HTML(js_on_load=KEYS_JS.replace("KEYS", json.dumps(_keys())))
    chosen, shown = [task, kind, number, robot, patient, truth], [session, image, side]
    # Steps are taken one after the other, in the order in which they came.
    wire, quiet = wiring("probe", in_turn=True), {"show_progress": "hidden"}
    wire(task.change, "patient", _patient, [task], [patient], **quiet)
    wire(start.click, "start", partial(_begin, lives), chosen, shown, show_progress_on=[image])
    wire(truth.input, "look", partial(_look, lives), [session, truth], shown[1:], **quiet)
    for action, button in buttons.items():
        wire(
            button.click, f"step_{action}", partial(_step, lives, action), [session, truth], shown,
            trigger_mode="multiple", **quiet,
        )  # fmt: skip
    if isinstance(tab, gr.Tab):

        def meet(
            session: Any, task: Any, kind: Any, number: Any, robot: Any, patient: Any, truth: Any,
            request: gr.Request,
        ) -> tuple[Any, ...]:  # fmt: skip
            """Begin the first episode of a visitor; later the tab is as it was left."""
            if session is not None or links.told(request, "probe") is not None:
                return gr.skip(), gr.skip(), gr.skip()
            return _begin(lives, task, kind, number, robot, patient, truth)

        wire(tab.select, "open", meet, [session, *chosen], shown, show_progress_on=[image])
    assert (page := Context.root_block) is not None

    def linked(request: gr.Request) -> tuple[Any, ...]:
        """Take up the episode that the page's address tells of."""
        if (fields := links.told(request, "probe")) is None:
            return tuple(gr.skip() for _ in (*chosen, *shown))
        return _linked(lives, fields)

    wire(page.load, "linked", linked, None, [*chosen, *shown], show_progress_on=[image])


def _buttons() -> dict[int, gr.Button]:
    """Return a button for each action, by its index."""
    key_of = {action: key for key, action in KEYS.items()}
    unit = TASKS["SC"]
    steps = f"{1e3 * unit.step_translation:g} mm", f"{math.degrees(unit.step_rotation):.1f}°"
    buttons = {}
    with gr.Row(elem_classes="probe-pads"):
        for (title, axes), step in zip(GROUPS, steps, strict=True):
            with gr.Column(min_width=250, elem_classes="probe-pad"):
                gr.HTML(f'<span class="rc-note">{title}, {step} a step</span>')
                for sign in "+-":
                    with gr.Row(elem_classes="probe-row"):
                        for name in (f"{sign}{axis}" for axis in axes):
                            buttons[ACTIONS.index(name)] = _button(name, key_of[name])
    buttons[IDLE] = _button("idle", "space")
    return buttons


def _button(action: str, key: str) -> gr.Button:
    label = f"{PLAIN[action]} ({key})"
    return gr.Button(label, elem_id=_id(action), elem_classes="probe-key", min_width=80)


def _id(action: str) -> str:
    return "probe-" + action.replace("-", "minus-").replace("+", "plus-")


def _keys() -> dict[str, str]:
    """Return the button's id by the key that presses it, as browsers name keys."""
    arrows = {"ArrowRight": "d", "ArrowLeft": "a", "ArrowUp": "w", "ArrowDown": "s"}
    pressed = {key: _id(action) for key, action in KEYS.items()}
    return pressed | {arrow: pressed[key] for arrow, key in arrows.items()}


def _patient(task: Any) -> Any:
    """Show the patient's number where the task has patients."""
    return gr.Number(visible=worlds.on_patients(str(task)))


def _begin(lives: driving.Lives, *chosen: Any) -> tuple[Any, ...]:
    *start, truth = chosen
    session = driving.begin(*start)
    return session, *_panels(session, lives.look(session, truth is True))


def _linked(lives: driving.Lives, fields: dict[str, str]) -> tuple[Any, ...]:
    asked = (
        fields.get("task"), fields.get("start", worlds.FIXED), links.number(fields, "number"),
        fields.get("robot", FREE), links.number(fields, "patient", worlds.FIRST_PATIENT),
    )  # fmt: skip
    session = driving.begin(*asked, links.decoded(fields))
    truth = fields.get("truth") == "1"
    scene = lives.look(session, truth)
    return *asked, truth, session, *_panels(session, scene)


def _panels(session: driving.Session, scene: Scene) -> tuple[str, str]:
    """Return the two halves of the page, with a link to this moment."""
    image, side = panels(scene)
    start = session.start
    fields: dict[str, Any] = {"task": start.task, "start": start.kind, "number": start.number}
    fields |= {"patient": start.patient} if start.patient else {}
    fields |= {"robot": start.robot} if start.robot != FREE else {}
    fields |= {"truth": 1} if scene.truth else {}
    return image + links.link("probe", **fields, actions=links.coded(session.actions)), side


def _step(lives: driving.Lives, action: int, session: Any, truth: Any) -> tuple[Any, ...]:
    if session is None:
        raise RacinesError("no episode yet: press Start anew")
    session, scene = lives.step(session, action, truth is True)
    return session, *_panels(session, scene)


def _look(lives: driving.Lives, session: Any, truth: Any) -> tuple[Any, Any]:
    if session is None:
        return gr.skip(), gr.skip()
    return _panels(session, lives.look(session, truth is True))
