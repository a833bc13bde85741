"""Learning rates as a function of the images seen, the same shape for every optimizer."""

import math

from racines_models.training.objective import Training


def rate_factor(config: Training, seen: int) -> float:
    """Return the scale of the learning rates in the step that starts after `seen` images.

    Warm-up rises linearly to 1; `cosine` then falls to 0 at the end of the budget
    (Loshchilov and Hutter, SGDR, 2017, without restarts).
    """
    if seen < config.warmup_images:
        return min(1.0, (seen + config.batch_size) / config.warmup_images)
    if config.schedule == "constant":
        return 1.0
    past = (seen - config.warmup_images) / max(config.stop - config.warmup_images, 1)
    return 0.5 * (1.0 + math.cos(math.pi * past))
