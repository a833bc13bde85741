"""Other hearts under other scanner settings: what one seed of the population makes of a phantom."""

from dataclasses import replace

from racines_data.phantom.config import PhantomConfig, ProbeConfig
from racines_data.randomness import sample_seeds, uniform

_STREAM = 41
_SPREAD = {
    "gain": 5.0,  # dB
    "dynamic_range": 10.0,  # dB
    "gray_map": 0.4,
    "noise": 6.0,  # dB
    "reverberation": 6.0,  # dB
    "haze": 7.0,  # dB: what differs most from one patient to the next
}
"""How far an examination's settings stray from the base probe's, either way."""
COVER = 2.5
"""Most unevenness of the cover, dB/cm/MHz."""


def heart_config(base: PhantomConfig, seed: int) -> PhantomConfig:
    """Return the phantom of another heart, with scatterers of its own, as another examiner sees it.

    Args:
        base: The phantom that the others vary.
        seed: The anatomy's seed, 1 or more; 0 is the canonical heart.
    """
    cover = COVER * uniform(sample_seeds(seed, 1), 1, _STREAM + 1).item()
    block = replace(base.block, seed=base.block.seed + 10 * seed, cover=cover)
    return replace(base, anatomy_seed=seed, block=block, probe=_probe(base.probe, seed))


def _probe(base: ProbeConfig, seed: int) -> ProbeConfig:
    draw = uniform(sample_seeds(seed, 1), len(_SPREAD), _STREAM)[0].tolist()
    strayed = {
        name: getattr(base, name) + spread * (2.0 * x - 1.0)
        for (name, spread), x in zip(_SPREAD.items(), draw, strict=True)
    }
    return replace(base, **strayed)
