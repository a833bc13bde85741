"""Names of generators that come from outside, fit to name a file and to stand in a table."""

import re

from racines_data.errors import RacinesError

NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


def check_name(name: str, where: str) -> str:
    """Return a name if it can name a file.

    Raises:
        RacinesError: other than lower-case letters, digits, dots and dashes, or too long.
    """
    if not NAME.fullmatch(name):
        raise RacinesError(
            f"{where}: the name {name[:80]!r} is refused: 1 to 64 of a-z, 0-9, '.', '_' and '-', "
            "the first a letter or digit"
        )
    return name
