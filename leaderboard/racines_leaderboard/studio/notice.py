"""What the Studio says where something is missing or refused."""

import functools
from collections.abc import Callable
from typing import Any

import gradio as gr

from racines_data.errors import RacinesError
from racines_leaderboard.studio.escape import text


def refusing(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let a callback's refusal reach the visitor as a notice, escaped, and not as a crash."""

    @functools.wraps(function)
    def wrapper(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except RacinesError as error:
            raise gr.Error(text(error), print_exception=False) from error

    return wrapper


def missing_html(what: str, *commands: str) -> str:
    """Say what is missing and which commands make it."""
    lines = "".join(f"<p><code>{text(command)}</code></p>" for command in commands)
    return f'<div class="rc-note rc-missing"><p>{text(what)}</p>{lines}</div>'
