"""Exponential moving average of the weights that draw."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel


class Average:
    """Averages parameters and buffers of networks; switched off, it is the weights themselves.

    The decay warms up as (1 + t) / (10 + t), so that a short run forgets its random start.
    """

    def __init__(self, nets: Sequence[nn.Module], decay: float):
        self._nets, self._decay = nn.ModuleList(nets), decay
        self._model: AveragedModel | None = None
        if decay:
            self._model = AveragedModel(self._nets, multi_avg_fn=self._move, use_buffers=True)
            # The random start is the average of no step, not absent: the first step does not
            # replace it, but moves it.
            self._model.n_averaged.fill_(1)

    def _move(self, averaged: Any, live: Any, _: Any) -> None:
        """Move lists of tensors of one type, as `AveragedModel` asks."""
        assert self._model is not None
        steps = int(self._model.n_averaged)  # lies on the CPU: no wait for the device
        decay = min(self._decay, (1 + steps) / (10 + steps))
        if averaged[0].is_floating_point():
            torch._foreach_lerp_(averaged, live, 1.0 - decay)  # pyright: ignore
        else:  # batch norm's counters
            torch._foreach_copy_(averaged, live)  # pyright: ignore

    def update(self) -> None:
        """Move the average towards the weights after a step."""
        if self._model is not None:
            self._model.update_parameters(self._nets)

    def apply(self) -> None:
        """Put the average into the networks for good."""
        if self._model is not None:
            self._nets.load_state_dict(self._model.module.state_dict())

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Put the average into the networks, in evaluation mode, for the length of a block."""
        kept = {key: value.detach().clone() for key, value in self._nets.state_dict().items()}
        self.apply()
        self._nets.eval()
        try:
            yield
        finally:
            self._nets.load_state_dict(kept)
            self._nets.train()

    def state(self) -> dict[str, Tensor]:
        """Return what `restore` needs."""
        return {} if self._model is None else dict(self._model.state_dict())

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from a saved state."""
        if self._model is not None:
            self._model.load_state_dict(state)
