"""An ONNX file opened as what a stranger sent: bounded, in one piece, standard operators only.

`open_session` runs it. Nothing here imports torch: a confined process has little memory.
"""

import json
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_models.exchange.naming import check_size

MAX_BYTES = 512 * 2**20
OLDEST = 11
"""Oldest operator set that is run."""
DOMAINS = ("", "ai.onnx", "ai.onnx.ml")
"""Operators of the standard; others would need code that the file does not hold."""
MAX_TEXT = 100_000
"""Most characters of one metadata value."""
TENSORS = ("TensorProto", "SparseTensorProto")
FLOAT, UINT8 = 1, 2
"""ONNX's element types."""


def import_onnx(*packages: str) -> None:
    """Refuse to go on without optional packages; says which extra brings them.

    onnxruntime tells its makers that it is used, unless told before its import: ten seconds after,
    from a thread of its own, which ends a process that may open no sockets.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    for name in packages:
        needed(name, "ONNX")


def open_session(content: bytes, where: str, device: str) -> Any:
    """Return the onnxruntime session of a model: one thread, deterministic, on CUDA if it can.

    What it cannot load is refused with a `RacinesError` that begins with `where`.
    """
    import_onnx("onnxruntime")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4
    wanted = ["CUDAExecutionProvider"] if device.startswith("cuda") else []
    providers = [each for each in wanted if each in onnxruntime.get_available_providers()]
    try:
        return onnxruntime.InferenceSession(content, options, [*providers, "CPUExecutionProvider"])
    except Exception as error:
        raise RacinesError(f"{where}: onnxruntime cannot load it: {error}") from error


def read_model(path: Path) -> tuple[bytes, Any, int]:
    """Return a file's bytes, its `onnx.ModelProto` and its operator set; nothing is run.

    Raises:
        RacinesError: no ONNX file, too large, weights outside the file, operators beyond the
            standard, or a missing optional package.
    """
    import_onnx("onnx", "onnxruntime")
    import onnx

    check_size(path, MAX_BYTES)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RacinesError(f"{path}: cannot be read: {error}") from error
    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:
        raise RacinesError(f"{path}: not an ONNX model: {error}; export it again") from error
    if not model.graph.output:
        raise RacinesError(f"{path}: not an ONNX model: it has no output; export it again")
    # Before anything else looks at the file: the checker and the runtime would follow the link.
    _check_inside(model, path)
    opset = _check_operators(model, path, onnx.defs.onnx_opset_version())
    try:
        onnx.checker.check_model(model)
    except Exception as error:
        raise RacinesError(f"{path}: not a valid ONNX model: {error}") from error
    return content, model, opset


def _messages(message: Any) -> Iterator[Any]:
    """Yield a protobuf message and all those within it."""
    yield message
    for described, value in message.ListFields():
        if described.type == described.TYPE_MESSAGE:
            for part in [value] if hasattr(value, "ListFields") else value:
                yield from _messages(part)


def _check_inside(model: Any, path: Path) -> None:
    for part in _messages(model):
        kind = part.DESCRIPTOR.name
        if kind == "TensorProto" and (part.external_data or part.data_location == part.EXTERNAL):
            raise RacinesError(
                f"{path}: tensor {part.name!r} lies in another file: save the model as one file "
                "(onnx.save(model, path, save_as_external_data=False))"
            )
        # Every element of a tensor takes a bit at least, and a file holds MAX_BYTES at most.
        dims = part.dims if kind in TENSORS else ()
        if min(dims, default=0) < 0 or math.prod(dims) > 8 * MAX_BYTES:
            raise RacinesError(
                f"{path}: a tensor claims {' x '.join(map(str, dims))} elements, more than the "
                f"{MAX_BYTES:,} bytes that are read can hold: export it again"
            )


def _check_operators(model: Any, path: Path, newest: int) -> int:
    foreign = {entry.domain for entry in model.opset_import} - set(DOMAINS)
    if foreign or model.functions:
        raise RacinesError(
            f"{path}: uses operators or functions of {', '.join(sorted(foreign)) or 'its own'}: "
            "export with standard ONNX operators, functions inlined"
        )
    opset = max((e.version for e in model.opset_import if e.domain in ("", "ai.onnx")), default=0)
    if not OLDEST <= opset <= newest:
        raise RacinesError(f"{path}: opset {opset}: export with one of {OLDEST} to {newest}")
    return opset


def declared_shape(value: Any) -> list[int | None]:
    """Return the declared sizes of an input or output; None where one is free."""
    dims = value.type.tensor_type.shape.dim
    return [dim.dim_value if dim.HasField("dim_value") else None for dim in dims] or [None]


def check_value(
    value: Any, path: Path, wanted: str, rest: tuple[int, ...], kinds: tuple[int, ...]
) -> int | None:
    """Return the fixed batch size of an input or output, None if it is free; refuse a wrong one.

    `rest` are the sizes needed after the batch, `kinds` the element types that are taken, `wanted`
    says so in the `RacinesError`.
    """
    shape = declared_shape(value)
    kind = value.type.tensor_type.elem_type
    # An output's sizes may be left open; they are checked again when it runs.
    fits = len(shape) == 1 + len(rest) and all(
        size in (None, needed) for size, needed in zip(shape[1:], rest, strict=True)
    )
    if kind not in kinds or not fits:
        shown = ", ".join("?" if size is None else str(size) for size in shape)
        given = f"{value.name} is ONNX type {kind}, shape ({shown})"
        raise RacinesError(f"{path}: {given}: give {wanted}")
    return shape[0]


def read_metadata(model: Any, path: Path, schema: str, keys: Sequence[str]) -> dict[str, str]:
    """Return the metadata whose keys begin with `racines.`, without that, if all are as allowed."""
    told: dict[str, str] = {}
    for entry in model.metadata_props:
        prefix, _, key = entry.key.partition(".")
        if prefix != "racines":
            continue
        where = f"{path}: metadata {entry.key}"
        if key not in keys:
            raise RacinesError(f"{where}: unknown; known: {', '.join(keys)}")
        if key in told or len(entry.value) > MAX_TEXT:
            raise RacinesError(f"{where}: stands twice or is too long")
        told[key] = entry.value
    if told.get("schema", schema) != schema:
        raise RacinesError(f"{path}: racines.schema is {told['schema'][:80]!r}, not {schema}")
    return told


def parsed(told: dict[str, str], key: str, kind: type, path: Path) -> Any:
    """Return a metadata value if it is JSON of a kind or null, None if it is absent."""
    where = f"{path}: metadata racines.{key}"
    try:
        value = json.loads(told.get(key, "null"))
    except (ValueError, RecursionError) as error:
        raise RacinesError(f"{where}: not valid JSON: {error}") from error
    if value is not None and type(value) is not kind:
        raise RacinesError(f"{where}: a {type(value).__name__} is no {key}")
    return value
