"""The Studio as a Gradio app: its frame and how it is served. Importing this needs the extra."""

import importlib
from collections.abc import Awaitable, Callable, MutableMapping, Sequence
from types import ModuleType
from typing import Any

import gradio as gr

from racines_data.errors import RacinesError
from racines_leaderboard.studio.look import CSS, FOOT, HEAD, theme
from racines_leaderboard.studio.place import Place

TABS = {
    "leaderboards": "Leaderboards",
    "generators": "Generators",
    "probe": "Drive the probe",
    "agent": "Watch an agent",
    "study": "Expert study",
    "dataset": "Dataset",
}
"""Modules of the tabs, and their titles, in order."""
AT_ONCE = 4
"""Events of one kind that run at a time; the others wait in the queue."""
Message = MutableMapping[str, Any]


def build(place: Place, tabs: Sequence[str] | None = None) -> gr.Blocks:
    """Build the app.

    Args:
        place: Where everything lies.
        tabs: Names of the tabs to show; all if absent.

    Raises:
        RacinesError: a name that is no tab.
    """
    wanted = list(TABS) if tabs is None else list(tabs)
    if unknown := [name for name in wanted if name not in TABS]:
        raise RacinesError(f"--tab {unknown[0]}: choose among {', '.join(TABS)}")
    with gr.Blocks(title="RACINES Studio", analytics_enabled=False) as app:
        gr.HTML(HEAD, elem_id="rc-head")
        with gr.Tabs():
            for name in (name for name in TABS if name in wanted):
                module = _module(name)
                if module is not None:
                    with gr.Tab(TABS[name], id=name):
                        module.build(place)
        gr.HTML(FOOT, elem_id="rc-foot")
    app.queue(
        max_size=place.max_sessions,
        default_concurrency_limit=AT_ONCE,
        api_open=False,
    )
    return app


def serve(
    place: Place | None = None,
    host: str = "127.0.0.1",
    port: int = 7860,
    tabs: Sequence[str] | None = None,
    block: bool = True,
) -> gr.Blocks:
    """Build the app and serve it; return when it is stopped, or at once without `block`.

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
            inbrowser=False,
            show_error=False,
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
            css=CSS,
            app_kwargs={"middleware": [(NoUploads, [], {})]},
        )
    except OSError as error:
        raise RacinesError(f"--port {port}: {error}; name another with --port") from error
    return app


class NoUploads:
    """Refuses uploads before a byte of them is read: no tab takes a file."""

    def __init__(self, app: Callable[..., Awaitable[None]]) -> None:
        self.app = app

    async def __call__(
        self, scope: Message, receive: Callable[..., Any], send: Callable[..., Any]
    ) -> None:
        """Answer 403 to anything sent to an upload's address; hand on everything else."""
        if scope["type"] != "http" or not scope["path"].rstrip("/").endswith("/upload"):
            await self.app(scope, receive, send)
            return
        head = [(b"content-type", b"text/plain; charset=utf-8")]
        await send({"type": "http.response.start", "status": 403, "headers": head})
        await send({"type": "http.response.body", "body": b"The Studio takes no files.\n"})


def _module(name: str) -> ModuleType | None:
    """Import a tab's module; None if it is not there, while what it lacks itself is an error."""
    path = f"{__package__}.tabs.{name}"
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError as error:
        if error.name != path:
            raise
        return None
