"""Every tab of the Studio as axe and a phone see it; how long it takes until something is seen."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.leaderboard.studio.accessible import SIZES, check, settle
from tests.leaderboard.studio.conftest import open_tab

pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
pytest.importorskip("axe_playwright_python", reason="needs axe (extra dev)")
pytestmark = pytest.mark.docs
Visit = Callable[..., Any]
SHOWN = {
    "Patients": "#patients-films img",
    "Generators": "#generators-cards img",
    "Drive the probe": "#probe-image img",
    "Expert study": "#study-begin",
    "Dataset": "#data-figures img",
}
"""Tabs, and what is there once each shows something."""
PAINTED = 2000.0
"""Milliseconds from the request to the first words: what the Studio promises."""
QUICK = "Patients"
"""The tab that `.ci/run` asks; the others are asked each week."""
TABS = [pytest.param(tab, marks=[pytest.mark.thorough] * (tab != QUICK)) for tab in SHOWN]
sizes = pytest.mark.parametrize("size", SIZES, ids=["desktop", "phone"])


@sizes
def test_boards_and_where_a_result_comes_from(visit: Visit, size: tuple[int, int]):
    page = visit(*size)
    settle(page)
    check(page)
    page.locator("#boards-tables tr[data-name=mine] td").first.click()
    page.wait_for_selector("#boards-record dl")
    settle(page)
    check(page)


@sizes
@pytest.mark.parametrize("tab", TABS)
def test_a_tab(visit: Visit, tab: str, size: tuple[int, int]):
    page = visit(*size)
    open_tab(page, tab)
    page.wait_for_selector(SHOWN[tab])
    settle(page)
    check(page)


@pytest.mark.thorough
@sizes
def test_an_image_to_rate(visit: Visit, size: tuple[int, int]):
    page = visit(*size)
    open_tab(page, "Expert study")
    page.locator("#study-name :is(input, textarea)").fill(f"seen-{size[0]}")
    page.locator("#study-begin").click()
    page.wait_for_selector("#study-image img")
    settle(page)
    check(page)


@pytest.mark.thorough
@sizes
def test_an_agent_that_is_watched(visit: Visit, size: tuple[int, int]):
    page = visit(*size)
    open_tab(page, "Watch an agent")
    page.locator("#agent-watch").click()
    page.wait_for_selector("#agent-image img")
    settle(page)
    check(page)


@pytest.mark.thorough
def test_the_first_words_are_there_within_two_seconds(visit: Visit):
    """The quickest of three: on a machine with other work the clock tells of that as well."""
    painted = [
        visit().evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        for _ in range(3)
    ]
    assert min(painted) < PAINTED, painted
