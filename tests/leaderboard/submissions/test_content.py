"""What artefacts hold: bombs, claims and links are refused before anything is run."""

import json
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from onnx import TensorProto, helper, load_model, numpy_helper
from safetensors.numpy import save

from racines_data.errors import RacinesError
from racines_leaderboard.submissions import intake as content_checks
from racines_leaderboard.submissions.confined.session import Limits
from racines_leaderboard.submissions.intake import check_content, check_safetensors
from racines_models.exchange.predictions.file import PREDICTION_COLUMNS
from tests.leaderboard.conftest import agent_scores, generator_scores
from tests.leaderboard.graphs import sound_generator, sound_policy

SMALL = Limits(memory=3 * 2**29)


def check(path, kind, track="generators"):
    check_content(path, kind, track, SMALL)


def predictions(path, images, **how):
    columns = [pa.array(range(len(images)), pa.int64()), pa.array([0] * len(images), pa.int64())]
    table = pa.table([*columns, pa.array(images, pa.binary())], schema=PREDICTION_COLUMNS)
    pq.write_table(table, path, **how)
    return path


def test_sound_files_of_every_kind_pass(tmp_path):
    check(sound_generator(tmp_path / "g.onnx"), "generator")
    check(sound_policy(tmp_path / "p.onnx"), "policy", "agents")
    check(predictions(tmp_path / "p.parquet", [b"png"] * 9), "predictions")
    (tmp_path / "w.safetensors").write_bytes(
        save({"a": np.zeros((3, 2), np.float32), "b": np.ones(5, np.uint8)}, {"x": "y"})
    )
    check(tmp_path / "w.safetensors", "weights")
    for scores, track in ((generator_scores("a"), "generators"), (agent_scores("a"), "agents")):
        (tmp_path / "s.json").write_text(json.dumps(scores))
        check(tmp_path / "s.json", "scores", track)


def test_a_policy_is_no_generator(tmp_path):
    with pytest.raises(RacinesError, match="inputs"):
        check(sound_policy(tmp_path / "g.onnx"), "generator")
    with pytest.raises(RacinesError, match="inputs"):
        check(sound_generator(tmp_path / "p.onnx"), "policy", "agents")


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
def test_scores_that_are_not_finite_are_refused(tmp_path, value):
    text = json.dumps(generator_scores("a")).replace("20.0", value)
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(RacinesError, match="s.json: holds"):
        check(tmp_path / "s.json", "scores")


def test_a_bomb_that_says_so_is_refused_by_its_footer(tmp_path, monkeypatch):
    monkeypatch.setattr(content_checks, "MAX_UNPACKED", 2**24)
    path = predictions(
        tmp_path / "b.parquet", [bytes(2**23)] * 3, compression="zstd", use_dictionary=False
    )
    assert path.stat().st_size < 2**14
    with pytest.raises(RacinesError, match=r"b.parquet: claims 3 rows, 25,1\d\d,\d+ bytes"):
        check(path, "predictions")


def test_a_bomb_that_lies_in_its_footer_dies_in_the_child(tmp_path):
    """128 MiB of zeros; the footer's sizes are made small, the page unpacks all the same."""
    path = predictions(
        tmp_path / "b.parquet", [bytes(2**27)], compression="zstd", use_dictionary=False
    )
    content = path.read_bytes()
    told = pq.read_metadata(path).row_group(0)
    for size in {told.column(2).total_uncompressed_size, told.total_byte_size}:
        honest = _varint(size * 2)
        assert content.count(honest) >= 1
        content = content.replace(honest, _varint(2 * 100, len(honest)))
    path.write_bytes(content)
    assert pq.read_metadata(path).row_group(0).column(2).total_uncompressed_size == 100
    tight = Limits(memory=2**29)
    check_content(predictions(tmp_path / "s.parquet", [b"png"]), "predictions", "generators", tight)
    with pytest.raises(RacinesError, match="b.parquet: .*memory limit"):
        check_content(path, "predictions", "generators", tight)


def _varint(value, length=0):
    """Return a number as Thrift's compact protocol has it, padded to a length."""
    parts = []
    while True:
        more = value >> 7 or len(parts) + 1 < length
        parts.append((value & 0x7F) | (0x80 if more else 0))
        value >>= 7
        if not more:
            return bytes(parts)


def test_ten_gigabytes_of_rows_are_refused_by_the_footer(tmp_path):
    schema = pa.schema([pa.field("sample", pa.int64(), False)])
    path = tmp_path / "r.parquet"
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        column = pa.array(np.zeros(600_000, np.int64))
        for _ in range(2):
            writer.write_table(pa.table([column], schema=schema))
    assert path.stat().st_size < 100_000
    with pytest.raises(RacinesError, match="claims 1,200,000 rows"):
        check(path, "predictions")


@pytest.mark.parametrize(
    "content",
    [
        b"PAR1",
        b"PAR1" + b"\xff" * 20 + b"PAR1",
        b"PAR1" + bytes(8) + struct.pack("<I", 2**31) + b"PAR1",
        b"PAR1" + bytes(8) + struct.pack("<I", 4) + b"PAR1",
        b"PK\x03\x04" + bytes(40),
    ],
)
def test_what_is_no_parquet_is_refused(tmp_path, content):
    (tmp_path / "x.parquet").write_bytes(content)
    with pytest.raises(RacinesError, match="x.parquet: (not|a footer)"):
        check(tmp_path / "x.parquet", "predictions")


def spoiled(tmp_path, change):
    path = sound_generator(tmp_path / "g.onnx")
    model = load_model(path)
    change(model)
    path.write_bytes(model.SerializeToString())
    return path


def external(model):
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../../../etc/passwd")


def claims(model):
    tensor = model.graph.initializer[0]
    del tensor.dims[:]
    tensor.dims.extend([2**31, 2**31])


def sparse_claims(model):
    one = numpy_helper.from_array(np.ones(1, np.float32), "s")
    place = numpy_helper.from_array(np.zeros(1, np.int64), "i")
    model.graph.sparse_initializer.append(helper.make_sparse_tensor(one, place, [10 * 2**40]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (external, "lies in another file|passwd"),
        (claims, "claims .* elements|refused"),
        (sparse_claims, "claims .* elements"),
        (lambda m: m.opset_import.append(helper.make_opsetid("com.stranger", 1)), "com.stranger"),
        (lambda m: m.functions.add(name="f", domain="own"), "functions|refused"),
        (lambda m: m.graph.node[0].ClearField("op_type"), "refused"),
    ],
)
def test_graphs_that_reach_out_or_claim_too_much_are_refused(tmp_path, change, message):
    path = spoiled(tmp_path, change)
    with pytest.raises(RacinesError, match=f"g.onnx: .*({message})"):
        check(path, "generator")


def test_a_parse_that_takes_too_much_memory_ends_in_the_child(tmp_path):
    """Ten million empty nodes: 20 MB of file, gigabytes once parsed."""
    graph = b"\x0a\x00" * 10_000_000
    head = b"\x08\x0a" + b"\x3a" + _varint(len(graph))
    (tmp_path / "n.onnx").write_bytes(head + graph)
    with pytest.raises(RacinesError, match="n.onnx: "):
        check_content(tmp_path / "n.onnx", "generator", "generators", Limits(memory=2**30))


def tensors(header, size=0):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + bytes(size)


def entry(shape, offsets, dtype="F32"):
    return {"dtype": dtype, "shape": shape, "data_offsets": offsets}


TWICE = b'{"a": %b, "a": %b}' % ((json.dumps(entry([2], [0, 8])).encode(),) * 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (struct.pack("<Q", 2**60) + b"{}", "header"),
        (struct.pack("<Q", 0) + b"{}", "header"),
        (b"", "header"),
        (tensors(b"{nonsense}"), "header"),
        (tensors(b'{"a":' * 5000), "header"),
        (
            tensors(b'{"a": %b, "a": %b}' % ((json.dumps(entry([2], [0, 8])).encode(),) * 2), 8),
            "twice",
        ),
        (tensors({"a": entry([2**40], [0, 2**42])}), "not fully covered"),
        (tensors({"a": entry([2**40, 2**40], [0, 8])}, 8), "overflow"),
        (tensors({"a": entry([3], [0, 8])}, 8), "invalid shape"),
        (tensors({"a": entry([-2], [0, 8])}, 8), "expected usize"),
        (tensors({"a": entry([2], [0, 8], "OBJECT")}, 8), "unknown variant"),
        (tensors({"a": entry([2], [4, 12])}, 12), "invalid offset"),
        (tensors({"a": entry([2], [0, 8]), "b": entry([2], [4, 12])}, 12), "invalid offset"),
        (tensors({"a": entry([2], [0, 8])}, 9), "not fully covered"),
        (tensors({"a": entry([2], [0, 8])}, 7), "not fully covered"),
        (tensors({"a": 1}), "header"),
        (tensors({"__metadata__": {"a": 1}}), "header"),
    ],
)
def test_safetensors_whose_header_lies_are_refused(content, message):
    with pytest.raises(RacinesError, match=f"w: .*{message}"):
        check_safetensors(content, "w")


def test_a_header_of_safetensors_is_bounded(monkeypatch):
    content = save({"a": np.zeros(2, np.float32)})
    check_safetensors(content, "w")
    monkeypatch.setattr(content_checks, "MAX_HEADER", 20)
    with pytest.raises(RacinesError, match="w: a header of .* at most 20"):
        check_safetensors(content, "w")
