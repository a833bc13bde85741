"""Whom the Studio answers, and what it tells a browser of its pages."""

import asyncio
import re
import socket
from typing import Any

import pytest

pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
import httpx  # noqa: E402

from racines_leaderboard.studio.guard import MOST, Bounded, middleware, script_hashes  # noqa: E402
from tests.leaderboard.studio.conftest import BROWSER_PATIENCE  # noqa: E402

WRITE_IN = """([markup, script]) => {
    const box = document.createElement("div"), run = document.createElement("script");
    box.innerHTML = markup; run.textContent = script; document.body.append(box, run);
}"""


def host_of(served: str) -> str:
    return served.removeprefix("http://")


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "evil.example:7860", "127.0.0.1.evil.example", "localhost.evil.example",
        "evil.example#localhost", "localhost@evil.example", "", "[::1", "169.254.169.254", "*",
    ],
)  # fmt: skip
def test_a_name_that_points_here_is_refused(served: str, host: str):
    """DNS rebinding: the browser sends the attacker's name."""
    for path in ("/", "/config", "/gradio_api/info", "/gradio_api/queue/data?session_hash=x"):
        assert httpx.get(served + path, headers={"Host": host}).status_code == 400


def test_names_of_this_machine_are_answered(served: str):
    port = served.rsplit(":", 1)[1]
    for name in ("localhost", "127.0.0.1", "LOCALHOST", "[::1]"):
        assert httpx.get(served, headers={"Host": f"{name}:{port}"}).status_code == 200


@pytest.mark.parametrize(
    "origin",
    [
        "https://evil.example", "http://localhost:3000", "http://127.0.0.1", "null", "file://",
        "http://127.0.0.1.evil.example", "http://[", "javascript://localhost",
    ],
)  # fmt: skip
def test_what_another_sites_page_sends_is_refused(served: str, origin: str):
    body = {"data": [], "fn_index": 0, "session_hash": "x"}
    for path in ("/gradio_api/queue/join", "/gradio_api/run/boards_show"):
        told = httpx.post(served + path, json=body, headers={"Origin": origin})
        assert told.status_code == 403 and told.text == "Not from another site's page.\n"


def test_two_origins_are_no_way_past(served: str):
    sent = [("Origin", served), ("Origin", "https://evil.example")]
    assert httpx.get(f"{served}/config", headers=sent).status_code == 403
    assert httpx.get(f"{served}/config", headers={"Origin": served}).status_code == 200


def test_names_that_were_given_are_answered_alone():
    """The Studio behind a proxy that speaks TLS, and one on a host's platform."""
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.responses import PlainTextResponse
    from starlette.routing import Route
    from starlette.testclient import TestClient

    layers = middleware("0.0.0.0", ["studio.example.org", "*.hf.space"], ["https://hf.example"])
    routes = [Route("/", lambda _: PlainTextResponse("here"), methods=["GET", "POST"])]
    app = Starlette(routes=routes, middleware=[Middleware(c, *a, **k) for c, a, k in layers])
    client = TestClient(app)
    for host, code in (
        ("studio.example.org", 200), ("me-it.hf.space", 200), ("0.0.0.0", 400),
        ("www.studio.example.org", 400), ("hf.space.evil.example", 400), ("localhost", 200),
    ):  # fmt: skip
        assert client.get("/", headers={"Host": host}).status_code == code, host
    proxied = {"Host": "127.0.0.1:7860", "Origin": "https://studio.example.org"}
    assert client.post("/", headers=proxied).status_code == 200
    proxied["Origin"] = "https://evil.example"
    told = client.post("/", headers=proxied)
    assert told.status_code == 403, "a refusal has the headers too"
    assert "frame-ancestors https://hf.example;" in f"{told.headers['content-security-policy']};"
    assert "x-frame-options" not in told.headers


def test_every_answer_says_what_a_browser_may_do(served: str):
    for path in ("/", "/config", "/nothing", "/theme.css", "/gradio_api/info"):
        told = httpx.get(served + path).headers
        policy = dict(p.strip().split(" ", 1) for p in told["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'" and policy["frame-ancestors"] == "'none'"
        assert "'unsafe-inline'" not in policy["script-src"] and "*" not in str(policy)
        assert told["x-content-type-options"] == "nosniff"
        assert told["referrer-policy"] == "no-referrer" and told["x-frame-options"] == "DENY"


def test_a_page_names_its_own_scripts_and_no_other(served: str):
    for encoding in ("identity", "gzip", "br"):
        told = httpx.get(served, headers={"Accept": "text/html", "Accept-Encoding": encoding})
        named = re.findall(r"'sha256-[^']+'", told.headers["content-security-policy"])
        assert len(named) >= 3 and named == script_hashes(told.content)
    assert not script_hashes(b'<script src="x.js"></script><p>')
    assert script_hashes(b"<script>a</script><script>a</script>") == script_hashes(
        b"<p onclick=b><SCRIPT>a</SCRIPT>"
    )


@pytest.mark.parametrize("size", [MOST + 1, 2**40])
def test_a_long_request_is_refused_before_it_is_read(served: str, size: int):
    name, port = host_of(served).split(":")
    with socket.create_connection((name, int(port))) as wire:
        head = f"POST /gradio_api/queue/join HTTP/1.1\r\nHost: {name}:{port}\r\n"
        wire.sendall(
            f"{head}Content-Type: application/json\r\nContent-Length: {size}\r\n\r\n".encode()
        )
        assert b" 413 " in wire.recv(4096)


def test_a_long_request_that_does_not_say_so_is_cut_off():
    pieces = iter([{"type": "http.request", "body": b"x" * 2**18, "more_body": True}] * 10)
    seen: list[Any] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        while (message := await receive())["type"] == "http.request":
            seen.append(len(message["body"]))

    async def receive() -> Any:
        return next(pieces)

    asyncio.run(Bounded(app)({"type": "http", "headers": []}, receive, app))  # type: ignore
    assert sum(seen) <= MOST


def test_a_handler_that_got_into_a_page_does_not_run(served: str, browser: Any):
    """Even if an escape were forgotten: the policy keeps what is written in a page from running."""
    page, refused = browser.new_page(), []
    page.on("console", lambda told: refused.append(told.text) if told.type == "error" else None)
    page.goto(served)
    page.wait_for_selector("#boards-charts img", timeout=BROWSER_PATIENCE)
    assert not refused
    page.evaluate(WRITE_IN, ["<p id='trap' onclick='window.pwned = 1'>x</p>", "window.pwned = 1"])
    page.evaluate("document.getElementById('trap').click()")
    assert page.evaluate("window.pwned") is None
    assert len([told for told in refused if "Content Security Policy" in told]) >= 2
    page.close()
