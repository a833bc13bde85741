"""The machine: processor, memory, CUDA, confinement. Torch stays unloaded: importing takes long."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from racines_data.processor import flags, processor

SETS = {"AVX512": "avx512f", "AVX2": "avx2"}
"""Instruction sets that torch tells apart, widest first, by their flag."""
CONFINE = "import os, runpy, sys; runpy.run_path(sys.argv[1])['confine'](); os.write(1, b'held')"
CAPABILITY = "ATEN_CPU_CAPABILITY"  # torch's own variable, which forbids wider sets


def machine() -> dict[str, Any]:
    """Return processor, instruction set, cores that this process may use, memory in bytes, CUDA."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "cpu": processor(),
        "instructions": instructions(flags()),
        "cores": cores,
        "memory": _memory(),
        "cuda": cuda(),
    }


def instructions(found: frozenset[str]) -> str:
    """Return the widest set of a processor's flags that torch may use."""
    wide = next((name for name, flag in SETS.items() if flag in found), "default")
    forced = os.environ.get(CAPABILITY)
    return f"{wide}, held to {forced} by {CAPABILITY}" if forced else wide


def _memory() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError, AttributeError):
        return None


def cuda(cards: Path = Path("/proc/driver/nvidia/gpus")) -> dict[str, Any]:
    """Return the CUDA that torch was built for, the cards of the driver, and what follows."""
    built, names = _built_for(), []
    for told in sorted(cards.glob("*/information")):
        match = re.search(r"^Model:\s*(.+)$", told.read_text(encoding="utf-8"), re.MULTILINE)
        names.append(match[1].strip() if match else "NVIDIA GPU")
    if not built:
        told = "none: this torch is built without CUDA"
    elif not names:
        told = f"none: torch is built for CUDA {built}, and no NVIDIA driver is here"
    else:
        told = f"{built}: {', '.join(names)}"
    return {"built": built, "cards": names, "usable": bool(built and names), "told": told}


def _built_for() -> str | None:
    """Return the CUDA that torch was built for, by its file; None without."""
    spec = find_spec("torch")
    places = spec.submodule_search_locations if spec else None
    path = Path(next(iter(places or ["."])), "version.py")
    told = path.read_text(encoding="utf-8") if path.is_file() else ""
    match = re.search(r"^cuda\b[^=\n]*=\s*['\"]([\d.]+)['\"]", told, re.MULTILINE)
    return match[1] if match else None


def confinement() -> dict[str, Any]:
    """Return whether others' files can be opened in a confined process, by trying it in a child."""
    from racines_leaderboard.submissions.confined import kernel

    try:
        done = subprocess.run(
            [sys.executable, "-I", "-S", "-c", CONFINE, str(kernel.__file__)],
            capture_output=True, timeout=10, text=True, cwd="/",
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError) as error:
        return {"available": False, "why": str(error)}
    held = done.stdout == "held"
    last = (done.stderr.strip().splitlines() or ["it did not hold"])[-1]
    return {"available": held, "why": None if held else last.rpartition("Error: ")[2]}
