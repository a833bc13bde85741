"""The command itself with `--engine ray`: what it writes is what it writes without."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from racines_models.provenance import same_result
from tests.conftest import TINY, command, text_of
from tests.data.build.test_build import files

NOBODY = "127.0.0.1:1"
"""An address at which nothing listens."""
EVAL = ("eval", "agent", "random", "--starts", "2", "--set", "latency=0", "--json")
BUILD = ("data", "build", "--frames", "40", "--json", "--out")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(TINY))
    return tmp_path


@pytest.fixture
def address(cluster: None) -> str:
    """Where the Ray of these tests listens, as `--address` has it."""
    import ray

    return ray.get_runtime_context().gcs_address


def told(folder: Path, *words: str) -> dict[str, Any]:
    return json.loads(command(folder, "racines", *words).stdout)


@pytest.mark.thorough
@pytest.mark.slow
def test_an_evaluation_on_ray_has_the_numbers_of_one_here(place: Path, address: str):
    one = told(place, *EVAL, "--out", "here/random.json")
    on_ray = ("--engine", "ray", "--address", address)
    other = told(place, *EVAL, "--out", "ray/random.json", *on_ray)
    assert same_result(one, other) and other == json.loads(text_of(place / "ray/random.json"))
    items = [(place / each / "random.parquet").read_bytes() for each in ("here", "ray")]
    assert items[0] == items[1], "every episode"


@pytest.mark.thorough
def test_a_dataset_built_on_ray_has_the_digest_of_one_built_here(place: Path, address: str):
    here = told(place, *BUILD, "here")
    there = told(place, *BUILD, "ray", "--engine", "ray", "--address", address)
    for key in ("digest", "recipe_digest"):
        assert here[key] == there[key]
    assert files(place / "ray") == files(place / "here")


@pytest.mark.parametrize("words", [EVAL, (*BUILD, "made")], ids=["eval", "build"])
def test_the_command_says_in_one_line_that_nobody_answers(place: Path, words: tuple[str, ...]):
    done = command(place, "racines", *words, "--engine", "ray", "--address", NOBODY, code=1)
    [line] = done.stderr.strip().splitlines()
    assert line.startswith(f"racines: --address {NOBODY}: no Ray answers there: start one with")
    assert not done.stdout and [each.name for each in place.iterdir()] == ["params.yaml"]
