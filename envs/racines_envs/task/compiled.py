"""A core whose steps are compiled: one call of compiled code in place of hundreds of small ones.

A few dozen probes that are seen by their pose alone are so little work that calling the tensor
library takes most of a step's time. Drawing and grading are work enough, and are not compiled.
"""

import warnings
from collections.abc import Callable
from types import FunctionType, MethodType
from typing import Any

import torch
from torch import Tensor
from torch._dynamo.exc import FailOnRecompileLimitHit, TorchDynamoException

from racines_data.errors import RacinesError
from racines_data.world import cosine
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import Score
from racines_envs.task.state import State, Transition
from racines_models.devices import check_compiler

# It reads a tensor, which would end the compiled code. Said here and not beside it: to import what
# says it takes a second.
torch._dynamo.assume_constant_result(cosine.__wrapped__)


class CompiledCore(ScanCore):
    """A `ScanCore` for agents that see the pose, compiled for its number of rows.

    The first step compiles, for a good part of a minute, or a few seconds where PyTorch still has
    the code. Numbers differ from a `ScanCore`'s by the rounding of float32, and a row's last bits
    may depend on its place among the rows: it is for training, and no score comes from it. Resets
    are not compiled.
    """

    def __init__(self, *parts: Any, **settings: Any) -> None:
        """Take what a `ScanCore` takes.

        Raises:
            RacinesError: it would draw or grade images, or no C++ compiler is found.
        """
        super().__init__(*parts, **settings)
        if self.observation != "params" or self.reward.needs_judge:
            raise RacinesError(
                f"compile: observation {self.observation!r} with reward {self.reward.name!r} draws "
                "images, which takes nearly all of a step's time: use observation='params' and a "
                "reward without a grader, or leave compile out"
            )
        check_compiler(self.device.type, "compile")
        self._stepped = _compiled(self._whole)
        self._spare: State | None = None
        self._last: tuple[State, dict[str, Tensor]] | None = None

    def step(
        self, action: Tensor, autoreset: bool = False, rows: Tensor | None = None,
        strict: bool = False,
    ) -> Transition:  # fmt: skip
        """As `ScanCore.step`; where only some rows move, it is not compiled."""
        # So many rows now, others next: each number would be compiled anew.
        refused = not self._sensed or (strict and bool(self.state.done.any()))
        if rows is not None or refused:
            return super().step(action, autoreset, rows, strict)
        state, before, begins = self.state, self.score, torch.zeros_like(self.state.done)
        taken = self.motion.check(action, self.num_envs)  # before an episode begins
        # One state given as two would be compiled once more when they are two.
        fresh = self._spare = self._spare or _apart(state)
        if autoreset and len(ended := state.done.nonzero().squeeze(1)):
            fresh, begins = fresh.replaced(ended, self._begin(ended)), state.done.clone()
        given, told = self._stepped(state, fresh, begins, taken, before)
        self._last = self.state, told
        return given

    def _whole(
        self, state: State, fresh: State, begins: Tensor, action: Tensor, before: Score
    ) -> tuple[Transition, dict[str, Tensor]]:
        """Move the live rows, begin (N,) bool others, look, and say what agents are not told."""
        live = ~state.done
        moved, new = (vars(each) for each in (ScanCore._move(self, state, action, live), fresh))
        self.state = State(
            *(
                torch.where(begins.view(-1, *[1] * (old.dim() - 1)), new[name], old)
                for name, old in moved.items()
            )
        )
        return ScanCore._look(self, before, live), ScanCore.info(self, view_error=False)

    def info(self, view_error: bool = True) -> dict[str, Tensor]:
        """As `ScanCore.info`, of which a step has told all but the error to the view."""
        if view_error or self._last is None or self._last[0] is not self.state:
            return super().info(view_error)
        return dict(self._last[1])


def _apart(state: State) -> State:
    return State(*(value.clone() for value in vars(state).values()))


def _compiled(part: Any) -> Callable[..., Any]:
    """Return a method of a core, compiled whole when it is first called."""
    # PyTorch keeps a few versions of each function, for all objects: each core has its own copy.
    function = part.__func__
    code = (function.__code__.replace(), function.__globals__, function.__name__)
    own = FunctionType(*code, function.__defaults__, function.__closure__)
    quick = torch.compile(MethodType(own, part.__self__), dynamic=False, fullgraph=True)
    ready = False

    def call(*given: Any) -> Any:
        nonlocal ready
        if ready:
            return quick(*given)
        with warnings.catch_warnings():
            # That it reads through caches: they hold what depends on settings alone.
            warnings.filterwarnings("ignore", "Dynamo detected a call to a `functools.lru_cache`")
            try:
                told = quick(*given)
            except (TorchDynamoException, FailOnRecompileLimitHit) as error:
                lines = (line.strip() for line in str(error).splitlines())
                raise RacinesError(
                    "compile: PyTorch cannot compile the steps of this task "
                    f"({next(filter(None, lines), type(error).__name__)}): leave compile out"
                ) from error
        ready = True
        return told

    return call
