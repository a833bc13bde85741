"""Weights as files that hold no code: saved, loaded, and handed out in half precision."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_atomic, write_json
from racines_models.provenance import sha256_bytes
from racines_models.training.checkpoint import repeat_folders

SMALL = 4_096
"""Tensors of at most so many entries stay as they are: normalisation and biases weigh nothing, and
half a unit in the last place of a position's mean is a tenth of a millimetre."""
LEVELS = 127
"""Greatest number of eight bits and a sign that is used."""
STEP = ".step"
"""Ends the name of what a tensor of such numbers is multiplied by, a number a row."""
LEFT_OUT = ("schema", "generator")
"""Keys of `metrics.json` that `config.json` has already."""


def publish(run: Path, out: Path, form: str = "float16") -> dict[str, Any]:
    """Write a smaller copy of a run: `config.json` and each `*.safetensors`.

    Large float32 tensors become float16, or eight bits a number with a step for each row (of the
    first dimension), half a step from what they were; the rest stays. `config.json` is the run's,
    with `weights_files` (dtype, and by file its bytes, its sha256, and that of the run's file that
    it was made of) and `training` (the run's metrics) added, and the `plots` that the metrics name
    beside it. It is written last, so that a folder which has one is whole. The run's further seeds
    are copied likewise, each into a folder of its name, and their files are named in it as well.

    Args:
        run: folder of a trained run.
        out: folder to write.
        form: `float16` or `int8`.

    Returns:
        The written `config.json`.

    Raises:
        RacinesError: no trained model in the folder, another form, or a weight that the form
            cannot hold.
    """
    run, out = Path(run), Path(out)
    if form not in FORMS:
        raise RacinesError(f"{form!r}: weights are published as {' or '.join(FORMS)}")
    files = sorted(run.glob("*.safetensors"))
    if not files or not (run / "config.json").is_file():
        raise RacinesError(f"{run}: no config.json with *.safetensors; train a model there first")
    if out.resolve() == run.resolve():
        raise RacinesError(f"{out}: is the run itself; name another folder")
    content = json.loads((run / "config.json").read_text(encoding="utf-8"))
    described = {}
    for file in files:
        data = save(_smaller(load_weights(file), file, form))
        write_atomic(out / file.name, data)
        hashes = {"sha256": sha256_bytes(data), "made_of": sha256_file(file)}
        described[file.name] = {"bytes": len(data), **hashes}
    content["weights_files"] = {"dtype": form, "files": described}
    for seed in repeat_folders(run):
        told = publish(seed, out / seed.name, form)["weights_files"]["files"]
        described |= {f"{seed.name}/{file}": each for file, each in told.items()}
    metrics = run / "metrics.json"
    if metrics.is_file():
        values = json.loads(metrics.read_text(encoding="utf-8"))
        content["training"] = {key: value for key, value in values.items() if key not in LEFT_OUT}
        for name in values.get("plots", ()):
            if (run / name).is_file():
                write_atomic(out / name, (run / name).read_bytes())
    write_json(out / "config.json", content)
    return content


def save_weights(path: Path, tensors: Mapping[str, Tensor]) -> str:
    """Write tensors as a safetensors file, whole or not at all; return its sha256."""
    data = save({key: each.detach().cpu().contiguous() for key, each in tensors.items()})
    write_atomic(path, data)
    return sha256_bytes(data)


def load_weights(
    path: Path, device: str = "cpu", remedy: str = "get it again"
) -> dict[str, Tensor]:
    """Read the tensors of a safetensors file, those that `publish` made smaller as float32.

    Raises:
        RacinesError: the file is absent, damaged, a pickle, or not the one that `config.json`
            beside it names; with the remedy.
    """
    if not path.is_file():
        raise RacinesError(f"{path}: no such file; {remedy}")
    config = path.parent / "config.json"
    if config.is_file():
        files = (
            json.loads(config.read_text(encoding="utf-8")).get("weights_files", {}).get("files", {})
        )
        wanted = files.get(path.name, {}).get("sha256")
        if wanted and sha256_file(path) != wanted:
            other = "is not the file that config.json names (sha256)"
            raise RacinesError(f"{path}: {other}; get it again")
    try:
        tensors = load_file(path, device=device)
    except (SafetensorError, OSError) as error:
        raise RacinesError(f"{path}: cannot be read as safetensors: {error}; {remedy}") from error
    half = (torch.float16, torch.bfloat16)
    narrow = [key for key, each in tensors.items() if each.dtype == torch.int8]
    steps = {key: tensors.pop(key + STEP) for key in narrow if key + STEP in tensors}
    wide = {key: each.float() if each.dtype in half else each for key, each in tensors.items()}
    return wide | {key: step * wide[key].float() for key, step in steps.items()}


def load_network(path: Path, network: nn.Module, remedy: str) -> None:
    """Read a network's state; raises as `load_weights`, and where shapes or names differ."""
    try:
        network.load_state_dict(load_weights(path, remedy=remedy))
    except RuntimeError as error:
        named = path.parent / "config.json"
        raise RacinesError(f"{path}: does not fit {named}: {error}; {remedy}") from error


def read_described(folder: Path, absent: str, schema: str | None = None) -> dict[str, Any]:
    """Return what the `config.json` beside the weights says; refuse none, and another schema."""
    path = Path(folder) / "config.json"
    if not path.is_file():
        raise RacinesError(f"{folder}: {absent}")
    try:
        described = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise RacinesError(f"{path}: not valid JSON: {error}; get it again") from error
    if schema is not None and (found := described.get("schema")) != schema:
        raise RacinesError(f"{path}: schema {found!r}, expected {schema!r}")
    return described


def _smaller(tensors: dict[str, Tensor], file: Path, form: str) -> dict[str, Tensor]:
    smaller = {}
    for key, tensor in tensors.items():
        parts = {"": tensor}
        if tensor.dtype == torch.float32 and tensor.numel() > SMALL:
            parts = FORMS[form](tensor)
            if not all(bool(part.isfinite().all()) for part in parts.values()):
                raise RacinesError(f"{file}: {key} is NaN or too large for {form}")
        smaller |= {key + name: part.contiguous() for name, part in parts.items()}
    return smaller


def _in_steps(tensor: Tensor) -> dict[str, Tensor]:
    """Return a tensor as eight bits a number, and what each row is to be multiplied by."""
    largest = tensor.flatten(1).abs().amax(1) if tensor.dim() > 1 else tensor.abs().amax()
    step = (largest / LEVELS).view(-1, *(1,) * max(tensor.dim() - 1, 0))
    units = (tensor / step.clamp_min(torch.finfo(torch.float32).tiny)).round()
    return {"": units.to(torch.int8), STEP: step}


FORMS = {"float16": lambda tensor: {"": tensor.half()}, "int8": _in_steps}
"""What a large tensor is published as, by the ends of names."""
