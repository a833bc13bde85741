"""Other hearts under other scanner settings: what one seed of the population makes of a phantom."""

from dataclasses import replace

from racines_data.phantom.config import PhantomConfig


def heart_config(base: PhantomConfig, seed: int) -> PhantomConfig:
    """Return the phantom of another heart, with scatterers of its own.

    Args:
        base: The phantom that the others vary.
        seed: The anatomy's seed, 1 or more; 0 is the canonical heart.
    """
    block = replace(base.block, seed=base.block.seed + seed)
    return replace(base, anatomy_seed=seed, block=block)
