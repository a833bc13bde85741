"""The boards' page: what stands in it is what the records say, and names are nothing but text."""

import html
import json
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.escape import json_in_html
from racines_leaderboard.board.about import ABOUT, about
from racines_leaderboard.board.collect import collect
from racines_leaderboard.board.standing import standing_of
from racines_leaderboard.board.table import steady
from racines_leaderboard.board.web.content import (
    compared,
    ordered,
    pairs,
    read_sections,
)
from racines_leaderboard.board.web.page import LARGEST, html_page
from racines_leaderboard.cli.command import app
from racines_leaderboard.studio.boards import Selection, tables_html
from racines_models.statistics.intervals import difference
from tests.hostile import ALL
from tests.leaderboard.conftest import agent_scores, generator_scores, write_submission
from tests.leaderboard.evidence import generator, pinned

ROOT = Path(__file__).parents[3]
PAGE, RESULTS = ROOT / "docs" / "boards.html", ROOT / "leaderboard" / "results"


class Found(HTMLParser):
    """Collects elements with their attributes, the text of rows, and the script's data."""

    def __init__(self, text: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[list[str]] = []
        self.content, self._cell, self._data = "", False, False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self._cell = True
        self._data = tag == "script" and ("id", "content") in attrs

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._cell = False
        self._data = self._data and tag != "script"

    def handle_data(self, data: str) -> None:
        if self._cell:
            self.rows[-1][-1] += data
        if self._data:
            self.content += data


@pytest.fixture(scope="module")
def published() -> tuple[str, Found]:
    text = PAGE.read_text()
    return text, Found(text)


@pytest.mark.docs
def test_the_committed_page_is_what_the_records_draw_now(published):
    assert published[0] == html_page(RESULTS), (
        "draw it: racines leaderboard --html docs/boards.html"
    )


def test_the_committed_page_is_small_self_contained_and_labelled(published):
    text, found = published
    assert len(text.encode()) < LARGEST
    assert not re.search(
        r"""(src|href)=["'](?!#|data:)|url\(|@import|https?://(?!www\.w3\.org)""", text
    )
    assert "default-src 'none'" in text
    ids = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    for tag, attributes in found.elements:
        if tag == "img":
            assert attributes.get("alt")
        if tag == "a":
            assert str(attributes["href"])[1:] in ids
        if tag == "th":
            assert attributes.get("scope") in ("row", "col")


def test_every_record_stands_in_the_committed_page_with_its_score(published):
    _, found = published
    rows = {row[1]: row for row in found.rows if len(row) > 4}
    text = [" ".join(row) for row in found.rows]
    # Of what is committed: who has run a profile has a board of its own beside these.
    listed = subprocess.check_output(["git", "ls-files", "*.json"], cwd=RESULTS, text=True)
    files = [Path(name) for name in listed.splitlines()]
    paths = [path for path in files if len(path.parts) == 3 and path.parts[1] != "fresh"]
    names = {path.stem for path in paths}
    assert names <= set(rows)
    servo = json.loads((RESULTS / "beating/patient-agents/servo-a4c.json").read_text())
    metric = servo["scores"]["metrics"]["success_declared"]
    told = "{value:.1f} ({low:.1f} – {high:.1f}".format(
        **{key: 100 * metric[key] for key in ("value", "low", "high")}
    )
    assert any("servo-a4c" in line and told in line for line in text)
    assert set(ABOUT) == {path.parts[0] for path in paths}


def test_every_page_says_that_the_first_tier_is_one_heart():
    page = (ROOT / "leaderboard/LEADERBOARD.md").read_text(encoding="utf-8")
    for board in ("phantom-default", "phantom-reference"):
        told = about(board)
        assert "One simulated heart, the same in training and test" in told
        assert f"## {board}\n\n{told}\n" in page
        assert html.escape(told) in PAGE.read_text(encoding="utf-8")
        shown = tables_html(RESULTS, Selection(board, "generators"))
        assert shown.startswith(f'<p class="rc-note">{told}</p>')
    readme = (ROOT / "docs/one-heart.md").read_text(encoding="utf-8")
    assert about("phantom-default") in readme


def test_patients_stand_first():
    assert ordered(["b", "beating", "a", "patients"]) == ["patients", "beating", "a", "b"]


def test_pairs_are_those_of_the_ranking(tmp_path: Path):
    results = pinned(tmp_path)
    for name, quality in (("good", 0.7), ("fair", 0.6), ("like-fair", 0.6)):
        generator(tmp_path / "more", name, quality, seed=len(name))
    collect([tmp_path / "more"], results, tmp_path / "none", "b")
    section = read_sections(results)["b"][0]
    found = list(pairs(section))
    count = len(section.ranking)
    assert len(found) == count * (count - 1) // 2 and count > 2
    for pair in found:
        first, second = (section.ranking[row] for row in pair["rows"])
        ours, theirs = (standing_of(each.record).replicates for each in (first, second))
        assert ours is not None and theirs is not None
        told = difference(ours, theirs, "score difference")
        assert told.low is not None and told.high is not None
        shown = [steady(figure) for figure in (told.value, told.low, told.high)]
        assert [pair["value"], pair["low"], pair["high"]] == shown
        ahead = first.standing.ahead_of(second.standing)
        assert ahead == (f"so {first.record['name']} has the higher score" in pair["text"])
        assert compared(first, second) == told


def test_without_anchors_a_pair_says_that_it_cannot_be_compared(results: Path):
    sections = read_sections(results)["tiny"]
    told = [pair for section in sections for pair in pairs(section)]
    assert told and all("cannot be paired" in pair["text"] for pair in told)
    assert all("value" not in pair for pair in told)


@pytest.fixture
def results(tmp_path: Path, write_scores: Any) -> Path:
    """A board whose submission was described by somebody hostile."""
    # A submission with characters that are not seen, or of more words, is refused before.
    ours = "</script><script>window.pwned = 1</script><!--<script> ${style}"
    words = " ".join(filter(str.isprintable, ALL))[:800]
    for name in ("mine", "other"):
        told = {"method": ours, "description": f"{ours} {words}", "authors": [ours]}
        write_submission(tmp_path / "submissions/generators" / name, name=name, **told)
    generators = write_scores("g", generator_scores("mine"), generator_scores("other"))
    agents = write_scores("a", agent_scores("ppo"), agent_scores("dqn"))
    collect([generators, agents], tmp_path / "results", tmp_path / "submissions", "tiny")
    return tmp_path / "results"


def test_hostile_words_are_text(results: Path):
    harmless = Found(PAGE.read_text())
    text = html_page(results)
    found = Found(text)
    assert {tag for tag, _ in found.elements} <= {tag for tag, _ in harmless.elements}
    known = {key for _, attributes in harmless.elements for key in attributes}
    assert {key for _, attributes in found.elements for key in attributes} <= known
    assert sum(tag == "script" for tag, _ in found.elements) == 2
    assert "window.pwned" in html.unescape(text), "it is shown"
    json.loads(found.content)


def test_json_in_a_page_cannot_end_its_element():
    document = {"name": "</script><!--<script>&\u2028", "n": [1, None]}
    text = json_in_html(document)
    assert not set("<>&\u2028") & set(text) and json.loads(text) == document
    with pytest.raises(ValueError):
        json_in_html(float("nan"))


def test_a_picture_beside_a_record_is_shown_and_anything_else_refused(results: Path):
    path = results / "tiny/pictures/generators/mine.webp"
    path.parent.mkdir(parents=True)
    Image.new("L", (2000, 1000)).save(path)
    assert html_page(results).count("<img ") == 1
    path.write_text("<svg onload=alert(1)>")
    with pytest.raises(RacinesError, match="mine.webp: no WebP picture"):
        html_page(results)


def test_the_command_writes_the_page_and_refuses_a_folder(results: Path, tmp_path: Path):
    page = tmp_path / "page.html"
    line = ["leaderboard", "--results", str(results), "--html"]
    done = CliRunner().invoke(app, [*line, str(page)])
    assert done.exit_code == 0 and page.read_text() == html_page(results)
