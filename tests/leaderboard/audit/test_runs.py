"""Where an audit looks for the weights of a row, and what it asks for where they are not."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.audit.adapting import score_trained
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.remedies import _of_view as of_view
from racines_leaderboard.audit.weights import run_of


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """Return a board's bench that knows places, and the agents that its settings name."""
    places = SimpleNamespace(
        runs=tmp_path / "models/runs", weights=tmp_path / "models/weights",
        agents=tmp_path / "envs/runs", policies=tmp_path / "envs/weights",
    )  # fmt: skip
    settings = {"agents": {"ppo": {"repeats": 3}}, "patient_agents": {"servo": {}}}
    settings |= {"patient_generators": {"scout-attention": {}}}
    return cast(Bench, SimpleNamespace(places=places, board="patients", settings=settings))


def weights_in(folder: Path, text: str, name: str = "policy.safetensors") -> dict[str, str]:
    """Write a file of weights; return what a record names of it."""
    folder.mkdir(parents=True)
    (folder / name).write_text(text)
    return {name: sha256_file(folder / name)}


def row(track: str, name: str, weights: dict[str, str], view: str = "A4C-patients") -> Any:
    scores = {"weights": weights, "task": {"view": view}}
    return {"track": track, "name": name, "scores": scores}


def test_an_agent_may_learn_each_view_apart(bench):
    """The row's own folder is found, and not the one heart's of the agent's name."""
    own = bench.places.policies / "patients" / "ppo-a4c"
    claimed = weights_in(own, "of A4C")
    weights_in(bench.places.policies / "ppo", "of one heart")
    weights_in(bench.places.policies / "beating" / "ppo-a4c", "of beating hearts")
    assert run_of(row("patient-agents", "ppo-a4c", claimed), bench) == own
    here = bench.places.agents / "ppo-a4c"
    weights_in(here, "of A4C")
    assert run_of(row("patient-agents", "ppo-a4c", claimed), bench) == here


def test_one_network_for_all_views_is_found_by_the_agents_name(bench):
    folder = bench.places.policies / "servo"
    claimed = weights_in(folder, "of all views")
    assert run_of(row("patient-agents", "servo-a4c", claimed), bench) == folder
    absent = row("patient-agents", "servo-a4c", {"policy.safetensors": "0" * 64})
    assert run_of(absent, bench).name == "servo"


def test_a_generator_of_one_heart_is_found_on_patients(bench):
    folder = bench.places.weights / "vae-gan"
    claimed = weights_in(folder, "one heart", "model.safetensors")
    assert run_of(row("patient-generators", "vae-gan", claimed), bench) == folder
    own = bench.places.weights / "patients" / "vae-gan"
    weights_in(own, "one heart", "model.safetensors")
    assert run_of(row("patient-generators", "vae-gan", claimed), bench) == own


def test_it_is_not_trained_again_from_scouts(bench, tmp_path):
    """Nothing says how it would be: its recipe is another board's."""
    with pytest.raises(RacinesError, match="no settings patient_generators.vae-gan: .* one heart"):
        score_trained(row("patient-generators", "vae-gan", {}), bench, tmp_path)


def test_what_learns_a_view_is_trained_again_for_it(bench):
    asked = of_view(row("patient-agents", "ppo-pl", {}, "PL-beating"), bench)
    assert asked == " --view PL-beating --name ppo-pl"
    assert of_view(row("patient-agents", "servo-pl", {}, "PL-beating"), bench) == ""


def test_an_agent_that_is_not_here_stops_no_audit(bench):
    assert of_view(row("patient-agents", "nobody-a4c", {}), bench) == ""
