"""Rounds of fresh draws: a nonce that is committed to before it is used, and revealed afterwards.

    commit   256 bits of the system's randomness go to a private file; the board's `secrets.json`
             gets their SHA-256 and the date
    draw     every seed is HMAC-SHA-256 of the nonce and a purpose: without the nonce none is known,
             and a seed that is known tells nothing of another
    reveal   the nonce itself goes to `secrets.json`, where anybody can check it and draw the same

A board has one open round at most. Rounds are added and never changed, but for the reveal.
"""

import contextlib
import hashlib
import hmac
import json
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import locked, naming, write_json
from racines_leaderboard.records.names import made_up
from racines_leaderboard.records.schema import read_json
from racines_leaderboard.records.tracks import TRACKS

HISTORY = "secrets.json"
"""Beside a board's results."""
SCHEMA = "racines.secrets/1"
PRIVATE = "racines.nonce/1"
SIZE = 32
"""Bytes of a nonce."""
DISTINCT = 16
"""Fewest different bytes among them; 32 random ones have fewer once in 10^14 times."""
SMALL = 64
"""Bits that may not all be zero at either end: a number that was padded, not drawn."""
SEED_BITS = 62
"""Of a seed: some code counts on from it, within int64."""
MOST_BYTES = 2**20
"""Largest file of a secret that is read."""


@dataclass(frozen=True)
class Secret:
    """The nonce of one round of a board."""

    board: str
    round: int
    nonce: bytes

    def __repr__(self) -> str:  # a nonce in a log is no secret
        return f"Secret({self.board!r}, {self.round})"

    @property
    def commitment(self) -> str:
        """The SHA-256 of the nonce, hexadecimal."""
        return hashlib.sha256(self.nonce).hexdigest()

    def seed(self, purpose: str) -> int:
        """Return the non-negative 62-bit seed of a purpose, such as `poses`."""
        text = f"racines.secret/1\n{self.board}\n{self.round}\n{purpose}"
        digest = hmac.new(self.nonce, text.encode(), hashlib.sha256).digest()
        return int.from_bytes(digest) >> (8 * len(digest) - SEED_BITS)


def check_nonce(nonce: bytes, where: str) -> None:
    """Refuse what could be guessed: fewer than 256 bits, a padded number, a pattern.

    No check can tell a hash of a small number from chance; what draws a nonce is the system alone.
    """
    remedy = "draw one with racines board commit-secret"
    if len(nonce) != SIZE:
        raise RacinesError(
            f"{where}: nonce: {8 * len(nonce)} bits; {8 * SIZE} are wanted: {remedy}"
        )
    ends = int.from_bytes(nonce, "big"), int.from_bytes(nonce, "little")
    small = min(ends) >> (8 * SIZE - SMALL) == 0
    if small or len(set(nonce)) < DISTINCT or made_up(nonce.hex()):
        raise RacinesError(f"{where}: nonce: a small number or a pattern can be guessed: {remedy}")


def default_file(board: str, number: int) -> Path:
    """Return where the nonce of a round is kept: with the user's own data, outside any checkout."""
    own = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(own) / "racines" / "secrets" / f"{board}-round-{number}.json"


def read_history(results: Path, board: str) -> list[dict[str, Any]]:
    """Return the rounds of a board, the first one first; none where there is no file.

    Raises:
        RacinesError: a damaged file, rounds that are missing, open before the last or doubled, or a
            nonce that is not what was committed to.
    """
    path = results / board / HISTORY
    if not path.exists():
        return []
    document = read_json(path, "secrets")
    if document["board"] != board:
        raise RacinesError(f"{path}: board: {document['board']!r}, expected {board!r} by its place")
    rounds = document["rounds"]
    for i, each in enumerate(rounds):
        where = f"{path}: rounds.{i}"
        if each["round"] != i + 1:
            raise RacinesError(
                f"{where}.round: {each['round']}, expected {i + 1}: none is left out"
            )
        if each["commitment"] in [other["commitment"] for other in rounds[:i]]:
            raise RacinesError(f"{where}.commitment: stands there twice: a nonce serves one round")
        if (each["nonce"] is None) != (each["revealed"] is None):
            raise RacinesError(f"{where}: a nonce and the date of its reveal stand together")
        if each["nonce"] is None and i + 1 < len(rounds):
            raise RacinesError(f"{where}: not revealed, and round {i + 2} follows: reveal it first")
        if each["nonce"] is not None:
            nonce = bytes.fromhex(each["nonce"])
            check_nonce(nonce, where)
            if hashlib.sha256(nonce).hexdigest() != each["commitment"]:
                raise RacinesError(f"{where}.nonce: its SHA-256 is not the commitment")
            if each["revealed"] < each["committed"]:
                raise RacinesError(f"{where}.revealed: before it was committed to")
    return rounds


def round_of(results: Path, secret: Secret) -> dict[str, Any]:
    """Return the entry of a secret's round in its board's history.

    Raises:
        RacinesError: the board has not committed to this nonce for this round.
    """
    rounds = read_history(results, secret.board)
    found = [each for each in rounds if each["round"] == secret.round]
    if not found or found[0]["commitment"] != secret.commitment:
        path = results / secret.board / HISTORY
        raise RacinesError(
            f"{path}: round {secret.round}: no commitment to this nonce: draw with one that was "
            "committed to before (racines board commit-secret)"
        )
    return found[0]


def commit(results: Path, board: str, nonce: bytes, today: str, out: Path | None = None) -> Path:
    """Begin a round: write the nonce to a private file, and its commitment to the board's history.

    Args:
        results: Folder of the boards.
        board: One that holds a result.
        nonce: 32 bytes of the system's randomness (`secrets.token_bytes`).
        today: The date, as 2026-01-31.
        out: The private file; by default `default_file`. Nothing that is there is replaced.

    Returns:
        The private file, which its owner alone may read.

    Raises:
        RacinesError: an unknown board, a round that is open, a nonce that can be guessed or served
            before, or a file in the results or a git checkout, where it would be published.
    """
    records = (path for track in TRACKS for path in (results / board / track.name).glob("*.json"))
    if next(records, None) is None:
        raise RacinesError(f"{results}: no results of {board}: collect some first")
    with locked(results):
        rounds = read_history(results, board)
        path = results / board / HISTORY
        if rounds and rounds[-1]["nonce"] is None:
            raise RacinesError(
                f"{path}: round {len(rounds)} is open: reveal it first (racines board reveal)"
            )
        secret = Secret(board, len(rounds) + 1, nonce)
        check_nonce(nonce, f"{path}: round {secret.round}")
        entry = {"round": secret.round, "commitment": secret.commitment, "committed": today}
        if secret.commitment in [each["commitment"] for each in rounds]:
            raise RacinesError(f"{path}: this nonce served a round before: draw another")
        private = out or default_file(board, secret.round)
        _write_private(private, secret, results)
        try:
            _write_history(path, board, [*rounds, entry | {"nonce": None, "revealed": None}])
        except BaseException:
            private.unlink()
            raise
    return private


def reveal(results: Path, secret: Secret, today: str) -> Path:
    """End the open round of a board: write its nonce to the history; return that file.

    Raises:
        RacinesError: no round is open, it was committed to another nonce, or later than today.
    """
    with locked(results):
        path = results / secret.board / HISTORY
        rounds = read_history(results, secret.board)
        if not rounds or rounds[-1]["nonce"] is not None:
            raise RacinesError(f"{path}: no round is open: there is nothing to reveal")
        if round_of(results, secret) is not None and secret.round != len(rounds):
            raise RacinesError(f"{path}: round {secret.round} was revealed before")
        if today < (committed := rounds[-1]["committed"]):
            raise RacinesError(
                f"{path}: today is {today}, and round {len(rounds)} was committed to on "
                f"{committed}: set the clock right, or wait"
            )
        told = {"nonce": secret.nonce.hex(), "revealed": today}
        _write_history(path, secret.board, [*rounds[:-1], rounds[-1] | told])
        read_history(results, secret.board)
    return path


def read_secret(path: Path, results: Path, board: str) -> Secret:
    """Read a private file, or a board's `secrets.json`: the last round of it that was revealed.

    What a file holds is never part of an error's text.

    Raises:
        RacinesError: no such file, one that others may read, one of another board, or no nonce.
    """
    try:
        with path.open("rb") as file:
            mode, content = os.fstat(file.fileno()).st_mode, file.read(MOST_BYTES)
    except FileNotFoundError as error:
        raise RacinesError(f"{path}: no such file: name the one of commit-secret") from error
    told: Any = None
    with contextlib.suppress(ValueError, RecursionError):
        told = json.loads(content)
    if isinstance(told, dict) and told.get("schema") == SCHEMA:
        known = [each for each in read_history(results, board) if each["nonce"] is not None]
        if not known or path.resolve() != (results / board / HISTORY).resolve():
            raise RacinesError(f"{path}: no revealed round of board {board}")
        return Secret(board, known[-1]["round"], bytes.fromhex(known[-1]["nonce"]))
    if not isinstance(told, dict) or told.get("schema") != PRIVATE:
        raise RacinesError(f"{path}: not a file of racines board commit-secret")
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise RacinesError(f"{path}: others may read it: chmod 600, and begin another round")
    number, nonce = told.get("round"), told.get("nonce")
    if told.get("board") != board:
        raise RacinesError(f"{path}: board: of another board than {board}")
    if not isinstance(number, int) or isinstance(number, bool) or number < 1:
        raise RacinesError(f"{path}: round: a number from 1 is wanted")
    if not isinstance(nonce, str) or not re.fullmatch(r"(?:[0-9a-f]{2})*", nonce):
        raise RacinesError(f"{path}: nonce: {2 * SIZE} hexadecimal digits are wanted")
    check_nonce(bytes.fromhex(nonce), str(path))
    return Secret(board, number, bytes.fromhex(nonce))


def _write_history(path: Path, board: str, rounds: list[dict[str, Any]]) -> None:
    write_json(path, {"schema": SCHEMA, "board": board, "rounds": rounds})


def _write_private(path: Path, secret: Secret, results: Path) -> None:
    """Write a nonce to a new file of mode 600, in a folder of mode 700 where that is made."""
    place = path.expanduser().resolve()
    parents = place.parents
    if results.resolve() in parents or any((each / ".git").exists() for each in parents):
        raise RacinesError(f"{path}: in the results or a git checkout, which are published: "
                           "give --out elsewhere")  # fmt: skip
    place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    told = {"schema": PRIVATE, "board": secret.board, "round": secret.round}
    text = json.dumps(told | {"nonce": secret.nonce.hex()}, indent=2) + "\n"
    try:
        with naming(path):
            handle = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "w") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
    except FileExistsError as error:
        raise RacinesError(
            f"{path}: is there: no secret is replaced; give another --out"
        ) from error
