"""The boards' page, the demonstration's and the documentation as axe and a phone see them."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.leaderboard.studio.accessible import SIZES, check
from tests.leaderboard.studio.conftest import BROWSER_PATIENCE

pytest.importorskip("axe_playwright_python", reason="needs axe (extra dev)")
pytestmark = pytest.mark.docs
sizes = pytest.mark.parametrize("size", SIZES, ids=["desktop", "phone"])
night = pytest.param("dark", marks=pytest.mark.thorough)
schemes = pytest.mark.parametrize("scheme", ["light", night])
DOCUMENTS = ("index", "first-hour", "settings", "notebooks/data")
"""The home page, two tutorials, of which one is a notebook, and a page of the reference."""
Look = Callable[[Path, tuple[int, int], str], Any]


@pytest.fixture
def look(browser: Any) -> Iterator[Look]:
    """Open a page of a file."""
    contexts = []

    def opened(path: Path, size: tuple[int, int], scheme: str) -> Any:
        # Some pages' policies forbid to evaluate text, and so what axe and the tests ask in them.
        contexts.append(
            browser.new_context(
                viewport={"width": size[0], "height": size[1]},
                color_scheme=scheme,
                reduced_motion="reduce",
                bypass_csp=True,
            )
        )
        page = contexts[-1].new_page()
        page.set_default_timeout(BROWSER_PATIENCE)
        page.goto(path.as_uri())
        return page

    yield opened
    for context in contexts:
        context.close()


@schemes
@sizes
def test_the_boards(look: Look, size: tuple[int, int], scheme: str):
    page = look(ROOT / "docs" / "boards.html", size, scheme)
    check(page)
    page.locator(".board:visible tbody .name a").first.click()
    page.locator(".card:target").wait_for(state="visible")
    check(page)


@pytest.fixture(scope="module")
def demonstrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a search that was cut off."""
    from racines_envs.demo import episode, run

    out = tmp_path_factory.mktemp("demo") / "demo"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(episode, "POLICY", ROOT / "envs/weights/servo")
        run.demonstrate(episode.Draw(20_035, 0), episode.load_servo(), out, steps=3)
    return out / "index.html"


@sizes
def test_a_demonstration(look: Look, demonstrated: Path, size: tuple[int, int]):
    check(look(demonstrated, size, "dark"))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation, built."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "-q", "-d", str(folder)]
    subprocess.run(words, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, check=True)
    return folder


@pytest.mark.thorough
@schemes
@sizes
@pytest.mark.parametrize("document", DOCUMENTS)
def test_the_documentation(
    look: Look, site: Path, document: str, size: tuple[int, int], scheme: str
):
    check(look(site / f"{document}.html", size, scheme))
