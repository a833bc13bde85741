"""The variants of the phantom that `racines study ablation` renders: each is it less one part."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from racines_data.errors import RacinesError
from racines_data.phantom import PhantomConfig
from racines_data.phantom.config import heart_config

OFF = -200.0
"""dB of what is switched off."""
BASE = "full phantom"
NO_GRAY_MAP = "no gray map"


@dataclass(frozen=True)
class Variant:
    """One way to render the population of hearts."""

    name: str
    change: Callable[[PhantomConfig, PhantomConfig], PhantomConfig]
    """From a heart's configuration and the base phantom's to what is rendered instead."""

    def configs(self, base: PhantomConfig, hearts: int) -> list[PhantomConfig]:
        """Return the configuration of each of the hearts 1 … `hearts`."""
        return [self.change(heart_config(base, seed), base) for seed in range(1, hearts + 1)]


def _probe(config: PhantomConfig, base: PhantomConfig, **changes: Any) -> PhantomConfig:
    return replace(config, probe=replace(config.probe, **changes))


def _anatomy(config: PhantomConfig, base: PhantomConfig, function: str) -> PhantomConfig:
    return replace(config, anatomy=f"racines_models.studies.ablation.hearts:{function}")


def gray_map_variant(gain: float) -> Variant:
    """Return the variant without gray map, its gain moved by `gain`, dB."""

    def change(config: PhantomConfig, base: PhantomConfig) -> PhantomConfig:
        return _probe(config, base, gray_map=1.0, gain=config.probe.gain + gain)

    return Variant(NO_GRAY_MAP, change)


_PROBE = {
    "single look": {"looks": 1},
    NO_GRAY_MAP: {"gray_map": 1.0},  # its gain is sought: see gray_map_variant
    "no speckle reduction": {"smoothing": (0.0, 0.0)},
    "no multiple scattering": {"haze": OFF},
    "no reverberation": {"reverberation": OFF},
    "no electronic noise": {"noise": OFF},
    "no side lobes": {"side_lobes": 0.0},
    "no directivity": {"directivity": 0.0},
    "no near-field gain": {"near_gain": 0.0},
}
_TISSUES = ("sheets", "grain", "texture", "layers")
VARIANTS = (
    Variant(BASE, lambda config, base: config),
    *(Variant(name, partial(_probe, **changes)) for name, changes in _PROBE.items()),
    Variant("one scanner setting", lambda config, base: replace(config, probe=base.probe)),
    Variant("no cover", lambda c, base: replace(c, block=replace(c.block, cover=0.0))),
    *(Variant(f"no {part}", partial(_anatomy, function=f"no_{part}")) for part in _TISSUES),
    # Heart 1 is of the population: the canonical one lies in plain gel, which is another change.
    Variant("one form of heart", lambda config, base: replace(config, anatomy_seed=1)),
    Variant("one heart, one setting", lambda config, base: base),
)
"""The full phantom first; those that share its baked blocks next to it."""


def pick_variants(names: list[str] | None) -> list[Variant]:
    """Return the full phantom and the named variants, or all."""
    known = [variant.name for variant in VARIANTS]
    unknown = sorted(set(names or ()) - set(known))
    if unknown:
        raise RacinesError(f"unknown variant {unknown[0]!r}: choose of {', '.join(known[1:])}")
    return [v for v in VARIANTS if not names or v.name in (BASE, *names)]
