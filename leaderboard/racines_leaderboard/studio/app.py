"""The Studio as a Gradio app: its frame, how it looks and how it is served. Needs the extra."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import gradio as gr
from gradio.themes import Base
from gradio.themes.utils import colors, sizes

from racines_data.errors import RacinesError
from racines_data.plotting import BLUE, NIGHT, PALE, SPLIT_COLOURS
from racines_leaderboard.studio.guard import middleware
from racines_leaderboard.studio.parts import Place

TABS = {
    "leaderboards": "Leaderboards",
    "patients": "Patients",
    "generators": "Generators",
    "probe": "Drive the probe",
    "agent": "Watch an agent",
    "study": "Expert study",
    "dataset": "Dataset",
}
"""Modules of the tabs, and their titles, in order."""
AT_ONCE = 4
"""Events of one kind that run at a time; the others wait in the queue."""
ACCENT, LIGHT = SPLIT_COLOURS["train"], BLUE
HEAD = """<header><h1>RACINES Studio</h1>
<p>The open benchmark for robotic cardiac ultrasound.</p></header>"""
FOOT = """<footer><p><strong>Research software, not a medical device.</strong>
Simulated images say so.</p></footer>"""


def theme() -> Base:
    """Return the theme: slate and blue, hairlines, no shadows, no fonts from elsewhere."""
    base = Base(
        primary_hue=colors.blue,
        neutral_hue=colors.slate,
        radius_size=sizes.radius_sm,
        font=("system-ui", "-apple-system", "Segoe UI", "Roboto", "sans-serif"),
        font_mono=("ui-monospace", "SFMono-Regular", "Menlo", "monospace"),
    )
    return base.set(
        body_background_fill="#f4f7f9",
        body_background_fill_dark=NIGHT,
        body_text_color_subdued="#52606d",
        body_text_color_subdued_dark=PALE,
        block_shadow="none",
        block_label_text_weight="500",
        button_primary_background_fill=ACCENT,
        button_primary_background_fill_hover=LIGHT,
        button_primary_background_fill_dark=LIGHT,
        button_primary_text_color="white",
        slider_color=ACCENT,
    )


def build(place: Place, tabs: Sequence[str] | None = None) -> gr.Blocks:
    """Build the app with some of the `TABS`, all if absent.

    Raises:
        RacinesError: a name that is no tab.
    """
    wanted = TABS if tabs is None else tabs
    if unknown := [name for name in wanted if name not in TABS]:
        raise RacinesError(f"--tab {unknown[0]}: choose among {', '.join(TABS)}")
    with gr.Blocks(title="RACINES Studio", analytics_enabled=False) as app:
        gr.HTML(HEAD, elem_id="rc-head")
        shown = [name for name in TABS if name in wanted]
        with gr.Tabs() as pages:
            for name in shown:
                with gr.Tab(TABS[name], id=name):
                    import_module(f"{__package__}.tabs.{name}").build(place)
        gr.HTML(FOOT, elem_id="rc-foot")

        def chosen(request: gr.Request) -> Any:
            """Open the tab that the page's address names."""
            name = dict(request.query_params or {}).get("tab")
            return gr.Tabs(selected=name) if name in shown else gr.skip()

        app.load(chosen, None, pages, api_visibility="private", queue=False)
    app.queue(max_size=place.max_sessions, default_concurrency_limit=AT_ONCE, api_open=False)
    return app


def serve(
    place: Place | None = None,
    host: str = "127.0.0.1",
    port: int = 7860,
    tabs: Sequence[str] | None = None,
    block: bool = True,
    hosts: Sequence[str] = (),
    framed_by: Sequence[str] = (),
) -> gr.Blocks:
    """Build the app and serve it; return when it is stopped, or at once without `block`.

    It answers those alone who ask for it by a name of this machine, by `host`, or by one of
    `hosts`; pages of the origins `framed_by` may show it in a frame.

    Raises:
        RacinesError: the port is taken, or an unknown tab.
    """
    place = place or Place()
    app = build(place, tabs)
    try:
        app.launch(
            server_name=host,
            server_port=port,
            prevent_thread_lock=not block,
            share=False,
            quiet=True,
            allowed_paths=[],
            max_file_size=1,
            state_session_capacity=place.max_sessions,
            enable_monitoring=False,
            ssr_mode=False,
            mcp_server=False,
            pwa=False,
            run_history=False,
            footer_links=[],
            theme=theme(),
            css=Path(__file__).with_name("studio.css").read_text(encoding="utf-8"),
            app_kwargs={"middleware": middleware(host, hosts, framed_by)},
        )
    except OSError as error:
        raise RacinesError(f"--port {port}: {error}; name another with --port") from error
    return app
