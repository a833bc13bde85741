"""Draw the golden frames of five patients on instruction sets, each in a fork of its own.

    python -m tests.instruction_sets.golden_frames FOLDER default avx2 avx512

A fork of a process that has imported all, and computed nothing, chooses its code anew. The first
bakes the hearts, and the others read them.
"""

import multiprocessing
import os
import sys
from pathlib import Path

import numpy as np
import torch

from racines_data.patients import Pool
from tests.data.patients import golden

ONEDNN = {"default": "SSE41", "avx2": "AVX2", "avx512": "AVX512_CORE"}


def draw(folder: Path, name: str) -> None:
    """Draw on an instruction set, and keep the name of the one that PyTorch took."""
    os.environ |= {"ATEN_CPU_CAPABILITY": name, "ONEDNN_MAX_CPU_ISA": ONEDNN[name]}
    every = torch.arange(len(golden.SEEDS))
    images, masks = golden.draw(Pool(golden.SEEDS, beating=True), every, every)
    took = torch.backends.cpu.get_cpu_capability().lower()
    np.savez(folder / f"{name}.npz", images=images, masks=masks, took=took)


def main(folder: Path, *names: str) -> None:
    """Draw on instruction sets, one after the other."""
    for name in names:
        process = multiprocessing.get_context("fork").Process(target=draw, args=(folder, name))
        process.start()
        process.join()
        assert process.exitcode == 0, name


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
