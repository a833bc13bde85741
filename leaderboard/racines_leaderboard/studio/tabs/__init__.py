"""The tabs of the Studio, a module each with `build(place)`; how each answers a refusal."""

import functools
from collections.abc import Callable
from typing import Any

import gradio as gr

from racines_data.errors import RacinesError
from racines_leaderboard.studio.html import text

PRIVATE: dict[str, Any] = {"api_visibility": "private", "show_progress": "hidden"}
"""Of an event that no program may call by itself."""


def one_at_a_time(tab: str) -> dict[str, Any]:
    """Return the settings of events of which one runs after the other, for all visitors."""
    return {"concurrency_id": tab, "concurrency_limit": 1, "api_visibility": "private"}


def refusing(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let a callback's refusal reach the visitor as a notice, escaped, and not as a crash."""

    @functools.wraps(function)
    def wrapper(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except RacinesError as error:
            raise gr.Error(text(error), print_exception=False) from error

    return wrapper
