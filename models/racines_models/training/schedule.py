"""Learning rates as a function of the images seen, the same shape for every optimizer."""

import math
from collections.abc import Mapping

from torch.optim import Optimizer

from racines_models.training.objective import Training


class Schedule:
    """Scales each optimizer's own learning rate; a resumed run needs no saved state."""

    def __init__(self, optimizers: Mapping[str, Optimizer], config: Training, stop: int):
        self._optimizers = list(optimizers.values())
        self._rates = [[group["lr"] for group in each.param_groups] for each in self._optimizers]
        self._cosine = config.schedule == "cosine"
        self._warmup, self._stop = config.warmup_images, stop
        self._step = config.batch_size

    def factor(self, seen: int) -> float:
        """Return the scale of the step that starts after `seen` images, in (0, 1].

        Warm-up rises linearly to 1; `cosine` then falls to 0 at the end of the budget
        (Loshchilov and Hutter, SGDR, 2017, without restarts).
        """
        if seen < self._warmup:
            return min(1.0, (seen + self._step) / self._warmup)
        if not self._cosine:
            return 1.0
        past = (seen - self._warmup) / max(self._stop - self._warmup, 1)
        return 0.5 * (1.0 + math.cos(math.pi * past))

    def apply(self, seen: int) -> None:
        """Set the learning rates of the step that starts after `seen` images."""
        if not (self._cosine or self._warmup):
            return
        factor = self.factor(seen)
        for optimizer, rates in zip(self._optimizers, self._rates, strict=True):
            # Looked up each time: a restored optimizer has new groups.
            for group, rate in zip(optimizer.param_groups, rates, strict=True):
                group["lr"] = rate * factor
