"""Settings from a mapping: what is named replaces its default, and only that."""

from dataclasses import dataclass, field

import pytest

from racines_data.config import fill
from racines_data.errors import RacinesError


@dataclass(frozen=True)
class Loop:
    steps: int = 10
    batch: int = 16


@dataclass(frozen=True)
class Method:
    rate: float = 0.1
    loop: Loop = field(default_factory=lambda: Loop(batch=32))


def test_a_nested_mapping_keeps_the_outer_default():
    assert fill(Method, {"loop": {"steps": 3}}) == Method(loop=Loop(steps=3, batch=32))
    assert fill(Method, {"rate": 1}) == Method(rate=1.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [({"loop": {"stops": 3}}, "params.loop.stops: unknown key; known: steps, batch"),
     ({"loop": {"steps": "3"}}, "params.loop.steps: '3' is str, expected int")],
)  # fmt: skip
def test_errors_name_the_key(values, message):
    with pytest.raises(RacinesError, match=message):
        fill(Method, values)
