"""`racines weights`: what is listed is what git tracks, broken files are named, cards are true."""

import json
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_leaderboard.weights.card import model_card
from racines_models.published import places
from racines_models.published.catalogue import CATALOGUE, read_catalogue
from tests import weights_manifest
from tests.prose import weights


def run(*words: str):
    return CliRunner().invoke(app, ["weights", *words])


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with one set of weights, named like the published manifest names it."""
    monkeypatch.chdir(tmp_path)
    told = json.loads((places.CHECKOUT / CATALOGUE).read_text())
    told["sets"] = {name: told["sets"][name] for name in ("ppo",)}
    shutil.copytree(places.CHECKOUT / places.POLICIES / "ppo", places.POLICIES / "ppo")
    CATALOGUE.parent.mkdir(parents=True)
    CATALOGUE.write_text(json.dumps(told))
    return tmp_path


def test_the_manifest_says_what_git_tracks():
    told = json.loads((places.CHECKOUT / CATALOGUE).read_text())
    assert told == weights_manifest.manifest(), "run python -m tests.weights_manifest"
    files = {
        f"{each['folder']}/{name}": record["sha256"]
        for each in told["sets"].values()
        for name, record in each["files"].items()
    }
    assert {each.path: each.sha256 for each in weights.tracked()}.items() <= files.items()


def test_all_are_listed_with_size_and_boards():
    done = run("list")
    assert done.exit_code == 0 and max(map(len, done.stdout.splitlines())) < 90
    listed = json.loads(run("list", "--json").stdout)["weights"]
    assert len(listed) == len(read_catalogue().sets)
    servo = next(each for each in listed if each["name"] == "servo")
    assert servo["boards"] == ["beating", "patients"] and len(servo["records"]) > 1
    assert all(f"  {each['name']} " in done.stdout for each in listed)


def test_what_is_whole_is_verified_and_what_is_not_is_named(copied: Path):
    assert run("verify").exit_code == 0
    file = places.POLICIES / "ppo/seed-1/policy.safetensors"
    content = bytearray(file.read_bytes())
    content[100] ^= 1
    file.write_bytes(content)
    (places.POLICIES / "ppo/config.json").unlink()
    done = run("verify", "ppo")
    assert done.exit_code == 1
    first, second = sorted(done.stderr.splitlines())
    assert "ppo/config.json: missing" in first and "restore" in first
    assert str(file) in second and "sha256" in second
    broken = json.loads(run("verify", "--json").stdout)["broken"]
    assert {each["file"] for each in broken} == {str(file), "envs/weights/ppo/config.json"}


@pytest.mark.parametrize("name", ["flow", "servo", "grader", "constant-pose", "ppo.onnx"])
def test_a_card_says_method_data_settings_scores_licence_and_limits(name: str):
    catalogue = read_catalogue()
    page = model_card(catalogue, catalogue.sets[name])
    front, _, body = page.removeprefix("---\n").partition("\n---\n")
    head = yaml.safe_load(front)
    assert head["license"] == "apache-2.0" and head["library_name"] == "racines"
    parts = "## Trained on,## Intended use,## Load,## Scores,## Licence,## Limits,CC BY 4.0"
    for part in ("not a medical device", *parts.split(",")):
        assert part in body, part
    for record in catalogue.sets[name].records:
        assert record in body
        metrics = json.loads((catalogue.root / record).read_text())["scores"]["metrics"]
        figure, told = next((k, v) for k, v in metrics.items() if v["value"] is not None)
        assert f"| `{figure}` | {told['value']:.4g} |" in body
    assert all(told["sha256"] in body for told in catalogue.sets[name].files.values())


def test_floors_that_share_a_file_have_each_their_own_rows():
    sets = read_catalogue().sets
    for name in ("blind-tour", "constant-pose"):
        assert sets[name].records and all(f"/{name}-" in each for each in sets[name].records)


def test_what_is_not_there_is_told(copied: Path, monkeypatch: pytest.MonkeyPatch):
    for words in (("card", "pp"), ("verify", "pp"), ("fetch", "pp")):
        with pytest.raises(RacinesError, match="did you mean ppo"):
            raise run(*words).exception or AssertionError(words)
    assert "here already" in run("fetch", "ppo").stdout
    (places.POLICIES / "ppo/config.json").unlink()
    assert "names nobody on the Hub" in str(run("fetch", "ppo").exception)
    CATALOGUE.write_text('{"schema": "racines.weights/9", "sets": {}}')
    assert "racines.weights/9" in str(run("list").exception)
    CATALOGUE.unlink()
    monkeypatch.setattr(places, "CHECKOUT", copied)
    assert "checkout" in str(run("list").exception)


def test_a_card_is_written_to_a_file(copied: Path):
    assert run("card", "ppo", "--out", "cards/ppo.md").exit_code == 0
    written = Path("cards/ppo.md").read_text(encoding="utf-8")
    assert "# ppo" in written and "records of its rows are not here" in written
