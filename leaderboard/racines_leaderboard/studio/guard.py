"""What the Studio's server asks of a request, and what it tells the browser of a page.

A page of another site can make a visitor's browser send requests to this machine: by a name of its
own that suddenly means 127.0.0.1 (DNS rebinding), or outright. Both carry the other site's name, in
`Host` or in `Origin`, and are refused before anything of them is read.
"""

import base64
import hashlib
from collections.abc import Sequence
from html.parser import HTMLParser
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOCAL = ("localhost", "127.0.0.1", "::1", "[::1]")
"""Names of this machine for itself."""
MOST = 2**20
"""Bytes of a request, at most: no field of a page holds as much."""
EVERYWHERE = ("0.0.0.0", "::")
POLICY = {
    "default-src": "'none'",
    # Gradio's components make functions of their templates, so it needs 'unsafe-eval'. Scripts and
    # attributes within the page do not run, but for the page's own, which are named by their hash.
    "script-src": "'self' 'unsafe-eval'",
    "style-src": "'self' 'unsafe-inline'",
    "img-src": "'self' data: blob:",
    "font-src": "'self' data:",
    "connect-src": "'self'",
    "manifest-src": "'self'",
    "worker-src": "'self' blob:",
    "base-uri": "'self'",
    "form-action": "'none'",
    "object-src": "'none'",
}
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), payment=()",
}


def middleware(host: str, hosts: Sequence[str], framed_by: Sequence[str]) -> list[Any]:
    """Return what stands before the app, the outermost first, as Starlette takes it.

    Args:
        host: Address that the server listens at.
        hosts: Names under which it may be asked for, beside those of this machine and `host`;
            `*.example.org` for all below one.
        framed_by: Origins of pages that may show it in a frame.
    """
    given = [name.lower() for name in hosts]
    own = [*LOCAL, *([] if host in EVERYWHERE else [host.lower()])]
    return [
        (Headed, [], {"framed_by": framed_by}),
        (TrustedHostMiddleware, [], {"allowed_hosts": [*own, *given], "www_redirect": False}),
        # Not `own`: another server of this machine has its name too, at another port.
        (SameOrigin, [], {"hosts": given}),
        (Bounded, [], {}),
        (NoUploads, [], {}),
    ]


class Headed:
    """Adds the headers that tell a browser what a page may do."""

    def __init__(self, app: ASGIApp, framed_by: Sequence[str] = ()) -> None:
        self.app, self.framed_by = app, tuple(framed_by)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on, and head the answer; a page is held until its own scripts are known."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        started: list[Message] = []
        body = bytearray()

        async def headed(message: Message) -> None:
            if message["type"] == "http.response.start":
                page = Headers(raw=message["headers"]).get("content-type", "")
                if page.startswith("text/html"):
                    started.append(message)
                    return
                self._head(message, b"")
            elif started and message["type"] == "http.response.body":
                body.extend(message.get("body", b""))
                if message.get("more_body"):
                    return
                self._head(started[0], bytes(body))
                await send(started.pop())
                message = {"type": "http.response.body", "body": bytes(body)}
            await send(message)

        # A page that comes packed could not be read for its scripts.
        kept = [(k, v) for k, v in scope["headers"] if k != b"accept-encoding" or not _page(scope)]
        await self.app({**scope, "headers": kept}, receive, headed)

    def _head(self, message: Message, page: bytes) -> None:
        headers = MutableHeaders(scope=message)
        policy = POLICY | {"frame-ancestors": " ".join(self.framed_by) or "'none'"}
        policy["script-src"] = " ".join([policy["script-src"], *script_hashes(page)])
        headers["Content-Security-Policy"] = "; ".join(f"{k} {v}" for k, v in policy.items())
        if not self.framed_by:
            headers["X-Frame-Options"] = "DENY"
        for name, value in HEADERS.items():
            headers[name] = value


def _page(scope: Scope) -> bool:
    """Tell whether a browser asks for a page, and not for a part of one."""
    return "text/html" in Headers(raw=scope["headers"]).get("accept", "")


class _Scripts(HTMLParser):
    """Finds the text of the scripts that stand in a page."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=False)
        self.texts: list[str] = []
        self._open = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a script that has no address."""
        self._open = tag == "script" and "src" not in dict(attrs)
        if self._open:
            self.texts.append("")

    def handle_data(self, data: str) -> None:
        """Take in a piece of a script."""
        if self._open:
            self.texts[-1] += data

    def handle_endtag(self, tag: str) -> None:
        """End a script."""
        self._open = False


def script_hashes(page: bytes) -> list[str]:
    """Return the sources, for a policy, of the scripts in a page as the server made it."""
    parser = _Scripts()
    parser.feed(page.decode(errors="replace"))
    digests = (hashlib.sha256(text.encode()).digest() for text in parser.texts)
    return sorted({f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests})


class SameOrigin:
    """Refuses what a page of another site has a browser send."""

    def __init__(self, app: ASGIApp, hosts: Sequence[str] = ()) -> None:
        self.app, self.hosts = app, frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 403 where `Origin` is neither the `Host` nor a name that was given."""
        headers = Headers(raw=scope.get("headers", []))
        if scope["type"] in ("http", "websocket") and not self._ours(headers):
            refused = PlainTextResponse("Not from another site's page.\n", status_code=403)
            return await refused(scope, receive, send)
        await self.app(scope, receive, send)

    def _ours(self, headers: Headers) -> bool:
        origins = headers.getlist("origin")
        try:
            asked = [urlsplit(origin) for origin in origins]
            return all(
                each.scheme in ("http", "https")
                and (each.netloc == headers.get("host") or each.hostname in self.hosts)
                for each in asked
            )
        except ValueError:
            return False


class Bounded:
    """Refuses a request that is longer than any field of a page can make it."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 413 to what says that it is too long; cut off what is and does not say so."""
        length = Headers(raw=scope.get("headers", [])).get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST:
            refused = PlainTextResponse("Too long.\n", status_code=413)
            return await refused(scope, receive, send)
        taken = 0

        async def counted() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body") or b"")
            return {"type": "http.disconnect"} if taken > MOST else message

        await self.app(scope, counted, send)


class NoUploads:
    """Refuses uploads before a byte of them is read: no tab takes a file."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 403 to anything sent to an upload's address; hand on everything else."""
        upload = scope["type"] == "http" and scope["path"].rstrip("/").endswith("/upload")
        refused = PlainTextResponse("The Studio takes no files.\n", status_code=403)
        await (refused if upload else self.app)(scope, receive, send)
