"""The boards' page in a browser: sorting, filters, tabs, pairs, narrow and without JavaScript."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from racines_leaderboard.board.web.page import write_html
from racines_leaderboard.studio.parts import Place
from tests.leaderboard.studio.conftest import BROWSER_PATIENCE

pytestmark = pytest.mark.docs
PAGE = Path(__file__).parents[3] / "docs" / "boards.html"


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a page as a file; at the end nothing may have gone wrong or been asked of a host."""
    contexts, faults = [], []

    def opened(path: Path = PAGE, width: int = 1280, **how: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": 900}, **how)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(BROWSER_PATIENCE)
        page.on("pageerror", lambda error: faults.append(f"error: {error}"))
        page.on("console", lambda m: faults.append(m.text) if m.type == "error" else None)
        page.on(
            "request",
            lambda r: None if r.url.startswith(("file:", "data:")) else faults.append(r.url),
        )
        page.goto(path.as_uri())
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not faults


def _names(ranking: Any) -> list[str]:
    found = ranking.locator("tbody tr:not([hidden]) .name")
    return [words.strip() for words in found.all_inner_texts()]


def test_columns_sort_by_mouse_and_keyboard_and_say_so(open_page):
    page = open_page()
    ranking = page.locator(".ranking").first
    head = ranking.locator("thead th").nth(3)
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    up = ranking.locator("tbody tr td:nth-child(4)").evaluate_all("c => c.map(x => +x.dataset.v)")
    assert up == sorted(up) and up != sorted(up, reverse=True)
    head.locator("button").press("Enter")
    assert head.get_attribute("aria-sort") == "descending"
    down = ranking.locator("tbody tr td:nth-child(4)").evaluate_all("c => c.map(x => +x.dataset.v)")
    assert down == sorted(up, reverse=True)
    ranking.locator("thead th").nth(1).locator("button").press("Space")
    assert _names(ranking) == sorted(_names(ranking))
    assert head.get_attribute("aria-sort") == "none"
    ranking.locator("thead th").nth(0).locator("button").click()
    assert _names(ranking)[0] == "servo-a4c", "bounds have no place and stand last"


def test_rows_are_filtered_by_name_kind_trainings_and_verdict(open_page):
    page = open_page()
    ranking = page.locator(".ranking").first
    page.get_by_label("Kind").select_option("learned")
    assert _names(ranking) == ["servo-a4c"]
    page.get_by_label("Verdict").select_option("holds")
    assert _names(ranking) == [] and ranking.locator(".empty").is_visible()
    page.get_by_role("button", name="Clear").click()
    # The page's policy forbids to evaluate text, so no condition is waited for in the page.
    page.locator(".ranking tbody tr[hidden]").first.wait_for(state="detached")
    page.get_by_label("Search").fill("TOUR OF")
    assert _names(ranking) == ["blind-tour-a4c"], "by its method"
    page.get_by_label("Search").fill("")
    page.get_by_label("Trainings").select_option("3")
    assert _names(ranking) == ["servo-a4c"]


def test_two_rows_are_compared_as_the_records_say(open_page):
    page = open_page()
    told = json.loads(page.locator("#content").text_content())["sections"]
    ranking = page.locator(".ranking").first
    pair = next(each for each in told["b0-0"]["pairs"] if each["rows"] == [1, 2])
    ranking.locator("thead th button").nth(1).click()
    for row in (2, 1):  # in any order of rows and of ticks
        ranking.get_by_label(f"Compare {told['b0-0']['names'][row]}", exact=True).check()
    compare = ranking.locator(".compare")
    assert compare.inner_text().startswith(pair["text"]) and compare.locator("svg").count() == 1
    ranking.get_by_label(f"Compare {told['b0-0']['names'][0]}", exact=True).check()
    assert ranking.locator("input:checked").count() == 2, "the first tick gives way"
    assert ranking.locator("tr.picked").count() == 2


def test_tabs_move_by_arrows_and_a_method_opens_its_card(open_page):
    page = open_page()
    page.get_by_role("tab").first.press("ArrowRight")
    second = page.get_by_role("tab").nth(1)
    assert second.get_attribute("aria-selected") == "true"
    assert second.evaluate("tab => tab === document.activeElement")
    assert page.locator(".board:visible").count() == 1
    page.locator(".board:visible tbody .name a").first.click()
    page.locator(".card:target").wait_for(state="visible")
    assert page.get_by_role("tab").nth(1).get_attribute("aria-selected") == "true"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_narrow_pages_scroll_their_tables_alone_and_keep_the_name_in_sight(open_page, scheme):
    page = open_page(width=390, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    scroll = page.locator(".scroll").first
    scroll.evaluate("box => box.scrollTo(600, 0)")
    name, box = (scroll.locator(at).first.bounding_box() for at in ("tbody .name", "tbody"))
    assert box["x"] < -300 and 0 <= name["x"] < 40
    assert all(_contrasts(page))


def _contrasts(page: Any) -> list[bool]:
    """Return whether each kind of text stands out from what is behind it by 4.5 to 1."""
    return page.evaluate(
        """() => {
          const light = c => c.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
            .map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4)
            .reduce((sum, v, i) => sum + v * [.2126, .7152, .0722][i], 0);
          const behind = e => { while (e && getComputedStyle(e).backgroundColor
            === "rgba(0, 0, 0, 0)") e = e.parentElement;
            return getComputedStyle(e || document.body).backgroundColor; };
          return [...document.querySelectorAll("h1, .lead, .notice, .tabs a, .hint, label, th, td, "
            + "td small, .name a, summary, .v")].map(e => {
            const both = [light(getComputedStyle(e).color), light(behind(e))].sort((a, b) => b - a);
            return (both[0] + .05) / (both[1] + .05) >= 4.5; });
        }"""
    )


def test_without_javascript_all_tables_can_be_read(open_page):
    page = open_page(java_script_enabled=False)
    assert page.locator(".board:visible").count() == page.locator(".board").count() > 1
    assert page.get_by_text("servo-a4c").first.is_visible()
    assert not page.locator("#filters").is_visible() and page.locator("thead button").count() == 0


def test_hostile_words_run_nowhere(open_page, place: Place, tmp_path: Path):
    write_html(tmp_path / "page.html", place.results)
    page = open_page(tmp_path / "page.html")
    for summary in page.locator("summary").all():
        if summary.is_visible():
            summary.click()
    page.locator(".ranking input").nth(0).check()
    page.locator(".ranking input").nth(1).check()
    assert page.evaluate("window.pwned") is None
    assert (
        "<script>"
        in page.locator(".card").first.inner_text() + page.locator(".card").nth(1).inner_text()
    ), "it is shown"
