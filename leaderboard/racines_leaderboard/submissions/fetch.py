"""Artefacts at a URL: fetched when asked for, bounded, and kept only if the digest is right."""

import time
import urllib.request
from collections.abc import Callable
from http.client import HTTPMessage
from pathlib import Path
from typing import IO, Any, BinaryIO

from racines_data.errors import RacinesError
from racines_leaderboard.submissions.file_checks import measure

SECONDS = 60
"""The longest that a server may be silent."""
WHOLE_SECONDS = 1800
"""The longest that it may take in all."""
Opener = Callable[[str], BinaryIO]


class _SameScheme(urllib.request.HTTPRedirectHandler):
    """Follows a redirection to https only: not to a file, nor in the clear."""

    def redirect_request(
        self, req: Any, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> Any:
        if not newurl.startswith("https://"):
            raise RacinesError(f"{req.full_url}: leads to {newurl[:200]!r}, which is not https")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def open_https(url: str) -> BinaryIO:
    """Open a URL; only https, redirections included."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler(),
        urllib.request.HTTPSHandler(),
        urllib.request.HTTPDefaultErrorHandler(),
        urllib.request.HTTPErrorProcessor(),
        urllib.request.UnknownHandler(),
        _SameScheme(),
    ):
        opener.add_handler(handler)
    return opener.open(url, timeout=SECONDS)


def fetch(artefact: dict[str, Any], out: Path, opener: Opener = open_https) -> tuple[str, int]:
    """Fetch an artefact into a file that does not exist yet; return its digest and size.

    Args:
        artefact: Its entry, with `url` and `size`.
        out: The file; removed again if the fetch fails.
        opener: What opens the URL.

    Raises:
        RacinesError: no answer, or more bytes than the entry says.
    """
    url, size = artefact["url"], artefact["size"]
    try:
        with opener(url) as stream, out.open("xb") as file:
            return measure(_Bounded(stream, size, url), url, file)
    except (OSError, ValueError) as error:
        out.unlink(missing_ok=True)
        raise RacinesError(f"{url}: cannot be fetched: {error}") from error
    except BaseException:
        out.unlink(missing_ok=True)
        raise


class _Bounded:
    """A stream that ends in an error once it gives more, or takes longer, than it may."""

    def __init__(self, stream: BinaryIO, size: int, url: str) -> None:
        self._stream, self._left, self._size, self._url = stream, size, size, url
        self._end = time.monotonic() + WHOLE_SECONDS

    def read(self, count: int) -> bytes:
        chunk = self._stream.read(min(count, self._left + 1))
        self._left -= len(chunk)
        if time.monotonic() > self._end:
            raise RacinesError(f"{self._url}: took more than {WHOLE_SECONDS} s: stopped")
        if self._left < 0:
            raise RacinesError(f"{self._url}: more than the {self._size:,} bytes of its entry")
        return chunk
