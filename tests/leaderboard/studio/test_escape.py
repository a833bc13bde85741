"""Nothing that others wrote is taken for markup, and nothing odd gets past a field."""

import html
import math

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.studio.html import link, text
from racines_leaderboard.studio.inputs import choice, choices, number, whole, words

ATTACKS = [
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    '"\' onmouseover=alert(1) x="',
    "</td></table><iframe src=javascript:alert(1)>",
    "${alert(1)}",
    "{{constructor.constructor('alert(1)')()}}",
    "`alert(1)`",
]


@pytest.mark.parametrize("attack", ATTACKS)
def test_markup_and_template_marks_are_shown_and_not_run(attack: str):
    shown = text(attack)
    assert not set(shown) & set("<>\"'{}$`")
    assert html.unescape(shown) == attack


def test_invisible_characters_do_not_reach_the_page():
    assert text("a\u202eb\x00c\u200bd\ne") == "a b c d e"


def test_a_long_text_is_cut_before_it_is_escaped():
    assert text("<" * 50, longest=3) == "&lt;&lt;…"
    assert len(text("x" * 10**6)) == 400


@pytest.mark.parametrize(
    "url",
    [
        "javascript:alert(1)", "http://example.org", "https://example.org/\"onclick=x",
        "https://example.org/<b>", "data:text/html,x", " https://example.org", None, 7,
    ],
)  # fmt: skip
def test_only_plain_https_addresses_become_links(url):
    assert "<" not in link(url)


def test_a_link_tells_the_other_side_nothing():
    shown = link("https://example.org/a?b=c&d=e")
    assert 'href="https://example.org/a?b=c&amp;d=e"' in shown
    assert 'rel="noopener noreferrer nofollow"' in shown


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "1", None, True, 11, -1, [1]])
def test_numbers_out_of_range_and_what_is_none_are_refused(value):
    with pytest.raises(RacinesError, match="grade: "):
        number(value, 0, 10, "grade")


def test_numbers_in_range_pass():
    assert number(2, 0, 10, "x") == 2.0 and whole(10.0, 0, 10, "x") == 10
    with pytest.raises(RacinesError, match="whole number"):
        whole(2.5, 0, 10, "x")


@pytest.mark.parametrize("value", ["c", "../a", None, ["a"], {"a": 1}, 1.0, True])
def test_only_what_was_offered_is_chosen(value):
    with pytest.raises(RacinesError, match="was not offered"):
        choice(value, ("a", "b", 1), "board")


def test_choices_come_in_the_order_in_which_they_are_offered():
    assert choices(["b", "a"], ("a", "b", "c"), "tier") == ("a", "b")
    for wrong in ("ab", ["d"], ["a"] * 4, None):
        with pytest.raises(RacinesError, match="tier"):
            choices(wrong, ("a", "b", "c"), "tier")


@pytest.mark.parametrize("value", [*ATTACKS, "a\nb", "a\x00", "\u202ea", "x" * 41, 3, None])
def test_lines_of_words_hold_letters_digits_and_a_few_marks(value):
    with pytest.raises(RacinesError, match="about you: "):
        words(value, 40, "about you")


def test_words_of_any_script_pass():
    assert words("  Kardiologin, 12 Jahre (Zürich) ", 40, "x") == "Kardiologin, 12 Jahre (Zürich)"
    assert words("心臓 7", 40, "x") == "心臓 7"
