"""Exponential moving average of the weights that draw."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class Average:
    """Averages parameters and buffers of networks; switched off, it is the weights themselves.

    The decay warms up as (1 + t) / (10 + t), so that a short run forgets its random start.
    """

    def __init__(self, nets: Sequence[nn.Module], decay: float):
        self._nets = nets
        self._decay = decay
        self._steps = 0
        self._shadow = [tensor.detach().clone() for tensor in self._live()]

    def _live(self) -> list[Tensor]:
        return [tensor for net in self._nets for tensor in net.state_dict().values()]

    @torch.no_grad()
    def update(self) -> None:
        """Move the average towards the weights after a step."""
        if not self._decay:
            return
        self._steps += 1
        decay = min(self._decay, (1 + self._steps) / (10 + self._steps))
        pairs = list(zip(self._shadow, self._live(), strict=True))
        real = [(old, new) for old, new in pairs if old.is_floating_point()]
        averaged, live = [old for old, _ in real], [new for _, new in real]
        torch._foreach_lerp_(averaged, live, 1.0 - decay)  # pyright: ignore
        for old, new in pairs:
            if not old.is_floating_point():  # batch norm's counters
                old.copy_(new)

    @torch.no_grad()
    def apply(self) -> None:
        """Put the average into the networks for good."""
        if self._decay:
            for live, shadow in zip(self._live(), self._shadow, strict=True):
                live.copy_(shadow)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Put the average into the networks, in evaluation mode, for the length of a block."""
        kept = [tensor.detach().clone() for tensor in self._live()]
        self.apply()
        for net in self._nets:
            net.eval()
        try:
            yield
        finally:
            with torch.no_grad():
                for live, old in zip(self._live(), kept, strict=True):
                    live.copy_(old)
            for net in self._nets:
                net.train()

    def state(self) -> tuple[int, list[Tensor]]:
        """Return what `restore` needs."""
        return self._steps, self._shadow

    def restore(self, state: tuple[int, list[Tensor]]) -> None:
        """Continue from a saved state."""
        self._steps = state[0]
        for old, new in zip(self._shadow, state[1], strict=True):
            old.copy_(new)
