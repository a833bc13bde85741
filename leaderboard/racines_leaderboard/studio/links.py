"""What a page shows as its address, so that it can be handed on and comes back as it was.

What an address says was written by anybody: the tabs check it as they check what a browser sends.
"""

from typing import Any
from urllib.parse import urlencode

import gradio as gr

from racines_data import escape
from racines_data.errors import RacinesError
from racines_envs.task.actions import ACTIONS

LONGEST = 200
"""Characters of a field, and so steps of an episode, that are read of an address."""
_CODES = "0123456789abc"
"""An action, a character."""
assert len(_CODES) == len(ACTIONS)


def link(tab: str, **fields: Any) -> str:
    """Return a link to a tab in a state, as HTML."""
    address = "?" + urlencode({"tab": tab} | {name: str(value) for name, value in fields.items()})
    href = escape.html(address)
    return f'<p class="rc-note"><a href="{href}">Link to what is shown</a></p>'


def told(request: gr.Request | None, tab: str) -> dict[str, str] | None:
    """Return the fields of the address, if it is that of a tab's state."""
    query = dict(getattr(request, "query_params", None) or {})
    if query.pop("tab", None) != tab:
        return None
    for name, value in query.items():
        if len(value) > LONGEST:
            raise RacinesError(f"{name[:20]}: at most {LONGEST} characters of an address are read")
    return {str(name): str(value) for name, value in query.items()}


def number(fields: dict[str, str], name: str, otherwise: int = 0) -> int:
    """Return a whole number of an address."""
    value = fields.get(name, str(otherwise))
    if not (value.isascii() and value.isdigit()):
        raise RacinesError(f"{name}: {value[:20]!r} is no whole number")
    return int(value)


def coded(actions: tuple[int, ...]) -> str:
    """Return actions as characters."""
    return "".join(_CODES[action] for action in actions)


def decoded(fields: dict[str, str]) -> tuple[int, ...]:
    """Return the actions of an address."""
    codes = fields.get("actions", "")
    if wrong := sorted(set(codes) - set(_CODES)):
        raise RacinesError(f"actions: {wrong[0]!r} is none of {_CODES}")
    return tuple(_CODES.index(code) for code in codes)
