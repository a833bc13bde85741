"""Digests: of all that a row says, of nothing else, and the same as ever."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from racines_data import digest
from racines_data.digest import canonical_json, check_files, content_digest, trajectory_digest
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.schema import Trajectory


def sweep() -> Trajectory:
    """Three frames with every kind of value, the absent ones too."""
    rows = np.arange(3)
    return Trajectory(
        "t0", "s0", "A4C",
        images=np.arange(3 * 128 * 128, dtype=np.uint32).reshape(3, 128, 128).astype(np.uint8),
        parameters=np.arange(36, dtype=np.float32).reshape(3, 12) / 8,
        timestamps=rows / 30.0,
        controls=np.full((3, 6), np.nan, np.float32),
        views=np.array([0, 5, -1]),
        grades=np.array([7.5, 0.0, np.nan], np.float32),
        phantom=3,
    )  # fmt: skip


def changed(column: np.ndarray, by: float) -> np.ndarray:
    column = column.copy()
    column.flat[0] = column.flat[0] + by
    return column


CHANGES = {
    "id": lambda t: "t1",
    "session": lambda t: "s1",
    "target_view": lambda t: "SC",
    "phantom": lambda t: None,
    "images": lambda t: changed(t.images, 1),
    "parameters": lambda t: changed(t.parameters, 1e-3),
    "timestamps": lambda t: t.timestamps * (1 + 1e-12),  # lost in single precision
    "controls": lambda t: np.zeros((3, 6), np.float32),
    "views": lambda t: changed(t.views, 1),
    "grades": lambda t: changed(t.grades, 0.5),
}


@pytest.mark.parametrize("name", CHANGES)
def test_all_that_a_trajectory_says_is_in_its_digest(name):
    plain = sweep()
    other = replace(plain, **{name: CHANGES[name](plain)})
    assert trajectory_digest(other) != trajectory_digest(plain)


def test_frames_are_counted_and_types_and_bits_of_nan_are_not_looked_at():
    plain = sweep()
    none = {name: getattr(plain, name)[:0] for name in ("images", "parameters", "timestamps")}
    none |= {name: getattr(plain, name)[:0] for name in ("controls", "views", "grades")}
    assert trajectory_digest(replace(plain, **none)) != trajectory_digest(plain)
    other_nan = np.full((3, 6), np.nan, np.float32)
    other_nan.view(np.uint32)[:] |= 1
    wide = replace(plain, views=plain.views.astype(np.int32), controls=other_nan)
    assert trajectory_digest(wide) == trajectory_digest(plain)


def test_digests_are_those_on_record():
    """Another way to hash would make every published digest wrong."""
    assert trajectory_digest(sweep()) == (
        "d18e8faf4e092e0d6f3acc24cde494e27cbd81342e9f781545e21c938062614e"
    )
    rows = [("train", "t0", "ab"), ("test", "t1", "cd")]
    assert content_digest(rows, "phantom", version=1) == (
        "89686b1cc4d516b232ff8844f4278a48bda4aa8f5b2e125b6759e76b0c1b2df1"
    )


def test_a_datasets_digest_knows_splits_and_order():
    rows = [("train", "t0", "ab"), ("test", "t1", "cd")]
    moved = [("test", "t0", "ab"), ("test", "t1", "cd")]
    each = (rows, moved, rows[::-1], rows[:1])
    assert len({content_digest(r, "phantom", v) for r in each for v in (1, 2)}) == 8


def test_a_datasets_digest_knows_its_source_since_version_2():
    rows = [("train", "t0", "ab"), ("test", "t1", "cd")]
    names = "phantom", "release", "tracked", ""
    assert len({content_digest(rows, name) for name in names}) == 4
    assert len({content_digest(rows, name, version=1) for name in names}) == 1
    # A row cannot be written so that it reads as the head of another source.
    assert content_digest([('{"digest":2,', "a", "b"), *rows], "phantom", 1) not in (
        content_digest(rows, name) for name in names
    )


def test_json_is_one_text_for_equal_values_and_refuses_what_is_none():
    assert canonical_json({"b": [1, 2.5], "a": None}) == '{"a":null,"b":[1,2.5]}'
    with pytest.raises(ValueError, match="JSON compliant"):
        canonical_json({"a": float("nan")})


def test_damage_is_seen_whatever_its_size_and_time(tmp_path, monkeypatch):
    path = tmp_path / "a.bin"
    path.write_bytes(b"whole")
    files = {"a.bin": {"bytes": 5, "sha256": sha256_file(path)}}
    check_files(tmp_path, files, "build it")
    before = path.stat()
    path.write_bytes(b"wrong")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns + 1_000_000))
    with pytest.raises(RacinesError, match=r"a.bin: damaged \(sha256 differs\); build it"):
        check_files(tmp_path, files, "build it")
    path.write_bytes(b"longer")
    with pytest.raises(RacinesError, match=r"damaged \(6 bytes, expected 5\)"):
        check_files(tmp_path, files, "build it")
    path.unlink()
    with pytest.raises(RacinesError, match=r"missing; build it"):
        check_files(tmp_path, files, "build it")


def test_a_whole_file_is_read_once_until_it_changes(tmp_path, monkeypatch):
    path = tmp_path / "a.bin"
    path.write_bytes(b"whole")
    files = {"a.bin": {"bytes": 5, "sha256": sha256_file(path)}}
    read = []
    monkeypatch.setattr(digest, "sha256_file", lambda path: read.append(path) or sha256_file(path))
    for expected in (1, 1):
        check_files(tmp_path, files, "build it")
        assert len(read) == expected
    os.utime(path, ns=(0, 0))
    check_files(tmp_path, files, "build it")
    assert len(read) == 2
    (tmp_path / "b.bin").write_bytes(b"wrong")
    with pytest.raises(RacinesError, match=r"b.bin: damaged"):
        check_files(tmp_path, files | {"b.bin": files["a.bin"]}, "build it")


def test_what_was_checked_is_remembered_in_the_users_cache_if_that_can_be(tmp_path, monkeypatch):
    for name in ("a.bin", "b.bin"):
        (tmp_path / name).write_bytes(b"whole")
    record = {"bytes": 5, "sha256": sha256_file(tmp_path / "a.bin")}
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("a.bin", "b.bin"):
        check_files(tmp_path, {name: record}, "build it")
    memory = json.loads((tmp_path / ".cache/racines/verified.json").read_text())
    assert set(memory) == {str(tmp_path / name) for name in ("a.bin", "b.bin")}
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    check_files(tmp_path, {"a.bin": record}, "build it")
    assert (tmp_path / "cache/racines/verified.json").is_file()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a.bin"))  # no folder
    check_files(tmp_path, {"a.bin": record}, "build it")
