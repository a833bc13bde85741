"""Published weights go to the Hub with their cards, and come back as the manifest names them."""

import json
import shutil
from pathlib import Path

import pytest
from huggingface_hub import ModelCard
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_leaderboard.weights.push import plan_pushes, push
from racines_models.published import places
from racines_models.published.catalogue import CATALOGUE, Catalogue, broken_files, read_catalogue
from racines_models.published.hub import fetch, tag_of
from tests.data.fake_hub import FakeHub, Repository

REPO = "someone/racines-ppo"
RECORD = Path("leaderboard/results/phantom-default/agents/ppo.json")
WEIGHTS = places.POLICIES / "ppo/seed-1/policy.safetensors"


@pytest.fixture
def hub(tmp_path: Path) -> FakeHub:
    return FakeHub(folder=tmp_path / "hub-cache", kind="model")


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Catalogue:
    """A checkout with one set of weights, and one record of it."""
    monkeypatch.chdir(tmp_path)
    told = json.loads((places.CHECKOUT / CATALOGUE).read_text())
    told["sets"] = {"ppo": told["sets"]["ppo"]}
    shutil.copytree(places.CHECKOUT / places.POLICIES / "ppo", places.POLICIES / "ppo")
    CATALOGUE.parent.mkdir(parents=True)
    CATALOGUE.write_text(json.dumps(told))
    RECORD.parent.mkdir(parents=True)
    shutil.copy(places.CHECKOUT / RECORD, RECORD)
    return read_catalogue()


def send(hub: FakeHub, catalogue: Catalogue) -> dict:
    (plan,) = plan_pushes(catalogue, catalogue.sets.values(), "someone")
    return push(plan, api=hub)


def test_a_push_sends_files_and_card_and_tags_them(hub: FakeHub, copied: Catalogue):
    made, weights = send(hub, copied), copied.sets["ppo"]
    tree = hub.repositories[REPO].tree(made["tag"])
    assert {*tree} - {".gitattributes"} == {"README.md", *weights.files}
    for name in weights.files:
        assert tree[name] == (copied.root / weights.folder / name).read_bytes(), name
    assert made["tagged"] and made["tag"] == tag_of(weights) and made["commit"]


def test_its_card_has_the_figures_of_the_records_with_n(copied: Catalogue):
    (plan,) = plan_pushes(copied, copied.sets.values(), "someone")
    results = ModelCard(plan.card).data.eval_results
    assert results is not None
    metrics = json.loads(RECORD.read_text(encoding="utf-8"))["scores"]["metrics"]
    found = {each.metric_type: each for each in results}
    assert {name for name, told in metrics.items() if told["value"] is not None} == {*found}
    told = found["success_true"]
    assert told.metric_value == metrics["success_true"]["value"]
    assert told.metric_args is not None and told.metric_args["n"] == metrics["success_true"]["n"]
    assert told.dataset_args is not None and told.dataset_args["board"] == "phantom-default"
    assert "racines weights fetch ppo --hub someone" in plan.card and plan.tag in plan.card


@pytest.mark.parametrize(
    "name",
    ["flow", "grader", "student", "pose", "phantom-patients/segmentation", "ppo", "ppo.onnx"],
)
def test_the_code_of_a_card_loads_the_weights(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(places.CHECKOUT)
    catalogue = read_catalogue()
    (plan,) = plan_pushes(catalogue, [catalogue.sets[name]], "someone")
    exec(plan.card.partition("```python\n")[2].partition("```")[0], {})


def test_a_failed_push_tags_nothing_and_goes_on_when_run_again(hub: FakeHub, copied: Catalogue):
    hub.fail_after = 3
    with pytest.raises(RacinesError, match="the connection broke.*run the command again"):
        send(hub, copied)
    assert not hub.repositories[REPO].tags
    hub.fail_after = None
    assert send(hub, copied)["tagged"] and len(hub.sent) == len(set(hub.sent))


def test_a_new_card_goes_to_the_branch_and_the_tag_stays(hub: FakeHub, copied: Catalogue):
    first = send(hub, copied)
    RECORD.unlink()
    again = send(hub, copied)
    repository = hub.repositories[REPO]
    assert not again["tagged"] and repository.tags == {first["tag"]: first["commit"]}
    cards = [repository.tree(each)["README.md"] for each in ("main", first["tag"])]
    assert cards[0] != cards[1] and hub.sent.count(WEIGHTS.name) == hub.sent.count("config.json")


def test_what_arrives_damaged_is_not_tagged(hub: FakeHub, copied: Catalogue):
    hub.damage = "seed-1/policy.safetensors"
    with pytest.raises(RacinesError, match="not on the Hub as it is here; nothing was tagged"):
        send(hub, copied)
    assert not hub.repositories[REPO].tags


def test_a_repository_of_something_else_is_not_wiped(hub: FakeHub, copied: Catalogue):
    tree = {".gitattributes": b"", "theirs.bin": b"years of work"}
    hub.repositories[REPO] = Repository(commits={"c0": tree})
    with pytest.raises(RacinesError, match=r"holds something else \(theirs.bin\)"):
        send(hub, copied)
    assert hub.repositories[REPO].tree("main") == tree


def test_damaged_weights_are_not_pushed(copied: Catalogue):
    WEIGHTS.write_bytes(WEIGHTS.read_bytes()[:-1] + b"x")
    with pytest.raises(RacinesError, match="damaged .*, not pushed; get it again"):
        plan_pushes(copied, copied.sets.values(), "someone")
    with pytest.raises(RacinesError, match="not an owner's name"):
        plan_pushes(copied, copied.sets.values(), "some/one")


def test_what_is_missing_is_fetched_and_nothing_else(hub: FakeHub, copied: Catalogue):
    send(hub, copied)
    weights = copied.sets["ppo"]
    WEIGHTS.unlink()
    kept = (places.POLICIES / "ppo/policy.safetensors").stat().st_mtime_ns
    assert fetch(copied, weights, "someone", api=hub) == ["seed-1/policy.safetensors"]
    assert not broken_files(copied, [weights])
    assert (places.POLICIES / "ppo/policy.safetensors").stat().st_mtime_ns == kept
    calls = len(hub.calls)
    assert fetch(copied, weights, "someone", api=hub) == [] and len(hub.calls) == calls


@pytest.mark.parametrize("wrong", [b"short", None, "same size"])
def test_other_files_than_the_manifest_names_are_not_written(
    hub: FakeHub, copied: Catalogue, wrong: bytes | str | None
):
    made, name = send(hub, copied), "seed-1/policy.safetensors"
    tree = hub.repositories[REPO].tree(made["tag"])
    content = tree.pop(name)
    if wrong is not None:
        tree[name] = wrong if isinstance(wrong, bytes) else content[:-1] + b"x"
    shutil.rmtree(places.POLICIES / "ppo")
    with pytest.raises(RacinesError, match=f"{REPO}: {name} "):
        fetch(copied, copied.sets["ppo"], "someone", api=hub)
    assert not (places.POLICIES / "ppo").exists()


def test_a_dry_run_lists_and_writes_cards_and_asks_nobody(
    copied: Catalogue, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("huggingface_hub.HfApi", None)
    words = ["weights", "push", "someone", "--dry-run", "--cards", "cards"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "seed-2/policy.safetensors" in done.stdout and "would send 1 model" in done.stdout
    assert "# ppo" in Path("cards/racines-ppo/README.md").read_text(encoding="utf-8")
    told = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert told["dry_run"] and told["weights"][0]["repo_id"] == REPO


def test_no_token_is_said_before_anything_is_sent(
    copied: Catalogue, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("huggingface_hub.get_token", lambda: None)
    done = CliRunner().invoke(app, ["weights", "push", "someone", "ppo"])
    assert "set HF_TOKEN" in str(done.exception)


def test_repositories_of_all_sets_differ():
    catalogue = read_catalogue()
    plans = plan_pushes(catalogue, catalogue.sets.values(), "someone")
    assert len({each.repo_id for each in plans}) == len(catalogue.sets)
