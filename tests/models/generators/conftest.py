"""What tests of generators that adapt have in common: scouts are looked at once."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from torch import Tensor

from racines_models.generators import scout_attention, scout_field


def tensors(value: Any) -> Iterator[Tensor]:
    """Yield the tensors of nested tuples."""
    if isinstance(value, Tensor):
        yield value
    else:
        for part in value:
            yield from tensors(part)


def remembered(look: Callable[..., Any], found: dict[Any, Any]) -> Callable[..., Any]:
    """Return a function of tensors that is asked once for each value."""

    def ask(*given: Any) -> Any:
        key = look.__name__, *(each.numpy().tobytes() for each in tensors(given))
        if key not in found:
            found[key] = look(*given)
        return found[key]

    return ask


@pytest.fixture(scope="session")
def seen_scouts() -> dict[Any, Any]:
    """Return what is known of scouts, by their frames and poses."""
    return {}


@pytest.fixture(scope="module")
def scouts_once(seen_scouts: dict[Any, Any]) -> Iterator[None]:
    """Find how large a pixel is, and what voxels show, once for each scout: every fit asks it.

    Both are functions of the scout alone, and have tests of their own.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module, name in ((scout_attention, "known"), (scout_field, "gathered")):
            patch.setattr(module, name, remembered(getattr(module, name), seen_scouts))
        yield
