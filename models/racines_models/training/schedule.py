"""Learning rates as a function of the images seen, the same shape for every optimizer."""

import math
from collections.abc import Mapping

from torch.optim import Optimizer

from racines_models.training.objective import Training


class Schedule:
    """Scales each optimizer's own learning rate; a resumed run needs no saved state."""

    def __init__(self, optimizers: Mapping[str, Optimizer], config: Training, stop: int):
        groups = [group for each in optimizers.values() for group in each.param_groups]
        self._rates = [(group, group["lr"]) for group in groups]
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
        if self._cosine or self._warmup:
            factor = self.factor(seen)
            for group, rate in self._rates:
                group["lr"] = rate * factor
