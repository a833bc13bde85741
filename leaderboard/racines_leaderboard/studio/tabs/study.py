"""Tab: the expert study, one blinded image at a time, by buttons or keys."""

from functools import partial
from typing import Any

import gradio as gr

from racines_data.views import RANDOM
from racines_leaderboard.expert.ratings import ABOUT
from racines_leaderboard.studio import labelling
from racines_leaderboard.studio.html import missing
from racines_leaderboard.studio.labelling import CODE, KINDS, NAME, Sitting
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.tabs import wiring

KEYS = """
const views = 'asdfghjkl', page = (id) => document.getElementById(id);
const press = (id, n) => page(id)?.querySelectorAll('label input')[n]?.click();
document.addEventListener('keydown', (event) => {
  const shown = page('study-save');
  if (!shown || shown.offsetParent === null) return;
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  if (event.target.closest('textarea, input:not([type=radio]), [contenteditable]')) return;
  const key = event.key.toLowerCase();
  if (views.includes(key)) press('study-view', views.indexOf(key));
  else if (/^[0-9]$/.test(key)) press('study-grade', (Number(key) + 9) % 10);
  else if (key === 'enter') shown.click();
  else if (key === 'backspace') page('study-undo').click();
  else return;
  event.preventDefault();
});
"""
HELP = (
    '<p class="rc-note rc-keys">Keys: a, s, d, … the view; 1 to 9 and 0 for 10 the grade; Enter '
    "saves; Backspace takes back a choice that is not saved.</p>"
)


def build(place: Place) -> None:
    """Build the tab."""
    kits = labelling.kits(place.kits)
    if not kits:
        what = f"{place.kits}: no kit of images to rate. Draw one:"
        draw = "racines expert sample --generator nearest-pose --truth --out study/kit"
        gr.HTML(missing(what, draw))
        return
    sitting = gr.State(None)
    with gr.Column() as door:
        fields = _door(kits)
        instructions = gr.HTML()
        start = gr.Button("Begin or go on", variant="primary", elem_id="study-begin")
    with gr.Column(visible=False) as desk:
        progress = gr.HTML(elem_id="study-progress")
        with gr.Row():
            with gr.Column(scale=3, min_width=280):
                image = gr.HTML(elem_id="study-image")
            with gr.Column(scale=2, min_width=280):
                answers = _answers()
        done = gr.HTML(elem_id="study-done")
        leave = gr.Button("Leave", size="sm", elem_id="study-leave")
        gr.HTML(HELP, js_on_load=KEYS)
        code = gr.HTML(elem_id="study-code")
    shown = [sitting, door, desk, progress, image, done, code, *answers]
    wire, (view, grade, save, undo) = wiring("study", show_progress="hidden"), answers
    wire(start.click, "begin", partial(_begin, place), fields, shown)
    wire(save.click, "save", _answer, [sitting, view, grade], shown)
    undo.click(None, None, [view, grade], js="() => [null, null]", api_name="study_undo")
    wire(leave.click, "leave", _shown, None, shown)
    wire(None, "instructions", partial(_instructions, place), fields[0], instructions)


def _door(kits: list[str]) -> list[Any]:
    with gr.Row():
        kit = gr.Dropdown(kits, value=kits[0], label="Study", min_width=220)
        name = gr.Textbox(
            label="Name", info="A pseudonym: a-z, 0-9 and dashes.", max_length=NAME, max_lines=1,
            elem_id="study-name", min_width=220,
        )  # fmt: skip
        code = gr.Textbox(
            label="Code", info="Only to go on under a name that was begun.", max_length=CODE,
            max_lines=1, elem_id="study-given", min_width=220,
        )  # fmt: skip
    kind = gr.Radio(list(KINDS), value=next(iter(KINDS)), label="Who you are")
    about = gr.Textbox(
        label="About you", info="For the report, such as: sonographer, 12 years.",
        max_length=ABOUT, max_lines=1, elem_id="study-about",
    )  # fmt: skip
    return [kit, name, kind, about, code]


def _answers() -> list[Any]:
    """Return the view, the grade, and the buttons that save them and take them back."""
    view = gr.Radio([], label="View", elem_id="study-view", elem_classes="rc-pills")
    grade = gr.Radio(
        [], label="Grade, 1 poor to 10 excellent; none without a view", elem_id="study-grade",
        elem_classes="rc-pills",
    )  # fmt: skip
    with gr.Row():
        save = gr.Button(
            "Save and next", variant="primary", elem_id="study-save", min_width=140, scale=2
        )  # fmt: skip
        undo = gr.Button("Undo", elem_id="study-undo", min_width=80)
    return [view, grade, save, undo]


def _instructions(place: Place, kit: Any) -> str:
    return labelling.instructions_html(labelling.open_kit(place.kits, kit))


def _begin(place: Place, *given: Any) -> list[Any]:
    return _shown(labelling.begin(place.kits, *given))


def _answer(sitting: Any, view: Any, grade: Any) -> list[Any]:
    known = isinstance(sitting, Sitting)
    return _shown(labelling.answer(sitting, view, grade) if known else None)


def _shown(sitting: Sitting | None = None) -> list[Any]:
    """Return what the page shows: the door without a sitting, else its image or the end."""
    if sitting is None:
        empty = [gr.Radio(choices=[], value=None)] * 2
        hidden = [gr.Button(visible=True)] * 2
        return [None, gr.Column(visible=True), gr.Column(visible=False), *[""] * 4, *empty, *hidden]
    document = labelling.Kit.open(sitting.kit).document
    titles = {view["name"]: view["title"] for view in document["views"]}
    views = [(f"{RANDOM}: {titles[RANDOM]}" if v == RANDOM else v, v) for v in titles]
    grades = list(range(document["grades"]["lowest"], document["grades"]["highest"] + 1))
    going = sitting.image is not None
    return [
        sitting,
        gr.Column(visible=False),
        gr.Column(visible=True),
        labelling.progress_html(sitting),
        labelling.image_html(sitting),
        "" if going else labelling.finished_html(sitting),
        labelling.code_html(sitting) if going else "",
        *(gr.Radio(choices=each, value=None, visible=going) for each in (views, grades)),
        *[gr.Button(visible=going)] * 2,
    ]
