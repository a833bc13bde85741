"""First looks at what comes from outside: the size of a file, and the name of a generator."""

import re
from pathlib import Path

from racines_data.errors import RacinesError

NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


def check_size(path: Path, most: int) -> None:
    """Refuse a file that is not there, or has more than so many bytes."""
    if not path.is_file():
        raise RacinesError(f"{path}: no such file")
    size = path.stat().st_size
    if size > most:
        raise RacinesError(f"{path}: {size:,} bytes: at most {most:,} are read")


def check_name(name: str, where: str) -> str:
    """Return a name if it can name a file and stand in a table; else refuse it, with `where`."""
    if not NAME.fullmatch(name):
        raise RacinesError(
            f"{where}: the name {name[:80]!r} is refused: 1 to 64 of a-z, 0-9, '.', '_' and '-', "
            "the first a letter or digit"
        )
    return name
