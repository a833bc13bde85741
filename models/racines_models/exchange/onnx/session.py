"""How every ONNX file is run here: one thread, onnxruntime's deterministic mode. Without torch."""

from typing import Any

from racines_data.errors import RacinesError


def open_session(content: bytes, where: str, device: str) -> Any:
    """Return the onnxruntime session of a model: one thread, deterministic, on CUDA if it can.

    Raises:
        RacinesError: onnxruntime cannot load it; begins with `where`.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4
    providers = ["CPUExecutionProvider"]
    if device.startswith("cuda") and "CUDAExecutionProvider" in (
        onnxruntime.get_available_providers()
    ):
        providers.insert(0, "CUDAExecutionProvider")
    try:
        return onnxruntime.InferenceSession(content, options, providers=providers)
    except Exception as error:
        raise RacinesError(f"{where}: onnxruntime cannot load it: {error}") from error
