"""Push and pull with a Hub in memory; streaming by shard from a folder as the Hub has it."""

import json
import shutil
from pathlib import Path

import datasets
import pytest
import torch
from datasets.distributed import split_dataset_by_node

import racines_data
from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.hub.fetch import download
from racines_data.hub.push import Push, plan_push, push
from racines_data.store.sweeps import restore_stores
from tests import warm
from tests.conftest import command
from tests.data.fake_hub import FakeHub, Repository
from tests.data.fake_source import FakeConfig, FakeSource

REPO = "someone/racines"
TAG = "phantom-v0.1.0"


@pytest.fixture
def hub(tmp_path: Path) -> FakeHub:
    return FakeHub(folder=tmp_path / "hub-cache")


def send(hub: FakeHub, root: Path, **options) -> dict:
    return push(root, plan_push(root, REPO, **options), api=hub)


def other(folder: Path, seed: int, shards: int = 16) -> Path:
    build(FakeSource(FakeConfig(seed=seed)), folder, DataConfig(workers=1, shards=shards))
    return folder


def test_a_push_sends_everything_but_the_store_and_tags_it(hub: FakeHub, built: Path):
    made = send(hub, built)
    files = set(json.loads((built / "manifest.json").read_text())["files"])
    assert "store/frames.arrow" in files and "croissant.json" in files
    on_hub = hub.repositories[REPO].tree(TAG)
    assert {*on_hub} - {".gitattributes"} == files - {"store/frames.arrow"} | {"manifest.json"}
    assert all(on_hub[name] == (built / name).read_bytes() for name in made["files"])
    assert made["uploaded"] and made["tag"] == TAG
    assert made["commit"] == hub.repositories[REPO].tags[TAG]
    assert made["left_out"] == {"store/frames.arrow": (built / "store/frames.arrow").stat().st_size}


def test_the_store_goes_too_if_asked(hub: FakeHub, built: Path):
    send(hub, built, with_store=True)
    assert "store/frames.arrow" in hub.repositories[REPO].tree(TAG)


def test_a_failed_push_tags_nothing_and_goes_on_when_run_again(hub: FakeHub, built: Path):
    hub.fail_after = 7
    with pytest.raises(RacinesError, match="the connection broke.*run the command again"):
        send(hub, built)
    assert not hub.repositories[REPO].tags and len(hub.sent) == 7
    hub.fail_after = None
    assert send(hub, built)["uploaded"]
    assert len(hub.sent) == len(set(hub.sent)) == len(plan_push(built, REPO).files)
    assert TAG in hub.repositories[REPO].tags


def test_the_same_version_is_not_sent_twice(hub: FakeHub, built: Path):
    first = send(hub, built)
    again = send(hub, built)
    assert again["uploaded"] is False and again["commit"] == first["commit"]
    assert hub.calls.count("upload_folder") == 1


def test_a_tag_of_other_content_is_never_overwritten(hub: FakeHub, built: Path, tmp_path: Path):
    send(hub, built)
    before = dict(hub.repositories[REPO].tags)
    with pytest.raises(RacinesError, match="holds other content.*raise the dataset's version"):
        send(hub, other(tmp_path / "other", seed=1))
    assert hub.repositories[REPO].tags == before and hub.calls.count("upload_folder") == 1
    with pytest.raises(RacinesError, match="the same content in other files"):
        send(hub, other(tmp_path / "fewer", seed=0, shards=4))


def test_a_tag_of_something_else_is_left_alone(hub: FakeHub, built: Path):
    hub.repositories[REPO] = Repository(tags={TAG: "c0"})
    with pytest.raises(RacinesError, match="not of a RACINES dataset"):
        send(hub, built)


def test_a_new_version_replaces_the_branch_and_keeps_the_old_tag(
    hub: FakeHub, built: Path, tmp_path: Path
):
    send(hub, built)
    newer = other(tmp_path / "newer", seed=1, shards=4)
    send(hub, newer, tag="phantom-v0.2.0")
    repository = hub.repositories[REPO]
    shards = {path.name for path in newer.glob("data/frames/*")}
    on_main = {p.split("/")[-1] for p in repository.tree("main") if p.startswith("data/frames/")}
    assert on_main == shards != {path.name for path in built.glob("data/frames/*")}
    assert ".gitattributes" in repository.tree("main")
    assert all((built / n).read_bytes() == repository.tree(TAG)[n] for n in ("README.md",))


def test_a_repository_of_something_else_is_not_wiped(hub: FakeHub, built: Path):
    tree = {".gitattributes": b"", "weights.safetensors": b"years of work"}
    hub.repositories[REPO] = Repository(commits={"c0": tree})
    with pytest.raises(RacinesError, match=r"holds something else \(weights.safetensors\)"):
        send(hub, built)
    assert hub.repositories[REPO].tree("main") == tree


def test_what_arrives_damaged_is_not_tagged(hub: FakeHub, built: Path):
    hub.damage = "data/frames/train-00000-of-00008.parquet"
    with pytest.raises(RacinesError, match="not on the Hub as it is here; nothing was tagged"):
        send(hub, built)
    assert not hub.repositories[REPO].tags


def test_a_damaged_dataset_is_not_pushed(built: Path, tmp_path: Path):
    root = tmp_path / "racines"
    shutil.copytree(built, root)
    path = root / "data/frames/train-00000-of-00008.parquet"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(RacinesError, match="train-00000-of-00008.parquet: damaged"):
        plan_push(root, REPO)
    with pytest.raises(RacinesError, match="not a repository's name"):
        plan_push(built, "a/b/c")


def test_a_branch_of_its_own(hub: FakeHub, built: Path):
    send(hub, built, revision="next", tag="trial-v0.0.1")
    assert "manifest.json" not in hub.repositories[REPO].tree("main")
    assert "manifest.json" in hub.repositories[REPO].tree("next")


def test_no_token_is_said_before_anything_is_sent(built: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("huggingface_hub.get_token", lambda: None)
    with pytest.raises(RacinesError, match="set HF_TOKEN"):
        push(built, plan_push(built, REPO))


def test_dry_run_says_what_would_go_without_network(built: Path, tmp_path: Path):
    words = ("racines", "data", "push", REPO, "--root", str(built), "--dry-run")
    told = json.loads(command(tmp_path, *words, "--json").stdout)
    plan = plan_push(built, REPO)
    assert told == {**plan.to_json(), "private": False, "dry_run": True}
    assert told["bytes"] == sum((built / name).stat().st_size for name in told["files"])
    text = command(tmp_path, *words, "--private", "--cards", "cards").stdout
    assert (tmp_path / "cards/README.md").read_bytes() == (built / "README.md").read_bytes()
    assert all(name in text for name in plan.files)
    assert f"to dataset {REPO} (private if new), branch main, tag {TAG}" in text
    assert "store/frames.arrow  (stays here" in text
    # Without --dry-run the tests' offline setting refuses, and the reason is one line.
    words = ("env", "HF_TOKEN=hf_none", *words[:-1])
    assert "the Hub refused or failed (Offline" in command(tmp_path, *words, code=1).stderr


def test_a_download_is_checked_and_equal(hub: FakeHub, built: Path):
    send(hub, built)
    root = download(REPO, "0.1.0", api=hub)
    assert not (root / "store").exists()
    ours, theirs = (racines_data.load(root=folder) for folder in (built, root))
    assert {name: len(part) for name, part in theirs.items()} == {
        name: len(part) for name, part in ours.items()
    }
    assert theirs["test"]["position_x"][:] == ours["test"]["position_x"][:]


def test_the_store_is_made_again_byte_for_byte(hub: FakeHub, built: Path, tmp_path: Path):
    send(hub, built)
    root = download(REPO, out=tmp_path / "fetched", stores=True, api=hub)
    assert (root / "store/frames.arrow").read_bytes() == (built / "store/frames.arrow").read_bytes()
    manifest = (root / "manifest.json").read_text()
    assert manifest == (built / "manifest.json").read_text()
    ours, theirs = racines_data.open_store(built), racines_data.open_store(root)
    assert torch.equal(ours.images, theirs.images)
    assert restore_stores(root) == []  # it is there


def test_a_store_that_is_laid_out_otherwise_is_sealed_anew(built: Path, tmp_path: Path):
    root = tmp_path / "racines"
    shutil.copytree(built, root)
    (root / "store/frames.arrow").unlink()
    manifest = json.loads((root / "manifest.json").read_text())
    manifest["files"]["store/frames.arrow"] = {"sha256": "of another pyarrow", "bytes": 1}
    (root / "manifest.json").write_text(json.dumps(manifest))
    assert restore_stores(root) == ["store/frames.arrow"]
    assert torch.equal(racines_data.open_store(root).images, racines_data.open_store(built).images)


def test_versions_are_found_by_tag(hub: FakeHub, built: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="the Hub refused or failed.*check the name"):
        download(REPO, api=hub)
    send(hub, built)
    newer = other(tmp_path / "newer", seed=1)
    send(hub, newer, tag="phantom-v0.10.0")
    digests = {
        version: json.loads((download(REPO, version, api=hub) / "manifest.json").read_text())
        for version in (None, "0.1.0", "phantom-v0.10.0")
    }
    newest = json.loads((newer / "manifest.json").read_text())["digest"]
    assert digests[None]["digest"] == digests["phantom-v0.10.0"]["digest"] == newest
    assert digests["0.1.0"]["digest"] != newest
    with pytest.raises(RacinesError, match=f"no version 3.0.0 there; its tags: {TAG}"):
        download(REPO, "3.0.0", api=hub)
    hub.repositories[REPO].tags["release-v0.10.0"] = "c0"
    with pytest.raises(RacinesError, match="of several sources"):
        download(REPO, api=hub)


def test_a_damaged_download_is_named(hub: FakeHub, built: Path):
    send(hub, built)
    tree = hub.repositories[REPO].tree(TAG)
    tree["data/frames/test-00000-of-00004.parquet"] = b"cut short"
    with pytest.raises(RacinesError, match="test-00000-of-00004.parquet: damaged.*fetch"):
        download(REPO, "0.1.0", api=hub)


def test_load_fetches_from_the_hub(hub: FakeHub, built: Path, monkeypatch: pytest.MonkeyPatch):
    send(hub, built)
    monkeypatch.setattr("huggingface_hub.HfApi", lambda **options: hub)
    for version in ("0.1.0", TAG, None):
        assert len(racines_data.load(version, split="test", repo_id=REPO)) == 50


@pytest.fixture
def stream(built: Path) -> datasets.IterableDataset:
    return datasets.load_dataset(str(built), split="train", streaming=True)


def rows(part) -> list[tuple[str, int]]:
    return [(row["trajectory"], row["frame"]) for row in part]


def test_shards_are_divided_among_nodes(stream: datasets.IterableDataset):
    assert stream.num_shards == 8
    parts = [split_dataset_by_node(stream, rank, world_size=4) for rank in range(4)]
    assert [part.num_shards for part in parts] == [2] * 4
    read = [rows(part) for part in parts]
    assert all(read) and sorted(sum(read, [])) == sorted(rows(stream))
    assert len(set(sum(read, []))) == 100


def test_shards_are_divided_among_workers(stream: datasets.IterableDataset):
    kept = stream.select_columns(["trajectory", "frame"])
    workers = {"num_workers": 2, "multiprocessing_context": warm.get_context()}
    loader = torch.utils.data.DataLoader(kept, batch_size=None, **workers)
    assert sorted(rows(loader)) == sorted(rows(stream))
    assert sorted(rows(kept.shard(num_shards=2, index=0)) + rows(kept.shard(2, 1))) == sorted(
        rows(stream)
    )


def test_a_plan_is_json():
    plan = Push("a/b", "main", TAG, "d", {"x": {"bytes": 3, "sha256": "s"}}, {})
    assert json.loads(json.dumps(plan.to_json()))["bytes"] == 3
