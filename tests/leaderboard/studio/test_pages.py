"""The pages in a browser: every tab opened, used and photographed, at both widths; two visitors."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.leaderboard.studio.conftest import HOSTILE, open_tab

pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
pytestmark = pytest.mark.docs
WIDTHS = [(1280, 900), (390, 844)]
widths = pytest.mark.parametrize("size", WIDTHS, ids=["desktop", "phone"])
Visit = Callable[..., Any]


def photograph(page: Any, path: Path) -> None:
    """Take a picture of the whole page, which must not be wider than the window."""
    page.screenshot(path=path, full_page=True)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert path.stat().st_size > 10_000
    assert "not a medical device" in page.inner_text("#rc-foot")


@widths
def test_leaderboards(visit: Visit, tmp_path: Path, size):
    page = visit(*size)
    page.locator("#boards-tables tr[data-name=mine] td").first.click()
    page.wait_for_selector("#boards-record dl")
    assert HOSTILE[:40] in page.inner_text("#boards-record"), "shown as text"
    label = page.get_by_text("Further figures", exact=True).bounding_box()
    assert label["x"] + label["width"] <= size[0]
    photograph(page, tmp_path / "generators.png")
    page.get_by_label("agents", exact=True).click()
    page.wait_for_selector("#boards-tables tr[data-name=pl-image]")
    page.get_by_label("the pose").click()
    page.wait_for_selector("#boards-tables tr[data-name=pl-image]", state="detached")
    assert page.locator("#boards-tables tr[data-name=sc-params]").count() == 1
    photograph(page, tmp_path / "agents.png")


def begin(page: Any, name: str, code: str = "") -> None:
    open_tab(page, "Expert study")
    page.locator("#study-name :is(input, textarea)").fill(name)
    page.locator("#study-given :is(input, textarea)").fill(code)
    page.locator("#study-begin").click()


def progress(page: Any, done: int) -> str:
    page.wait_for_function(
        f"document.getElementById('study-progress')?.innerText.startsWith('{done} of ')"
    )
    return page.inner_text("#study-progress")


def pick(page: Any, what: str, label: str) -> None:
    page.locator(f"#study-{what} label").filter(has_text=label).first.click()


@widths
def test_study_by_buttons_and_keys(visit: Visit, tmp_path: Path, size):
    page, name = visit(*size), f"by-hand-{size[0]}"
    begin(page, name)
    assert name in progress(page, 0)
    first = page.get_attribute("#study-image img", "src")
    pick(page, "view", "PL")
    pick(page, "grade", "4")
    photograph(page, tmp_path / "study.png")
    page.locator("#study-save").click()
    progress(page, 1)
    page.wait_for_function(
        "first => document.querySelector('#study-image img').src !== first", arg=first
    )
    page.keyboard.press("a")
    page.keyboard.press("0")
    assert page.locator("#study-grade input:checked").get_attribute("value") is not None
    page.keyboard.press("Backspace")
    page.wait_for_function("!document.querySelector('#study-grade input:checked')")
    page.keyboard.press("s")
    page.keyboard.press("9")
    page.keyboard.press("Enter")
    progress(page, 2)
    for done in range(3, 16):
        page.keyboard.press("h")  # the sixth: no view, which needs no grade
        page.keyboard.press("Enter")
        if done < 15:
            progress(page, done)
    page.wait_for_selector("#study-done .rc-done")
    assert f"racines expert score kit kit-ratings/{name}.jsonl" in page.inner_text("#study-done")
    photograph(page, tmp_path / "finished.png")


def test_two_visitors_do_not_see_each_others_study(visit: Visit, place):
    anna, ben = visit(), visit()
    begin(anna, "anna")
    begin(ben, "ben")
    assert "anna" in progress(anna, 0) and "ben" in progress(ben, 0)
    pick(anna, "view", "SC")
    pick(anna, "grade", "7")
    anna.locator("#study-save").click()
    assert "anna" in progress(anna, 1)
    assert "ben" in progress(ben, 0)
    assert not (place.kits / "kit-ratings" / "ben.jsonl").exists()
    # Somebody else of the same name is turned away; with the code, anna goes on.
    third = visit()
    begin(third, "anna")
    assert "the name is taken" in third.locator(".toast-body").inner_text()
    code = anna.locator("#study-code code").nth(1).inner_text()
    begin(third, "anna", code)
    assert "anna" in progress(third, 1)


def test_markup_in_a_field_is_refused_and_shown_as_text(visit: Visit, tmp_path: Path):
    page = visit()
    begin(page, "<img src=x onerror=pwned=1>")
    # Read at once, before it goes: the words as shown, and what they are made of.
    shown, images = page.locator(".toast-body").evaluate(
        "toast => [toast.innerText, toast.querySelectorAll('img[src=x]').length]"
    )
    assert "<" in shown and "&lt;" not in shown and images == 0
    page.screenshot(path=tmp_path / "refused.png")


@widths
def test_dataset(visit: Visit, tmp_path: Path, size):
    page = visit(*size)
    open_tab(page, "Dataset")
    page.wait_for_selector("#data-figures img")
    before = page.get_attribute("#data-image img", "src")
    page.locator("#data-frame input[type=number]").fill("9")
    page.keyboard.press("Tab")
    page.wait_for_function("document.getElementById('data-image').innerText.includes('frame 9 of')")
    assert page.get_attribute("#data-image img", "src") != before
    assert page.locator("#data-figures img").count() == 2
    photograph(page, tmp_path / "dataset.png")
    page.get_by_label("validation").click()
    page.wait_for_function(
        "document.getElementById('data-facts').innerText.includes('validation split')"
    )
