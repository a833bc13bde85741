"""The tabs of the Studio, a module each with `build(place)`; how their events are answered."""

import functools
from collections.abc import Callable
from typing import Any

import gradio as gr

from racines_data.errors import RacinesError
from racines_leaderboard.studio.html import text


def wiring(tab: str, in_turn: bool = False, **common: Any) -> Callable[..., Any]:
    """Return what wires the events of a tab, which have some settings in common.

    No program may call them by itself. A refusal reaches the visitor as a notice, escaped, and not
    as a crash. With `in_turn` one event runs after the other, for all visitors.
    """
    turns = {"concurrency_id": tab, "concurrency_limit": 1} if in_turn else {}

    def wire(
        trigger: Any, name: str, function: Any, inputs: Any, outputs: Any, **settings: Any
    ) -> Any:
        """Let a function answer a trigger, or any of a list; None: a load and any changed input."""

        @functools.wraps(function)
        def answer(*arguments: Any) -> Any:
            try:
                return function(*arguments)
            except RacinesError as error:
                raise gr.Error(text(error), print_exception=False) from error

        listen = trigger if callable(trigger) else functools.partial(gr.on, trigger)
        settings = {"api_visibility": "private", **turns, **common, **settings}
        return listen(answer, inputs, outputs, api_name=f"{tab}_{name}", **settings)

    return wire
