"""The one reading of a device's name, for every `--device`, `Run` and config of the project."""

import os
from dataclasses import replace
from typing import Any, TypeVar

import torch

from racines_data.errors import RacinesError

C = TypeVar("C")


def resolve_device(device: torch.device | str) -> str:
    """Return the device that `auto` stands for (CUDA if there is one), or the one named, if there.

    Names are `auto`, `cpu`, `cuda` and `cuda:N`. Of several processes on a machine each has its own
    CUDA device, by its local rank.
    """
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    here = ["cpu", *(["cuda"] if count else []), *(f"cuda:{n}" for n in range(count))]
    device = str(device)
    if device == "auto":
        device = here[min(1, len(here) - 1)]
    if device not in here:
        raise RacinesError(f"device {device!r}: there is none here: use auto, {', '.join(here)}")
    if device == "cuda" and "LOCAL_RANK" in os.environ:
        return f"cuda:{os.environ['LOCAL_RANK']}"
    return device


def has_bfloat16(device: torch.device | str) -> bool:
    """Return whether a device has units for bfloat16; a CPU without them takes ten times float32's.

    Those are AVX512_BF16 (AMD since Zen 4) or AMX (Intel since Sapphire Rapids).
    """
    if torch.device(device).type == "cpu":
        return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return torch.cuda.is_bf16_supported()


def check_compiler(device: str, setting: str) -> None:
    """Refuse to compile for a CPU where PyTorch finds no C++ compiler, before anything is done.

    Sets the width of the CPU's vectors, which PyTorch finds out by itself but does not keep beside
    the code that it stores: a folder of it that is shared by machines, or used with and without
    `ATEN_CPU_CAPABILITY`, would give code of the wrong width, and wrong numbers (torch 2.13).

    Raises:
        RacinesError: there is none; it names the setting that asks for one.
    """
    from torch._inductor import config
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.cpu_vec_isa import pick_vec_isa
    from torch._inductor.exc import InvalidCxxCompiler

    try:
        if device == "cpu":
            get_cpp_compiler()
            if config.cpp.simdlen is None:
                config.cpp.simdlen = pick_vec_isa().bit_width()
    except InvalidCxxCompiler as error:
        remedy = f"install one (g++), name it in CXX, or leave {setting} false"
        raise RacinesError(f"{setting}: no C++ compiler was found: {remedy}") from error


def on_device(config: C) -> C:
    """Return a config with what its `device` stands for; raises as `resolve_device`."""
    settings: Any = config
    return replace(settings, device=resolve_device(settings.device))
