"""Submissions: both formats bring back what was written, and each wrong field is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.trackerless.motion import Motion
from racines_models.trackerless.submission import (
    COLUMNS,
    SCHEMA,
    Submission,
    read_submission,
    write_submission,
)
from racines_models.trackerless.sweeps import SweepSet
from tests.models.trackerless.sweeping import SweptStore


@pytest.fixture(scope="module")
def sweeps() -> SweepSet:
    return SweepSet(SweptStore())


@pytest.fixture
def made(sweeps: SweepSet) -> Submission:
    motions = {each.id: each.motion for each in sweeps.sweeps("test")}
    return Submission("mine", sweeps.store.digest, "test", motions)


@pytest.mark.parametrize("ending", [".npz", ".parquet"])
def test_what_was_written_comes_back(made, sweeps, tmp_path: Path, ending: str):
    path = tmp_path / f"mine{ending}"
    sha256 = write_submission(path, made)
    found = read_submission(path)
    assert (found.name, found.dataset, found.split) == ("mine", made.dataset, "test")
    assert found.sha256 == sha256 and list(found.motions) == list(made.motions)
    for sweep, motion in made.motions.items():
        assert torch.equal(found.motions[sweep].to_first, motion.to_first)
        assert torch.equal(found.motions[sweep].to_previous, motion.to_previous)
    found.check(path, sweeps.sweeps("test"), made.dataset, "test")
    assert write_submission(path, made) == sha256
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_frames_of_a_parquet_may_stand_in_any_order(made, tmp_path: Path):
    path = tmp_path / "mine.parquet"
    write_submission(path, made)
    table = pq.read_table(path)
    order = np.random.default_rng(0).permutation(len(table))
    pq.write_table(table.take(pa.array(order)), path)
    found = read_submission(path)
    assert all(torch.equal(found.motions[key].to_first, made.motions[key].to_first) for key in
               made.motions)  # fmt: skip


Change = Callable[[dict[str, Any], str], None]


def _set(key: str, value: Any) -> Change:
    return lambda arrays, sweep: arrays.update({key.format(sweep=sweep): value})


def _drop(key: str) -> Change:
    return lambda arrays, sweep: arrays.pop(key.format(sweep=sweep))


def _at(kind: str, change: Callable[[np.ndarray], Any]) -> Change:
    def changed(arrays: dict[str, Any], sweep: str) -> None:
        value = arrays[f"{sweep}/{kind}"].copy()
        other = change(value)
        arrays[f"{sweep}/{kind}"] = value if other is None else other

    return changed


def _put(*place: Any, value: float) -> Callable[[np.ndarray], None]:
    return lambda array: array.__setitem__(place, value)


def _scaled(factor: float) -> Callable[[np.ndarray], None]:
    def scale(array: np.ndarray) -> None:
        array[:, :3, 3] = array[:, :3, 3] * factor + 3.0 * (np.arange(len(array)) > 0)[:, None]

    return scale


def _mirrored(array: np.ndarray) -> None:
    array[3, :3, 0] *= -1


WRONG: dict[str, tuple[Change, str]] = {
    "no schema": (_drop("schema"), "schema: missing"),
    "another schema": (_set("schema", np.array("racines.motion/9")), "schema: 'racines.motion/9'"),
    "no name": (_drop("name"), "name: missing"),
    "a wrong name": (_set("name", np.array("../up")), "name: the name '../up' is refused"),
    "no dataset": (_drop("dataset"), "dataset: missing"),
    "no split": (_drop("split"), "split: missing"),
    "a number for a text": (_set("split", np.array(3)), "split: int64 of shape"),
    "an unknown key": (_set("more", np.zeros(2)), "'more': unknown: give schema, name"),
    "an unknown kind": (_set("{sweep}/to_last", np.zeros(2)), "to_last': unknown"),
    "one transform": (_drop("{sweep}/to_first"), "to_first: missing: give both"),
    "no previous": (_drop("{sweep}/to_previous"), "to_previous: missing: give both"),
    "whole numbers": (_at("to_first", lambda x: x.astype(int)), "to_first: int64: give float64"),
    "3 by 4": (_at("to_first", lambda x: x[:, :3]), r"to_first: shape \(8, 3, 4\)"),
    "fewer frames": (_at("to_first", lambda x: x[:-1]), "7 and 8 frames"),
    "NaN": (_at("to_first", _put(2, 0, 3, value=np.nan)), "to_first of frame 2: not finite"),
    "infinite": (_at("to_previous", _put(4, 1, 3, value=np.inf)), "frame 4: not finite"),
    "a last row": (_at("to_first", _put(2, 3, 0, value=1.0)), "frame 2: its last row"),
    "a stretched turn": (_at("to_previous", _put(5, 0, 0, value=2.0)), "frame 5: not a rotation"),
    "mirrored": (_at("to_first", _mirrored), "to_first of frame 3: mirrored"),
    "millimetres": (_at("to_first", _scaled(1000.0)), "likely in millimetres: give metres"),
    "a first frame": (_at("to_previous", _put(0, 0, 3, value=0.1)), "frame 0: not the identity"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_field_is_named(made, tmp_path: Path, wrong: str):
    path = tmp_path / "mine.npz"
    write_submission(path, made)
    with np.load(path) as held:
        arrays = dict(held.items())
    change, told = WRONG[wrong]
    change(arrays, next(iter(made.motions)))
    np.savez(path, **arrays)
    with pytest.raises(RacinesError, match=told):
        read_submission(path)


def _column(name: str, kind: pa.DataType) -> Callable[[pa.Table], pa.Table]:
    place = COLUMNS.names.index(name)
    return lambda table: table.set_column(place, name, table[name].cast(kind))


def _metadata(**texts: str | None) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        told = dict(table.schema.metadata)
        told |= {f"racines.{key}".encode(): (text or "").encode() for key, text in texts.items()}
        for key, text in texts.items():
            if text is None:
                del told[f"racines.{key}".encode()]
        return table.replace_schema_metadata(told)

    return change


def _null(table: pa.Table) -> pa.Table:
    names = table["sweep"].to_pylist()
    names[3] = None
    return table.set_column(0, "sweep", pa.array(names, pa.string()))


WRONG_TABLES: dict[str, tuple[Callable[[pa.Table], pa.Table], str]] = {
    "a column less": (lambda table: table.drop_columns("frame"), "columns sweep, to_first"),
    "a column more": (lambda table: table.append_column("x", table["frame"]), "and no other"),
    "another type": (_column("frame", pa.int64()), "frame: is int64: give int32"),
    "another length": (_column("to_first", pa.list_(pa.float64())), "to_first: is list"),
    "null": (_null, "sweep: null in some row"),
    "a frame twice": (lambda t: pa.concat_tables([t, t.slice(0, 1)]), "frame: numbers from 0"),
    "a frame less": (lambda table: table.slice(1), "frame: numbers from 0"),
    "no split": (_metadata(split=None), "split: missing"),
    "another schema": (_metadata(schema="x"), "schema: 'x'"),
    "an unknown text": (_metadata(more="x"), "metadata racines.more: unknown"),
    "nothing": (lambda table: table.slice(0, 0), "holds no sweep"),
}


@pytest.mark.parametrize("wrong", WRONG_TABLES)
def test_a_wrong_column_is_named(made, tmp_path: Path, wrong: str):
    path = tmp_path / "mine.parquet"
    write_submission(path, made)
    change, told = WRONG_TABLES[wrong]
    pq.write_table(change(pq.read_table(path)), path)
    with pytest.raises(RacinesError, match=told):
        read_submission(path)


@pytest.mark.parametrize("ending", [".npz", ".parquet"])
def test_what_is_no_such_file_is_refused(tmp_path: Path, ending: str):
    path = tmp_path / f"mine{ending}"
    with pytest.raises(RacinesError, match="no such file"):
        read_submission(path)
    for content in (b"", b"PK\x03\x04 and no more", b"PAR1 nothing PAR1"):
        path.write_bytes(content)
        with pytest.raises(RacinesError, match="not readable as"):
            read_submission(path)


def test_pickled_code_is_never_run(made, tmp_path: Path):
    path = tmp_path / "mine.npz"
    np.savez(path, schema=np.array(SCHEMA), name=np.array([{"a": 1}], dtype=object))
    with pytest.raises(RacinesError, match="not readable as NPZ"):
        read_submission(path)


def test_it_is_of_this_dataset_and_of_all_its_sweeps(made, sweeps):
    asked = sweeps.sweeps("test")
    digest = sweeps.store.digest

    def check(told: str, of: Submission, **other: str) -> None:
        given = {"dataset": digest, "split": "test"} | other
        with pytest.raises(RacinesError, match=told):
            of.check("a.npz", asked, **given)

    check("dataset: made for", made, dataset="another")
    check("split: made for 'test', not 'train'", made, split="train")
    first, *others = made.motions
    less = {key: made.motions[key] for key in others}
    check(f"sweep {first}: missing", Submission("mine", digest, "test", less))
    more = dict(made.motions) | {"unknown": made.motions[first]}
    check("sweep 'unknown': none of split", Submission("mine", digest, "test", more))
    short = Motion(*(each[:-1] for each in made.motions[first]))
    cut = dict(made.motions) | {first: short}
    check("7 frames, the sweep has 8", Submission("mine", digest, "test", cut))


def test_what_would_be_refused_is_not_written(made, tmp_path: Path):
    path = tmp_path / "mine.txt"
    with pytest.raises(RacinesError, match=r"end the name with \.npz or \.parquet"):
        write_submission(path, made)
    broken = Motion(*(each * 2 for each in next(iter(made.motions.values()))))
    with pytest.raises(RacinesError, match="to_first of frame 0"):
        write_submission(path, Submission("mine", "x", "test", {"a": broken}))
    assert not list(tmp_path.iterdir())
