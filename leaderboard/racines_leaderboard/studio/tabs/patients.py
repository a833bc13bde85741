"""The tab of the patients: one at a time, five views that beat, and what is true of the heart."""

from functools import partial
from typing import Any

import gradio as gr
from gradio.context import Context

from racines_leaderboard.studio import links, patients
from racines_leaderboard.studio.html import note
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.tabs import wiring
from racines_leaderboard.studio.worlds import FIRST_PATIENT, PATIENTS_OFFERED

INTRODUCTION = note(
    "Simulated patients, each from one seed: body, heart, ribs, tissue, heartbeat. Every view is "
    "drawn where it shows best, over one beat with the breath held. Marks at the right are a "
    f"centimetre of depth apart. Patients by split: {PATIENTS_OFFERED}."
)


def build(place: Place) -> None:
    """Build the tab."""
    tab = Context.block
    gr.HTML(INTRODUCTION)
    with gr.Row():
        number = gr.Number(
            FIRST_PATIENT, label="Patient", precision=0, minimum=1,
            elem_id="patients-number", min_width=240,
        )  # fmt: skip
        before = gr.Button("Previous", elem_id="patients-previous", min_width=110)
        after = gr.Button("Next", variant="primary", elem_id="patients-next", min_width=110)
    films = gr.HTML(elem_id="patients-films", min_height=240)
    wire = wiring("patients", in_turn=True)
    show = partial(_show, place)
    wire([number.submit, number.blur], "show", show, [number], [films], show_progress_on=[films])
    for button, step, name in ((before, -1, "previous"), (after, 1, "next")):
        wire(
            button.click, name, partial(_beside, place, step), [number], [number, films],
            show_progress_on=[films],
        )  # fmt: skip
    if isinstance(tab, gr.Tab):
        wire(tab.select, "open", show, [number], [films], show_progress_on=[films])
    assert (page := Context.root_block) is not None

    def linked(request: gr.Request) -> tuple[Any, Any]:
        """Show whom the page's address names."""
        if (fields := links.told(request, "patients")) is None:
            return gr.skip(), gr.skip()
        seed = links.number(fields, "patient", FIRST_PATIENT)
        return seed, _show(place, seed)

    wire(page.load, "linked", linked, None, [number, films], show_progress_on=[films])


def _show(place: Place, number: Any) -> str:
    shown = patients.sheet(place, number)
    return patients.html(shown) + links.link("patients", patient=shown.seed)


def _beside(place: Place, step: int, number: Any) -> tuple[int, str]:
    seed = patients.beside(number, step)
    return seed, _show(place, seed)
