"""Settings from a mapping: what is named replaces its default, and only that."""

import math
from dataclasses import dataclass, field

import pytest
import yaml

from racines_data.config import fill, read_params, section
from racines_data.errors import RacinesError


@dataclass(frozen=True)
class Loop:
    steps: int = 10
    batch: int = 16


@dataclass(frozen=True)
class Method:
    rate: float = 0.1
    loop: Loop = field(default_factory=lambda: Loop(batch=32))
    sizes: tuple[int, ...] = (1,)
    limit: int | None = None


@dataclass(frozen=True)
class Special(Method):
    extra: int = 1


@dataclass(frozen=True)
class Outer:
    method: Method = field(default_factory=Special)


@dataclass(frozen=True)
class Needy:
    view: str


def test_a_nested_mapping_keeps_the_outer_default():
    assert fill(Method, {"loop": {"steps": 3}}) == Method(loop=Loop(steps=3, batch=32))
    assert fill(Method, {"rate": 1}) == Method(rate=1.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [({"loop": {"stops": 3}}, "params.loop.stops: unknown key; known: steps, batch"),
     ({"loop": {"steps": "3"}}, "params.loop.steps: '3' is str, expected a valid integer"),
     ({"loop": {"steps": 1.5}}, "params.loop.steps: 1.5 is float, expected a valid integer"),
     ({"loop": {"steps": True}}, "params.loop.steps: True is bool, expected a valid integer"),
     ({"loop": {"steps": None}}, "params.loop.steps: None is NoneType, expected a valid integer"),
     ({"loop": None}, "params.loop: None is NoneType, expected an object"),
     ({"sizes": [1, "a"]}, "params.sizes.1: 'a' is str, expected a valid integer"),
     ({"limit": "3"}, "params.limit: '3' is str, expected a valid integer")],
)  # fmt: skip
def test_errors_name_the_key(values, message):
    with pytest.raises(RacinesError, match=message):
        fill(Method, values)


def test_what_json_has_no_word_for_is_converted():
    filled = fill(Method, {"rate": 2, "sizes": [1, 2], "limit": None})
    assert filled == Method(rate=2.0, sizes=(1, 2)) and isinstance(filled.rate, float)
    assert fill(Method, {"limit": 4}).limit == 4 and fill(Method, {"rate": math.inf}).rate > 1e300


def test_a_subclass_in_a_default_keeps_its_own_fields():
    assert fill(Outer, {"method": {"extra": 2}}).method == Special(extra=2)
    with pytest.raises(RacinesError, match="unknown key; known: rate, loop, sizes, limit, extra"):
        fill(Outer, {"method": {"exrta": 2}})


def test_what_has_no_default_is_needed():
    with pytest.raises(RacinesError, match="task.view: needed"):
        fill(Needy, {}, "task")


def test_all_faults_of_a_section_are_told_at_once_with_the_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("seed: 1\nnested:\n  method: {rate: fast, loop: {stops: 3, batch: x}}\n")
    values = section(read_params(path), "nested.method") | {"limit": 1.5}
    with pytest.raises(RacinesError) as refused:
        fill(Method, {"rate": 1} | values, "nested.method")
    told = str(refused.value)
    assert told.startswith(f"{path}: nested.method.rate: 'fast'") and told.count(" expected ") == 3
    for key in ("loop.stops: unknown key", "loop.batch: 'x'", "limit: 1.5"):
        assert f"nested.method.{key}" in told


@pytest.mark.parametrize(
    ("text", "message"),
    [("seed: abc", "mine.yaml: seed: 'abc' is str, expected a valid integer"),
     ("seed:", "seed: None"),
     ("board: 3", "mine.yaml: board: 3 is int, expected a valid string")],
)  # fmt: skip
def test_what_stands_beside_the_sections_is_checked(tmp_path, text, message):
    (tmp_path / "mine.yaml").write_text(text + "\n")
    with pytest.raises(RacinesError, match=message):
        read_params(tmp_path / "mine.yaml")


def test_a_section_is_a_mapping():
    with pytest.raises(RacinesError, match=r"a\.b: 3 is no mapping"):
        section({"a": {"b": 3}}, "a.b.c")
    assert section({"a": {"x.y:Z": {"k": 1}}}, ("a", "x.y:Z")) == {"k": 1}
    assert section({"a": None}, "a.b") == {}


def test_settings_are_written_as_they_were_read():
    params = read_params(profile="smoke")
    assert yaml.safe_load(yaml.safe_dump(params | {"seed": 3})) == params | {"seed": 3}
