"""Predictions files: what is written, and what is refused of a stranger's file."""

import dataclasses
import io
import struct
import zlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.records import encode_png
from racines_data.schema import PARAMETERS
from racines_models.exchange.predictions import file as predictions_file
from racines_models.exchange.predictions.file import (
    Predictions,
    Task,
    decode_gray,
    write_poses,
    write_predictions,
)
from racines_models.registry import open_generator
from racines_models.sample import draw, take_sample
from tests.models.labelled import LabelledStore

COUNT = 70
"""More than one batch of the reader."""


class Noisy:
    """Noise of the sample's seed over a gray that follows the pose."""

    def __init__(self):
        self.seen = []

    def generate(self, parameters, seed):
        self.seen.append(seed.clone())
        noise = torch.stack([torch.randint(0, 90, (128, 128), generator=_at(int(s))) for s in seed])
        return (noise + 100 + (parameters[:, 6] * 50).long()[:, None, None]).to(torch.uint8)


def _at(seed):
    return torch.Generator().manual_seed(seed % 2**62)


@pytest.fixture(scope="module")
def task():
    store = LabelledStore(trajectories=20, length=12)
    return Task(store, take_sample(store, "test", COUNT), "test", (0, 4))


@pytest.fixture(scope="module")
def written(task, tmp_path_factory):
    path = tmp_path_factory.mktemp("predictions") / "noisy.parquet"
    assert write_predictions(path, task, Noisy(), "noisy", "a test") == 2 * COUNT
    return path


@pytest.fixture
def edited(written, tmp_path):
    """Write the file again, with its table changed by a function, and return its path."""

    def edit(change=lambda table: table, metadata=None):
        table = pq.read_table(written)
        table = change(table).replace_schema_metadata(table.schema.metadata | (metadata or {}))
        path = tmp_path / "edited.parquet"
        pq.write_table(table, path)
        return path

    return edit


def images_of(path, task, seed=0):
    return Predictions(path, task.store, "test").draw_frames(task.sample.frames, seed)


def refusal(path, task, seed=0, **made_for):
    with pytest.raises(RacinesError) as caught:
        images_of(path, task, seed) if not made_for else Predictions(path, **made_for)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_file_draws_what_its_generator_drew(task, written):
    for seed in task.seeds:
        direct = draw(Noisy(), task.sample.frames, seed)
        opened = open_generator(str(written), store=task.store, split="test")
        assert torch.equal(draw(opened, task.sample.frames, seed), direct)
    assert not torch.equal(images_of(written, task, 0), images_of(written, task, 4))
    predictions = Predictions(written, task.store)
    assert predictions.name == "noisy" and predictions.metadata["text"] == "a test"
    assert not hasattr(predictions, "generate")


def test_order_of_rows_and_row_groups_do_not_matter(task, written, edited):
    order = np.random.default_rng(0).permutation(2 * COUNT)
    path = edited(lambda table: table.take(order))
    assert torch.equal(images_of(path, task), images_of(written, task))


def test_two_writings_are_equal_and_leave_nothing_else(task, written, tmp_path):
    write_predictions(tmp_path / "again.parquet", task, Noisy(), "noisy", "a test")
    assert (tmp_path / "again.parquet").read_bytes() == written.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["again.parquet"]


def test_poses_say_all_that_a_program_outside_needs(task, tmp_path):
    path, generator = tmp_path / "poses.parquet", Noisy()
    assert write_poses(path, task) == 2 * COUNT
    table = pq.read_table(path)
    assert table.column_names == ["sample", "seed", "noise_seed", *PARAMETERS]
    frames = task.sample.frames
    told = np.stack([table[name][:COUNT].to_numpy() for name in PARAMETERS], 1)
    assert np.array_equal(told, frames.parameters.numpy())
    for seed in task.seeds:
        draw(generator, frames, seed)
    assert np.array_equal(table["noise_seed"].to_numpy(), torch.cat(generator.seen).numpy())
    metadata = table.schema.metadata
    assert metadata[b"racines.dataset"].decode() == task.store.manifest["digest"]
    assert metadata[b"racines.sample"].decode() == task.sample.digest


def test_poses_joined_with_images_are_a_predictions_file(task, written, tmp_path):
    """The road of a program outside: pyarrow and Pillow, nothing of ours."""
    write_poses(tmp_path / "poses.parquet", task)
    poses = pq.read_table(tmp_path / "poses.parquet")
    pngs = pa.array(pq.read_table(written)["image"].to_pylist(), pa.binary())
    table = poses.select(["sample", "seed"]).append_column("image", pngs)
    path = tmp_path / "mine.parquet"
    pq.write_table(table, path)
    assert "a poses file: set racines.schema" in refusal(path, task)
    named = {b"racines.schema": b"racines.predictions/1", b"racines.generator": b"mine"}
    pq.write_table(table.replace_schema_metadata(poses.schema.metadata | named), path)
    assert torch.equal(images_of(path, task), images_of(written, task))


def test_missing_extra_and_duplicate_samples_are_refused(task, edited):
    first = int(task.sample.frames.index[0])
    told = refusal(edited(lambda table: table.slice(1)), task)
    assert f"1 of {COUNT} samples of seed 0 are missing, the first {first}" in told
    told = refusal(edited(lambda table: pa.concat_tables([table, table.slice(3, 1)])), task)
    assert f"row {2 * COUNT}" in told and "stands in row 3 too" in told

    def other(table):
        samples = table["sample"].to_numpy().copy()
        samples[5] = 10**6
        return table.set_column(0, "sample", pa.array(samples))

    assert "row 5: sample 1000000, seed 0: none of the frames" in refusal(edited(other), task)
    assert "no rows of seed 9" in refusal(edited(), task, seed=9)


def test_other_dataset_split_and_sample_are_refused(task, written):
    other = LabelledStore(trajectories=20, length=12, seed=1)
    told = refusal(written, task, store=other)
    assert "labelled-0-240" in told and "labelled-1-240" in told and "export poses" in told
    told = refusal(written, task, store=task.store, split="validation")
    assert "made for split 'test', not 'validation'" in told
    fewer = take_sample(task.store, "test", COUNT - 1)
    with pytest.raises(RacinesError, match="another sample of frames.*give --samples"):
        Predictions(written, task.store).draw_frames(fewer.frames, 0)


def test_what_is_no_predictions_file_is_refused(task, written, edited, tmp_path, monkeypatch):
    path = tmp_path / "bad.parquet"
    assert "no such file" in refusal(path, task)
    path.write_bytes(b"PAR1" + bytes(50))
    assert "not readable as Parquet" in refusal(path, task)
    whole = written.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "not readable as Parquet" in refusal(path, task)
    damaged = bytearray(whole)
    damaged[2000:60000] = bytes(58000)
    path.write_bytes(damaged)
    assert "damaged behind row 0" in refusal(path, task) or "row 0" in refusal(path, task)
    monkeypatch.setattr("racines_models.exchange.predictions.file.MAX_BYTES", 1000)
    assert "at most 1,000 are read" in refusal(written, task)


def _column(name, values):
    def change(table):
        return table.set_column(table.column_names.index(name), name, values(table))

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(["seed"]), "columns sample, image: give sample, seed, image"),
        (lambda t: t.append_column("score", t["seed"]), "and no other"),
        (_column("sample", lambda t: t["sample"].cast("float64")), "sample is double: give int64"),
        (
            _column("image", lambda t: pa.array([[0.5]] * len(t))),
            ": give binary, the bytes of an 8-bit gray PNG",
        ),
        (
            _column("image", lambda t: pa.array([None, *t["image"][1:].to_pylist()], pa.binary())),
            "row 0: image is null",
        ),
        (
            _column("seed", lambda t: pa.array([*t["seed"][:-1].to_pylist(), None], pa.int64())),
            f"row {2 * COUNT - 1}: seed is null",
        ),
    ],
)
def test_wrong_columns_are_refused(task, edited, change, message):
    assert message in refusal(edited(change), task)


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({b"racines.generator": b"../../x"}, "the name '../../x' is refused"),
        ({b"racines.schema": b"racines.predictions/9"}, "not racines.predictions/1"),
        ({b"racines.colour": b"red"}, "racines.colour: unknown"),
        ({b"racines.text": b"x" * 10_001}, "over 10,000 bytes"),
        ({b"racines.text": b"\xff"}, "not UTF-8"),
    ],
)
def test_wrong_metadata_are_refused(task, edited, metadata, message):
    assert message in refusal(edited(metadata=metadata), task)


def test_metadata_lost_on_the_way_are_named(task, written, tmp_path):
    path = tmp_path / "plain.parquet"
    pq.write_table(pq.read_table(written).replace_schema_metadata(), path)
    assert "racines.dataset, racines.split, racines.sample" in refusal(path, task)


GRAY = np.random.default_rng(0).integers(0, 255, (128, 128), np.uint8)


def _png(image, **options) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", **options)
    return buffer.getvalue()


def _header(width, height, bits=8, color=0) -> bytes:
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    return struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


def _second_header() -> bytes:
    good = encode_png(GRAY)
    return good[:33] + _header(4_000, 4_000) + good[33:]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a PNG"),
        (b"GIF89a" + bytes(50), "not a PNG"),
        (encode_png(GRAY)[:200], "truncated PNG"),
        (encode_png(GRAY)[:-12], "truncated PNG"),
        (encode_png(GRAY)[:40] + b"xxxx" + encode_png(GRAY)[44:], "damaged PNG"),
        (encode_png(GRAY[:64]), "128 x 64 pixels: give 128 x 128"),
        (encode_png(GRAY)[:8] + _header(60_000, 60_000) + encode_png(GRAY)[33:], "60000 x 60000"),
        (_second_header(), "damaged PNG: it says"),
        (_png(Image.fromarray(np.stack([GRAY] * 3, -1))), "8-bit RGB: give 8-bit gray"),
        (_png(Image.fromarray(GRAY.astype(np.uint16) * 200)), "16-bit gray"),
        (_png(Image.fromarray(GRAY > 9)), "1-bit gray"),
        (_png(Image.fromarray(GRAY), compress_level=0) + bytes(2**16), "a PNG has at most 65,536"),
    ],
)
def test_bad_images_are_refused_by_row(task, edited, data, message):
    with pytest.raises(RacinesError, match=message):
        decode_gray(data, "here")
    pngs = _column(
        "image",
        lambda t: pa.array(
            [*t["image"][:7].to_pylist(), data] + t["image"][8:].to_pylist(), pa.binary()
        ),
    )
    told = refusal(edited(pngs), task)
    assert ", row 7, sample " in told and message in told


def test_scores_refuse_black_images(task, tmp_path):
    class Black:
        def generate(self, parameters, seed):
            return torch.zeros(len(parameters), 128, 128, dtype=torch.uint8)

    with pytest.raises(RacinesError, match="black"):
        write_predictions(tmp_path / "black.parquet", task, Black(), "black")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("level", "message"), [(0, "all black"), (90, "constant")])
def test_images_that_show_nothing_are_refused(task, edited, level, message):
    png = encode_png(np.full((128, 128), level, np.uint8))
    path = edited(_column("image", lambda t: pa.array([png] * len(t), pa.binary())))
    assert message in refusal(path, task)


def test_a_file_draws_no_pose_of_its_own(written):
    with pytest.raises(RacinesError, match="draws no other pose"):
        open_generator(str(written))


def test_a_file_that_unpacks_to_too_much_is_refused(task, edited, monkeypatch):
    """A few kilobytes of zeros: the size that the file declares is looked at, nothing is read."""
    values = [bytes([i]) + bytes(10**5) for i in range(2 * COUNT)]
    path = edited(_column("image", lambda t: pa.array(values, pa.binary())))
    assert path.stat().st_size < 10**6
    monkeypatch.setattr("racines_models.exchange.predictions.file.MAX_BYTES", 10**6)
    assert "bytes unpacked: at most" in refusal(path, task)


def test_one_huge_value_in_many_rows_is_not_multiplied(task, edited, tmp_path):
    """Parquet keeps equal values once: a kilobyte in the file, 1.3 GB in a batch of 64 rows."""
    indices, value = np.zeros(2 * COUNT, np.int32), pa.array([bytes(20_000_000)], pa.binary())
    images = pa.DictionaryArray.from_arrays(pa.array(indices), value)
    path, table = tmp_path / "bomb.parquet", pq.read_table(edited())
    # Without Arrow's own schema the column passes for plain binary.
    options = {"store_schema": False, "compression": "zstd"}
    bomb = _column("image", lambda t: images)(table)
    with pq.ParquetWriter(path, bomb.schema, **options) as writer:
        writer.write_table(bomb)
        writer.add_key_value_metadata(table.schema.metadata)
    assert path.stat().st_size < 10_000
    before = pa.default_memory_pool().max_memory()
    assert "20,000,000 bytes: a PNG has at most 65,536" in refusal(path, task)
    assert pa.default_memory_pool().max_memory() < before + 200_000_000


def test_memory_is_bounded_by_one_seed(task, tmp_path, monkeypatch):
    """Only a batch of rows is held beside the images that are asked for."""
    path, many = tmp_path / "many.parquet", dataclasses.replace(task, seeds=tuple(range(9)))
    write_predictions(path, many, Noisy(), "noisy")
    predictions = Predictions(path, task.store)
    sizes = []
    monkeypatch.setattr(
        "racines_models.exchange.predictions.file._png_of",
        lambda column, made=predictions_file._png_of: sizes.append(len(column)) or made(column),
    )
    predictions.draw_frames(task.sample.frames, 3)
    assert max(sizes) <= 64 and sum(sizes) == 9 * COUNT
