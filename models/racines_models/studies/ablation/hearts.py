"""Hearts that lack one thing: anatomies for `racines study ablation`, named `module:function`."""

from dataclasses import replace
from functools import partial
from typing import Any

from torch import Tensor

from racines_data.phantom.anatomy import Anatomy
from racines_data.phantom.heart import CONNECTIVE, GEL, heart


def _with_tissues(seed: int, **changes: Any) -> Anatomy:
    anatomy = heart(seed)
    tissues = tuple(replace(tissue, **changes) for tissue in anatomy.tissues)
    return replace(anatomy, tissues=tissues)


no_sheets = partial(_with_tissues, sheets=False)
"""A heart whose walls scatter alike along and across them."""
no_grain = partial(_with_tissues, grain=0.0)
"""A heart without fine (2-3 mm) variation of the backscatter."""
no_texture = partial(_with_tissues, texture=0.0)
"""A heart without slow (centimetre) variation of the backscatter."""


def no_layers(seed: int) -> Anatomy:
    """Return a heart whose surroundings hold no layers of connective tissue."""
    anatomy = heart(seed)

    def paint(points: Tensor) -> Tensor:
        tissue = anatomy.paint(points)
        return tissue.masked_fill(tissue == CONNECTIVE, GEL)

    return replace(anatomy, paint=paint)
