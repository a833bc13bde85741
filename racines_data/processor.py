"""The name and the flags of the processor, as the system tells them."""

import platform
from functools import cache
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")


@cache
def told(path: Path = CPUINFO) -> dict[str, str]:
    """Return what Linux says of the first core, by key; nothing on other systems."""
    found: dict[str, str] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        key, _, value = line.partition(":")
        found.setdefault(key.strip(), value.strip())
    return found


def processor() -> str:
    """Return the processor's name."""
    return told().get("model name") or platform.processor() or platform.machine()


def flags() -> frozenset[str]:
    """Return what the processor can do, by Linux's short names."""
    return frozenset((told().get("flags") or told().get("Features") or "").split())
