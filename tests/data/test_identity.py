"""Whoever changes a dataset's bytes is found, whatever he does to times, sizes and the manifest."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import datasets
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import racines_data
from racines_data.card.markdown import write_card
from racines_data.digest import check_files, content_digest
from racines_data.errors import RacinesError
from racines_data.files import sampled_sha256, sha256_file
from racines_data.hub.push import plan_push
from racines_data.manifest import VERIFY_VARIABLE, read_manifest
from racines_data.schema import SOURCES
from racines_data.validate.run import validate
from tests.conftest import command

REPO = "someone/racines"


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    shutil.copytree(built, tmp_path / "racines")
    return tmp_path / "racines"


def flip(path: Path, place: int) -> None:
    """Change one byte in place, and set the time of change back."""
    before = os.stat(path)
    with path.open("r+b") as file:
        file.seek(place)
        byte = file.read(1)[0]
        file.seek(place)
        file.write(bytes([byte ^ 1]))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = os.stat(path)
    assert (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns)


def files_check(root: Path) -> str:
    """Return what is wrong with the files, empty if nothing is."""
    (check,) = (check for check in validate(root).checks if check.name == "files")
    return "" if check.ok else check.detail


def rewrite(root: Path, change: Callable[[dict], None]) -> None:
    """Change the manifest, after which all files have the hashes that it gives."""
    manifest = read_manifest(root)
    change(manifest)
    for name, record in manifest["files"].items():
        record |= {"sha256": sha256_file(root / name), "bytes": (root / name).stat().st_size}
    (root / "manifest.json").write_text(json.dumps(manifest))


# --- bytes ----------------------------------------------------------------------------------------


def test_a_byte_changed_behind_the_same_size_and_time_is_found_by_load(copy: Path):
    racines_data.load(root=copy)
    shard = copy / read_manifest(copy)["configs"]["frames"]["train"][0]
    flip(shard, shard.stat().st_size // 2)
    with pytest.raises(RacinesError, match=f"{shard.name}: damaged .sha256 differs"):
        racines_data.load(root=copy)


def test_a_byte_changed_behind_the_same_size_and_time_is_found_by_the_store(copy: Path):
    racines_data.open_store(copy)
    flip(copy / "store/frames.arrow", 1_000_001)
    with pytest.raises(RacinesError, match=r"frames.arrow: damaged \(sha256 differs"):
        racines_data.open_store(copy)


def test_a_byte_changed_behind_the_same_size_and_time_is_found_by_push(copy: Path):
    plan_push(copy, REPO)
    shard = copy / read_manifest(copy)["configs"]["frames"]["test"][0]
    flip(shard, 3000)
    with pytest.raises(RacinesError, match="damaged .sha256 differs"):
        plan_push(copy, REPO)


def test_another_file_of_the_same_size_and_time_in_its_place_is_found(tmp_path: Path):
    """A rename keeps the times of the file that it moves, as `cp -p` and `rsync -t` do."""
    path, other = tmp_path / "a.bin", tmp_path / "b.bin"
    path.write_bytes(bytes(1 << 20))
    content = bytearray(1 << 20)
    content[5000] = 1  # in no block of the sample
    other.write_bytes(bytes(content))
    assert sampled_sha256(path) == sampled_sha256(other)
    files = {"a.bin": {"bytes": 1 << 20, "sha256": sha256_file(path)}}
    stat = path.stat()
    check_files(tmp_path, files, "build it")
    os.utime(other, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    os.replace(other, path)
    with pytest.raises(RacinesError, match="sha256 differs"):
        check_files(tmp_path, files, "build it")


class Frozen:
    """A file system that tells of no change: its times and inodes stay."""

    def __init__(self, path: Path) -> None:
        self.path, self.stat = path, os.stat(path)

    def __call__(self, path: Path, **_: bool) -> os.stat_result:
        return self.stat if path == self.path else os.stat(path)


def test_where_the_file_system_tells_nothing_the_sample_does(tmp_path, monkeypatch):
    path = tmp_path.resolve() / "a.bin"
    path.write_bytes(bytes(1 << 20))
    files = {"a.bin": {"bytes": 1 << 20, "sha256": sha256_file(path)}}
    frozen = Frozen(path)
    monkeypatch.setattr(Path, "stat", lambda self, **more: frozen(self, **more))
    check_files(tmp_path, files, "build it")
    flip(path, (1 << 20) - 7)  # in the last block
    with pytest.raises(RacinesError, match="sha256 differs"):
        check_files(tmp_path, files, "build it")


@pytest.mark.parametrize("how", ["argument", "environment"])
def test_verify_hashes_what_nothing_tells_of(tmp_path, monkeypatch, how):
    path = tmp_path.resolve() / "a.bin"
    path.write_bytes(bytes(1 << 20))
    files = {"a.bin": {"bytes": 1 << 20, "sha256": sha256_file(path)}}
    frozen = Frozen(path)
    monkeypatch.setattr(Path, "stat", lambda self, **more: frozen(self, **more))
    check_files(tmp_path, files, "build it")
    flip(path, 5000)  # between two blocks of the sample
    check_files(tmp_path, files, "build it")
    if how == "environment":
        monkeypatch.setenv(VERIFY_VARIABLE, "1")
    with pytest.raises(RacinesError, match="sha256 differs"):
        check_files(tmp_path, files, "build it", verify=how == "argument")


def test_the_command_passes_verify_on(copy: Path, tmp_path: Path, monkeypatch):
    """A cache of checks that somebody filled is not believed under `racines --verify`."""
    monkeypatch.delenv(VERIFY_VARIABLE, raising=False)
    words = ("data", "export", str(copy), "--format", "release", "--limit", "2", "--out")
    command(tmp_path, "racines", *words, "one")
    manifest = read_manifest(copy)
    shard = (copy / manifest["configs"]["frames"]["train"][0]).resolve()
    flip(shard, shard.stat().st_size - 500)
    known = Path(os.environ["XDG_CACHE_HOME"]) / "racines/verified.json"
    record = manifest["files"][shard.relative_to(copy.resolve()).as_posix()]
    stat = shard.stat()
    times = stat.st_mtime_ns, stat.st_ctime_ns
    forged = [stat.st_ino, stat.st_size, *times, sampled_sha256(shard), record["sha256"]]
    known.write_text(json.dumps(json.loads(known.read_text()) | {str(shard): forged}))
    done = command(tmp_path, "racines", "--verify", "data", *words[1:], "two", code=1)
    assert "sha256 differs" in done.stderr


@pytest.mark.parametrize("size", [0, 1, 4095, 4096, 4097, 300_000])
def test_a_sample_has_the_first_and_the_last_byte(tmp_path: Path, size: int):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(size))
    before = sampled_sha256(path)
    for place in {0, size - 1} if size else set():
        content = bytearray(size)
        content[place] = 1
        path.write_bytes(content)
        assert sampled_sha256(path) != before


# --- strays ---------------------------------------------------------------------------------------

STRAYS = [
    "data/frames/train-00099-of-00100.parquet",
    "notes.txt",
    "store/other.arrow",
    ".huggingface.yaml",
    "canonical/XX.png",
    "card/more.png",
]


@pytest.mark.parametrize("name", STRAYS)
def test_a_stray_file_is_refused_by_load_push_and_validate(copy: Path, name: str):
    (copy / name).parent.mkdir(exist_ok=True)
    (copy / name).write_bytes(b"stray")
    for look in (lambda: racines_data.load(root=copy), lambda: plan_push(copy, REPO)):
        with pytest.raises(RacinesError, match=f"{name} is no part of the dataset"):
            look()
    assert f"{name} is no part of the dataset" in files_check(copy)


def test_a_settings_file_that_would_serve_other_shards_is_refused(copy: Path):
    """`datasets` prefers the list of shards in `.huggingface.yaml` to the card's."""
    test = read_manifest(copy)["configs"]["frames"]["test"][0]
    own = f"configs:\n- config_name: frames\n  data_files:\n  - split: train\n    path: {test}\n"
    (copy / ".huggingface.yaml").write_text(own)
    served = datasets.load_dataset(str(copy), "frames", split="train")
    assert len(served) == pq.read_metadata(copy / test).num_rows  # frames of `test`, as `train`
    with pytest.raises(RacinesError, match=".huggingface.yaml is no part of the dataset"):
        racines_data.load(root=copy, split="train")


def test_a_linked_folder_is_a_stray(copy: Path, tmp_path: Path):
    (tmp_path / "elsewhere").mkdir()
    (copy / "more").symlink_to(tmp_path / "elsewhere")
    assert "more is no part of the dataset" in files_check(copy)


@pytest.mark.parametrize(
    "name", ["data/frames/train-00099-of-00100.parquet", ".huggingface.yaml", "canonical/XX.png"]
)
def test_a_stray_under_a_new_seal_is_refused(copy: Path, name: str):
    shard = copy / read_manifest(copy)["configs"]["frames"]["train"][0]
    shutil.copy(shard, copy / name)
    rewrite(copy, lambda manifest: manifest["files"].update({name: {}}))
    said = f"{name} of no config, store, card or canonical frame"
    assert said in files_check(copy)
    for look in (lambda: racines_data.load(root=copy), lambda: plan_push(copy, REPO)):
        with pytest.raises(RacinesError, match=said):
            look()


@pytest.mark.parametrize("name", [".DS_Store", ".gitattributes", ".cache/huggingface/a.lock"])
def test_what_file_managers_and_the_hubs_client_leave_is_no_stray(copy: Path, name: str):
    (copy / name).parent.mkdir(parents=True, exist_ok=True)
    (copy / name).write_bytes(b"theirs")
    assert not files_check(copy)
    racines_data.load(root=copy, split="test")


@pytest.mark.parametrize("name", ["../outside.txt", "/etc/hostname", "data/../../outside.txt"])
def test_a_manifest_that_names_files_outside_is_refused(copy: Path, name: str):
    """A push would publish them, and a check would tell whether they exist."""
    (copy.parent / "outside.txt").write_text("private")
    manifest = read_manifest(copy)
    manifest["files"][name] = {"bytes": 7, "sha256": sha256_file(copy.parent / "outside.txt")}
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RacinesError, match="lies outside the dataset"):
        plan_push(copy, REPO)
    with pytest.raises(RacinesError, match="lies outside the dataset"):
        check_files(copy, manifest["files"], "build it")
    assert "lies outside the dataset" in files_check(copy)


# --- the rows behind the digest -------------------------------------------------------------------


def test_other_rows_under_a_new_seal_and_the_old_digest_are_not_pushed(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["test"][0]
    table = pq.read_table(shard)
    place = table.schema.get_field_index("position_x")
    moved = pa.array(np.zeros(len(table), np.float32), table.schema.field(place).type)
    pq.write_table(table.set_column(place, table.schema.field(place), moved), shard)
    rewrite(copy, lambda manifest: None)
    check_files(copy, read_manifest(copy)["files"], "build it")  # every hash holds
    with pytest.raises(RacinesError, match="not pushed: the rows do not have the recorded content"):
        plan_push(copy, REPO)


def test_another_digest_in_the_manifest_is_not_pushed(copy: Path):
    rewrite(copy, lambda manifest: manifest.update(digest="0" * 64))
    with pytest.raises(RacinesError, match="not pushed: README.md describes another dataset"):
        plan_push(copy, REPO)


def test_a_shard_that_is_not_sealed_is_not_loaded(copy: Path):
    name = read_manifest(copy)["configs"]["frames"]["train"][0]
    (copy / name).unlink()
    manifest = read_manifest(copy)
    del manifest["files"][name]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RacinesError, match=f"{name} of config 'frames' not among the files"):
        racines_data.load(root=copy)


# --- the source -----------------------------------------------------------------------------------


def relabel(root: Path, **changes) -> None:
    """Give the dataset another manifest and the card that goes with it, all sealed anew."""
    rewrite(root, lambda manifest: manifest.update(changes))
    (root / "README.md").write_text(write_card(read_manifest(root)))
    rewrite(root, lambda manifest: None)


def name_source(root: Path, source: str) -> None:
    """Say in every row that it is of another source."""
    configs = read_manifest(root)["configs"]
    for name in {
        name for part in ("frames", "sessions") for s in configs[part].values() for name in s
    }:
        table = pq.read_table(root / name)
        place = table.schema.get_field_index("source")
        value = pa.scalar(SOURCES.index(source), table.schema.field(place).type)
        named = pa.repeat(value, len(table))
        pq.write_table(table.set_column(place, table.schema.field(place), named), root / name)


def make_old(root: Path) -> str:
    """Turn a dataset into one from before sources were digested; return its digest."""
    rows = [
        (row["split"], row["trajectory"], row["digest"])
        for split in read_manifest(root)["configs"]["trajectories"].values()
        for name in split
        for row in pq.read_table(root / name).to_pylist()
    ]
    digest = content_digest(rows, "", version=1)
    rewrite(root, lambda manifest: manifest.pop("digest_version"))
    relabel(root, digest=digest)
    return digest


def content(root: Path) -> tuple[bool, str]:
    (check,) = (check for check in validate(root).checks if check.name == "content")
    return check.ok, check.detail


def test_simulated_frames_passed_off_as_recorded_ones_have_not_that_digest(copy: Path):
    assert read_manifest(copy)["digest_version"] == 2 and content(copy)[0]
    relabel(copy, source="release")
    assert content(copy) == (False, "the rows are of phantom, recorded release")
    name_source(copy, "release")
    rewrite(copy, lambda manifest: None)
    assert content(copy) == (False, "the rows do not have the recorded content digest")
    with pytest.raises(RacinesError, match="not pushed: the rows do not have"):
        plan_push(copy, REPO)


def test_an_older_dataset_is_read_and_named_as_such(copy: Path):
    digest = make_old(copy)
    assert not [check for check in validate(copy).checks if check.binding and not check.ok]
    note = "digest version 1, which leaves the source out"
    assert content(copy) == (True, f"{digest[:16]} ({note})")
    loaded = racines_data.load(root=copy, split="test")
    assert loaded.info.description.endswith(f"{digest}; {note}")
    assert len(racines_data.open_store(copy)) == 200
    plan_push(copy, REPO)


def test_a_new_dataset_is_not_named_so(built: Path):
    assert "digest version" not in racines_data.load(root=built, split="test").info.description
    assert "digest version" not in content(built)[1]


def test_a_digest_cannot_be_called_older_than_it_is(copy: Path):
    rewrite(copy, lambda manifest: manifest.pop("digest_version"))
    assert content(copy) == (False, "the rows do not have the recorded content digest")


@pytest.mark.parametrize("version", [0, 3, "2", None, 1.5])
def test_a_digest_of_an_unknown_version_is_refused(copy: Path, version):
    manifest = read_manifest(copy) | {"digest_version": version}
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(
        RacinesError, match=f"digest_version {version!r} is unknown.*update racines"
    ):
        racines_data.load(root=copy)


def test_builds_with_digests_of_two_versions_are_compared_by_their_frames(built: Path, copy: Path):
    make_old(copy)
    check = validate(built, against=copy).checks[-1]
    assert check.ok and "the digests are of two versions" in check.detail
