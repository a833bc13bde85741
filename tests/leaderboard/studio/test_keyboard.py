"""The Studio by keyboard alone: each tab reached, its main control used, the focus always seen."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.leaderboard.studio.accessible import settle

pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
pytestmark = pytest.mark.docs
Visit = Callable[..., Any]
MOST = 120
"""Times that Tab is pressed at most to come to an element."""
FOCUS = """([at, words]) => {
  const element = document.activeElement, drawn = getComputedStyle(element);
  const there = element.matches(at) && element.textContent.trim().startsWith(words);
  const nowhere = element === document.body;
  return [there, nowhere || drawn.outlineStyle !== 'none' && parseFloat(drawn.outlineWidth) >= 2];
}"""
"""Nothing has the focus behind the last element, and where Tab closes a list that was open."""
USED = {
    "leaderboards": ("#boards-details input", "Space", "#boards-tables th:has-text('MS-SSIM')"),
    "patients": ("#patients-next", "Enter", "#patients-films img"),
    "generators": ("#generators-set", "Enter", "#generators-note p"),
    "probe": ("#probe-plus-x", "Enter", "#probe-image b:text-is('+x')"),
    "agent": ("#agent-watch", "Enter", "#agent-image img"),
    "dataset": ("#data-frame input[type=range]", "ArrowRight", "#data-image p:has-text('frame 2')"),
}
"""Of each tab its main control, the key that uses it, and what is there then."""

FIRST = {"patients": "#patients-films img", "probe": "#probe-image img"}
"""What is drawn when a tab opens: until then what has the focus may be replaced."""


def reach(page: Any, at: str, words: str = "") -> None:
    """Press Tab until an element has the focus; wherever that is meanwhile, it is seen."""
    for _ in range(MOST):
        page.keyboard.press("Tab")
        there, seen = page.evaluate(FOCUS, [at, words])
        assert seen, page.evaluate("document.activeElement.outerHTML.slice(0, 300)")
        if there:
            return
    raise AssertionError(f"Tab does not lead to {at} {words}")


@pytest.mark.parametrize(
    "tab",
    [pytest.param(tab, marks=[pytest.mark.thorough] * (tab != "leaderboards")) for tab in USED],
)
def test_a_tab_and_its_main_control(visit: Visit, tab: str):
    control, key, then = USED[tab]
    page = visit()
    settle(page)
    reach(page, f"[role=tab][data-tab-id={tab}]")
    page.keyboard.press("Enter")
    page.wait_for_selector(f"[role=tab][data-tab-id={tab}][aria-selected=true]")
    page.wait_for_selector(FIRST.get(tab, "#rc-foot"))
    settle(page)
    reach(page, control)
    page.keyboard.press(key)
    page.wait_for_selector(then)


@pytest.mark.thorough
def test_a_sitting_begins_with_a_name_that_is_typed(visit: Visit):
    page = visit()
    reach(page, "[role=tab][data-tab-id=study]")
    page.keyboard.press("Enter")
    reach(page, "#study-name :is(input, textarea)")
    page.keyboard.type("typed")
    reach(page, "#study-begin")
    page.keyboard.press("Enter")
    page.wait_for_selector("#study-image img")


def test_the_menu_of_a_narrow_page(visit: Visit):
    page = visit(390, 844)
    settle(page)
    reach(page, ".overflow-menu > button")
    page.keyboard.press("Enter")
    reach(page, ".overflow-dropdown button", "Dataset")
    page.keyboard.press("Enter")
    page.wait_for_selector("#data-figures img")
