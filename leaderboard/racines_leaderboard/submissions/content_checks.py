"""What artefacts hold, looked at before anything is run: headers first, then a confined parse."""

import json
import math
from pathlib import Path
from typing import Any, NoReturn

from racines_data.errors import RacinesError
from racines_leaderboard.records.schema import read_json
from racines_leaderboard.submissions.confined.session import Limits, rehearse
from racines_leaderboard.submissions.file_checks import MAX_BYTES, read_bounded

MAX_UNPACKED = 2**30
MAX_ROWS = 1_000_000
MAX_GROUPS = 10_000
MAX_FOOTER = 8 * 2**20
MAX_HEADER = 10 * 2**20
MAX_JSON = 20 * 2**20
WIDTHS = {
    "BOOL": 1, "U8": 1, "I8": 1, "F8_E5M2": 1, "F8_E4M3": 1, "I16": 2, "U16": 2, "F16": 2,
    "BF16": 2, "I32": 4, "U32": 4, "F32": 4, "F64": 8, "I64": 8, "U64": 8,
}  # fmt: skip
"""Bytes of an element, by the names of safetensors."""


def check_content(path: Path, kind: str, track: str, limits: Limits | None = None) -> None:
    """Check that a file holds what its kind says, within bounds; nothing of it is run.

    Raises:
        RacinesError: another format, a claim or a content beyond the bounds, external data,
            operators beyond the standard, another interface, numbers that are not finite.
    """
    limit = MAX_JSON if path.suffix == ".json" else MAX_BYTES
    content = read_bounded(path.parent, path.name, str(path.parent), limit)
    if kind == "predictions":
        check_parquet(content, str(path))
        rehearse("parquet", content, str(path), limits)
    elif kind in ("generator", "policy"):
        rehearse("onnx", content, str(path), limits)
        _check_interface(path, kind)
    elif kind == "weights":
        check_safetensors(content, str(path))
    elif kind == "trace":
        from racines_envs.agents.trace_file import read_trace

        read_trace(path)
    elif kind == "scores":
        read_json(path, {"generators": "generator-scores", "agents": "agent-scores"}[track])


def _check_interface(path: Path, kind: str) -> None:
    from racines_envs.agents.onnx.format import read_policy
    from racines_models.exchange.onnx.format import read_onnx

    if kind == "generator":
        read_onnx(path)
    else:
        read_policy(path)


def check_parquet(content: bytes, where: str) -> None:
    """Check a Parquet file's marks, and by its footer how much it says that it holds.

    Raises:
        RacinesError: no Parquet file, or one that claims too much.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    footer = int.from_bytes(content[-8:-4], "little")
    if len(content) < 12 or content[:4] != b"PAR1" or content[-4:] != b"PAR1":
        raise RacinesError(f"{where}: not a Parquet file: write it again")
    if footer > min(MAX_FOOTER, len(content) - 12):
        raise RacinesError(f"{where}: a footer of {footer:,} bytes: at most {MAX_FOOTER:,}")
    try:
        told = pq.read_metadata(pa.BufferReader(content))
        groups = [told.row_group(i) for i in range(min(told.num_row_groups, MAX_GROUPS + 1))]
        columns = [group.column(i) for group in groups for i in range(group.num_columns)]
    except Exception as error:
        raise RacinesError(f"{where}: not readable as Parquet: {error}; write it again") from error
    unpacked = sum(column.total_uncompressed_size for column in columns)
    sizes = (*(column.total_uncompressed_size for column in columns), told.num_rows, 0)
    if told.num_rows > MAX_ROWS or unpacked > MAX_UNPACKED or min(sizes) < 0:
        raise RacinesError(
            f"{where}: claims {told.num_rows:,} rows, {unpacked:,} bytes unpacked: at most "
            f"{MAX_ROWS:,} and {MAX_UNPACKED:,}"
        )
    if told.num_row_groups > MAX_GROUPS:
        raise RacinesError(f"{where}: {told.num_row_groups:,} row groups: at most {MAX_GROUPS:,}")


def check_safetensors(content: bytes, where: str) -> None:
    """Check a safetensors file: its header, and that the tensors fill the rest byte for byte.

    Raises:
        RacinesError: no safetensors file, or a header that does not fit the file.
    """
    length = int.from_bytes(content[:8], "little")
    if content[8:9] != b"{" or not 2 <= length <= min(MAX_HEADER, len(content) - 8):
        raise RacinesError(f"{where}: not a safetensors file: its header is none of JSON")
    try:
        header = json.loads(
            content[8 : 8 + length].decode(), object_pairs_hook=_once, parse_constant=_refused
        )
    except (ValueError, RecursionError) as error:
        raise RacinesError(f"{where}: not a safetensors file: {error}") from error
    told = header.pop("__metadata__", {})
    if not isinstance(told, dict) or not all(isinstance(each, str) for each in told.values()):
        raise RacinesError(f"{where}: __metadata__: give text by name")
    at = 0
    for name, entry in sorted(header.items(), key=lambda item: _start(item[1])):
        begin, end = _span(entry, f"{where}: tensor {name[:80]!r}")
        if begin != at:
            raise RacinesError(f"{where}: tensor {name[:80]!r} begins at {begin}, not at {at}")
        at = end
    if 8 + length + at != len(content):
        raise RacinesError(
            f"{where}: claims {at:,} bytes of tensors, holds {len(content):,} in all"
        )


def _span(entry: Any, where: str) -> tuple[int, int]:
    """Return where a tensor begins and ends, if its type and shape need just so many bytes."""
    whole = isinstance(entry, dict) and set(entry) == {"dtype", "shape", "data_offsets"}
    if not whole or entry["dtype"] not in WIDTHS:
        raise RacinesError(f"{where}: give a known dtype, shape and data_offsets")
    shape, offsets = entry["shape"], entry["data_offsets"]
    for values in (shape, offsets):
        if not isinstance(values, list) or not all(type(v) is int and v >= 0 for v in values):
            raise RacinesError(f"{where}: shape and data_offsets are whole numbers")
    wanted = math.prod(shape) * WIDTHS[entry["dtype"]]
    if len(offsets) != 2 or offsets[1] - offsets[0] != wanted:
        raise RacinesError(f"{where}: claims {wanted:,} bytes, and has {offsets}")
    return offsets[0], offsets[1]


def _start(entry: Any) -> int:
    offsets = entry.get("data_offsets") if isinstance(entry, dict) else None
    first = offsets[0] if isinstance(offsets, list) and offsets else 0
    return first if type(first) is int else 0


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) != len(pairs):
        raise ValueError("a key stands twice")
    return dict(pairs)


def _refused(constant: str) -> NoReturn:
    raise ValueError(f"holds {constant}")
