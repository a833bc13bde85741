# pyright: strict
"""What hearts take of memory, and how much of it is left."""

import os
from pathlib import Path

import torch

from racines_data.errors import RacinesError
from racines_data.patients.volume import HEART_BYTES

MEMORY = 2_000_000_000
"""Bytes that a pool's voxels may take by default: 100 hearts."""
MEMINFO = Path("/proc/meminfo")
OWN_GROUP, GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
"""Which control group this process is in (Linux, version 2), and where their limits lie."""


class PoolTooLarge(RacinesError):
    """Hearts that fit neither what was allowed nor the machine."""


def check_memory(count: int, memory: int | None = MEMORY, free: int | None = None) -> None:
    """Refuse a pool that is empty or larger than memory, before anything is baked.

    Args:
        count: hearts of the pool.
        memory: bytes that it may take; None: as many as there are.
        free: bytes that there are; None: that is not known, or not asked.

    Raises:
        RacinesError: no hearts.
        PoolTooLarge: with the number of hearts that fit.
    """
    if not count:
        raise RacinesError("a pool needs patients: give at least one seed")
    whole, most = count * HEART_BYTES, [each for each in (memory, free) if each is not None]
    if whole <= min(most, default=whole):
        return
    fit, had = min(most) // HEART_BYTES, f"{min(most) / 1e9:.1f} GB"
    remedy = "take fewer patients, or fewer at a time by `chunk`"
    if min(most) == free:
        bound = f"{had} of memory are free"
        remedy = remedy if fit else "end other programs"
    else:
        bound, remedy = f"a pool may take {had}", f"{remedy}, or in Python raise `memory`"
    raise PoolTooLarge(f"{count} hearts take {whole / 1e9:.1f} GB and {bound}: {fit} fit; {remedy}")


def available_memory(device: torch.device | str = "cpu") -> int | None:
    """Return the bytes that may still be taken on a device; None where the system does not say.

    On Linux that is what can be had without swapping, caches of files included, and no more than
    the limit of a container leaves; elsewhere all that the machine has.
    """
    place = torch.device(device)
    if place.type == "cuda":
        return torch.cuda.mem_get_info(place)[0]
    told = [each for each in (_machines(MEMINFO), _groups(OWN_GROUP, GROUPS)) if each is not None]
    return min(told, default=None)


def _machines(path: Path) -> int | None:
    for line in _read(path).splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            return int(value.split()[0]) * 1024
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError, AttributeError):  # Windows has no such thing
        return None


def _groups(own: Path, root: Path) -> int | None:
    """Return what the limits of a process's group and those above leave; None without a limit."""
    names = [line[3:] for line in _read(own).splitlines() if line.startswith("0::")]
    group = root / "".join(names).strip("/")
    left: list[int] = []
    while group == root or root in group.parents:
        limit, used = (_read(group / f"memory.{name}").strip() for name in ("max", "current"))
        if limit.isdigit() and used.isdigit():
            counted = dict(line.split() for line in _read(group / "memory.stat").splitlines())
            # Cached files count as used, and give way to whoever needs the memory.
            left.append(max(0, int(limit) - int(used) + int(counted.get("inactive_file", 0))))
        group = group.parent
    return min(left, default=None)


def _read(path: Path) -> str:
    """Return what a file says, nothing if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
