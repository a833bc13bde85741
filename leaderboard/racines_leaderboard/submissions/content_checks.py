"""What artefacts hold, looked at before anything is run: headers first, then a confined parse."""

import json
from pathlib import Path
from typing import Any

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
    from racines_models.exchange.onnx.generator import read_onnx

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
        stated = pq.read_metadata(pa.BufferReader(content))
        groups = [stated.row_group(i) for i in range(min(stated.num_row_groups, MAX_GROUPS + 1))]
        columns = [group.column(i) for group in groups for i in range(group.num_columns)]
    except Exception as error:
        raise RacinesError(f"{where}: not readable as Parquet: {error}; write it again") from error
    unpacked = sum(column.total_uncompressed_size for column in columns)
    sizes = (*(column.total_uncompressed_size for column in columns), stated.num_rows, 0)
    if stated.num_rows > MAX_ROWS or unpacked > MAX_UNPACKED or min(sizes) < 0:
        raise RacinesError(
            f"{where}: claims {stated.num_rows:,} rows, {unpacked:,} bytes unpacked: at most "
            f"{MAX_ROWS:,} and {MAX_UNPACKED:,}"
        )
    if stated.num_row_groups > MAX_GROUPS:
        raise RacinesError(f"{where}: {stated.num_row_groups:,} row groups: at most {MAX_GROUPS:,}")


def check_safetensors(content: bytes, where: str) -> None:
    """Check a safetensors file: its header, and that the tensors fill the rest byte for byte.

    Raises:
        RacinesError: no safetensors file, or a header that does not fit the file.
    """
    from safetensors import SafetensorError, deserialize

    length = int.from_bytes(content[:8], "little")
    if length > MAX_HEADER:
        raise RacinesError(f"{where}: a header of {length:,} bytes: at most {MAX_HEADER:,}")
    try:
        deserialize(content)
        # Of two tensors of one name the library takes the last.
        json.loads(content[8 : 8 + length], object_pairs_hook=_once)
    except (SafetensorError, ValueError, RecursionError) as error:
        raise RacinesError(f"{where}: not a sound safetensors file: {error}") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) != len(pairs):
        raise ValueError("a key stands twice")
    return dict(pairs)
