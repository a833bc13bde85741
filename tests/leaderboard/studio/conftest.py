"""A Studio over a tiny dataset, a board whose records were written by somebody hostile, a kit."""

import contextlib
import json
import shutil
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from racines_leaderboard.board.collect import collect
from racines_leaderboard.studio.parts import Place
from tests.leaderboard.conftest import agent_scores, generator_scores, write_submission
from tests.leaderboard.expert_kit import kit_of
from tests.waiting import PATIENCE

BROWSER_PATIENCE = 1e3 * PATIENCE
"""Milliseconds that a page waits for anything."""
HOSTILE = (
    "<script>window.pwned = 1</script><img src=x onerror='window.pwned = 1'>"
    "[here](javascript:window.pwned=1) ${window.pwned = 1} {{pwned}} `pwned`"
)


def write_json(path: Path, document: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document), encoding="utf-8")


@pytest.fixture(scope="session")
def place(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Everything that a Studio shows; tests add ratings and take nothing away."""
    root = tmp_path_factory.mktemp("studio")
    submissions, results = root / "submissions", root / "results"
    told = {"method": HOSTILE, "description": HOSTILE, "authors": [HOSTILE]}
    write_submission(submissions / "generators" / "mine", name="mine", **told)
    for document in (
        generator_scores("mine", ssim=0.9, ms_ssim=0.8),
        generator_scores("other", ssim=0.4, fid=300.0),
    ):
        write_json(root / "g" / f"{document['generator']}.json", document)
    for view, sees in (("SC", "image"), ("SC", "params"), ("PL", "image")):
        document = agent_scores(f"{view.lower()}-{sees}", view, observation=sees)
        write_json(root / "a" / f"{document['agent']}.json", document)
    collect([root / "g", root / "a"], results, submissions, "tiny")
    kit_of(root / "kits", images=12, repeats=3)
    missing = root / "missing"
    return Place(
        data=tiny_root, results=results, submissions=submissions, weights=missing, runs=missing,
        agents=missing, kits=root / "kits", max_sessions=64,
    )  # fmt: skip


@pytest.fixture(scope="session")
def served(place: Place) -> Iterator[str]:
    """The address of a running Studio."""
    pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
    from racines_leaderboard.studio.app import serve

    app = serve(place, port=free_port(), block=False)
    yield app.local_url.rstrip("/")
    with contextlib.redirect_stdout(None):
        app.close()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("needs Chromium; on Debian: apt install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright (extra dev)")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(
            executable_path=found, args=["--no-sandbox"], timeout=BROWSER_PATIENCE
        )
        yield browser
        browser.close()


@pytest.fixture
def visit(served: str, browser: Any) -> Iterator[Callable[..., Any]]:
    """Open the Studio as a visitor of its own; at the end nothing may have gone wrong there."""
    contexts, faults = [], []

    def opened(width: int = 1280, height: int = 900) -> Any:
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(BROWSER_PATIENCE)
        page.on("pageerror", lambda error: faults.append(f"error: {error}"))
        page.on("dialog", lambda dialog: faults.append(f"dialog: {dialog.message}"))
        page.on("console", lambda m: faults.append(m.text) if m.type == "error" else None)
        page.on("request", lambda r: None if _own(r.url, served) else faults.append(r.url))
        page.goto(served)
        page.wait_for_selector("#boards-charts img")
        return page

    yield opened
    for context in contexts:
        for page in context.pages:
            assert page.evaluate("window.pwned") is None
        context.close()
    assert not faults


def _own(url: str, served: str) -> bool:
    return url.startswith((served, "data:", "blob:"))


def open_tab(page: Any, title: str) -> None:
    """Click a tab, in the menu where the page is too narrow for all of them."""
    tab = page.get_by_role("tab", name=title, exact=True).first
    page.get_by_role("tab").first.wait_for(state="attached")
    if tab.count() and tab.is_visible():
        tab.click()
        return
    page.locator(".overflow-menu > button").first.click()
    page.locator(".overflow-dropdown button", has_text=title).first.click()
