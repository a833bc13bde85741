"""An ONNX file opened as what a stranger sent: bounded, in one piece, standard operators only."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_models.onnx_module import import_onnx

MAX_BYTES = 512 * 2**20
OLDEST = 11
"""Oldest operator set that is run."""
DOMAINS = ("", "ai.onnx", "ai.onnx.ml")
"""Operators of the standard; others would need code that the file does not hold."""


def read_model(path: Path) -> tuple[bytes, Any, int]:
    """Return a file's bytes, its `onnx.ModelProto` and its operator set; nothing is run.

    Raises:
        RacinesError: no ONNX file, too large, weights outside the file, operators beyond the
            standard, or a missing optional package.
    """
    import_onnx("onnx", "onnxruntime")
    import onnx

    content = _read(path)
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


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise RacinesError(f"{path}: no such file")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise RacinesError(f"{path}: {size:,} bytes: at most {MAX_BYTES:,} are read")
    try:
        return path.read_bytes()
    except OSError as error:
        raise RacinesError(f"{path}: cannot be read: {error}") from error


def _messages(message: Any) -> Iterator[Any]:
    """Yield a protobuf message and all those within it."""
    yield message
    for described, value in message.ListFields():
        if described.type == described.TYPE_MESSAGE:
            for part in [value] if hasattr(value, "ListFields") else value:
                yield from _messages(part)


def _check_inside(model: Any, path: Path) -> None:
    for part in _messages(model):
        if part.DESCRIPTOR.name == "TensorProto" and (
            part.external_data or part.data_location == part.EXTERNAL
        ):
            raise RacinesError(
                f"{path}: tensor {part.name!r} lies in another file: save the model as one file "
                "(onnx.save(model, path, save_as_external_data=False))"
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
