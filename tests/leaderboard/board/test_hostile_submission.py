"""Somebody hostile hands in a submission: from `racines submit` to every place that shows it."""

import csv
import dataclasses
import io
import json
import unicodedata
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from racines_data.card.markdown import write_card
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest
from racines_data.sources.base import SourceCard
from racines_leaderboard.board.pages import BEGIN, END
from racines_leaderboard.cli.command import app
from racines_leaderboard.studio.boards import (
    Selection,
    provenance_html,
    record_of,
    tables_html,
)
from racines_leaderboard.submissions.document import read_document
from tests.data.test_escape import Page, rendered
from tests.hostile import ALL
from tests.leaderboard.conftest import artefact, generator_scores, write_submission

BOARD = "tiny"
CALM = "a harmless word"
URL = "https://evil.example/x'onmouseover=pwned()?a=1&b=(2)"
"""All that an address may have."""
MARKS = f"{BEGIN.format(board=BOARD)}\n{END}\n"


def racines(*words: Any) -> Any:
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def accepted(folder: Path) -> list[str]:
    """Return what a submission may hold as authors; the rest is refused in one line of text."""
    kept: list[str] = []
    for i, text in enumerate(ALL):
        try:
            path = write_submission(folder / str(i), authors=[*kept, text][-50:])
            read_document(path)
        except RacinesError as error:
            shown = str(error).replace(str(folder), "")
            assert shown.isprintable() and len(shown) < 400, shown
            continue
        assert all(unicodedata.category(c) != "Cc" for c in text)
        kept.append(text)
    return kept


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two boards of one submission, submitted and collected: in harmless and in hostile words."""
    root = tmp_path_factory.mktemp("submitted")
    texts = accepted(root / "tried")
    assert len(texts) > 40, "else nothing is tested here"
    letters = "bcdfghjkm"  # none that looks like another
    calm = [f"{CALM} {a}{b}" for a in letters for b in letters][: len(texts)]
    for kind, words in (("calm", calm), ("hostile", texts)):
        base = root / kind
        told = {
            "authors": words[:50],
            "description": " ".join(words)[:2000],
            "training": {"budget": words[0], "hardware": words[-1]},
            "code": {"package": "mine", "version": words[1]},
            "url": "https://evil.example/" if kind == "calm" else URL,
            "licence": "MIT",
        }
        for i in range(2):
            method = " ".join(words[25 * i : 25 * i + 25])[:200].strip()
            inbox, scores = base / "inbox" / f"mine-{i}", base / "scores" / f"mine-{i}.json"
            for path in (scores, inbox / "scores.json"):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(json.dumps(generator_scores(f"mine-{i}")))
            files = artefact("scores", inbox / "scores.json")
            write_submission(inbox, files, name=f"mine-{i}", method=method, **told)
            racines("submit", inbox, "--out", base / "submissions")
        (base / "README.md").write_text(MARKS)
        where = ("--results", base / "results", "--submissions", base / "submissions")
        page = ("--markdown", base / "PAGE.md", "--readme", base / "README.md")
        shown = racines("leaderboard", "--board", BOARD, "--collect", base / "scores", *where,
                        *page, "--csv", base / "board.csv", "--details")  # fmt: skip
        (base / "terminal.txt").write_text(shown.output)
        shown = racines("leaderboard", "--board", BOARD, *where, "--json")
        (base / "board.json").write_text(shown.stdout)
    return root / "calm", root / "hostile"


def test_the_hostile_words_are_on_the_board(places: tuple[Path, Path]):
    submission = json.loads((places[1] / "results/tiny/generators/mine-0.json").read_text())
    held = json.dumps(submission["submission"])
    assert "<script>" in held and "evil.example" in held and "=cmd" in held or "=1+1" in held


@pytest.mark.parametrize("page", ["PAGE.md", "README.md"])
def test_a_page_has_the_elements_of_the_harmless_one(places: tuple[Path, Path], page: str):
    calm, hostile = (rendered((place / page).read_text()) for place in places)
    for ours, theirs in zip(calm, hostile, strict=True):
        assert theirs.tags == ours.tags and "table" in theirs.tags
        assert [name for name, _ in theirs.attributes] == [name for name, _ in ours.attributes]
        assert not [v for n, v in theirs.attributes if n in ("href", "src") and "evil" in str(v)]


def test_a_terminal_a_csv_file_and_json_show_text(places: tuple[Path, Path]):
    for line in (places[1] / "terminal.txt").read_text().split("\n"):
        assert line.isprintable(), line
    assert (places[1] / "board.json").read_text().isascii()
    assert json.loads((places[1] / "board.json").read_text())["boards"][BOARD]
    rows = list(csv.DictReader(io.StringIO((places[1] / "board.csv").read_bytes().decode())))
    assert len(rows) == len(list(csv.DictReader((places[0] / "board.csv").open())))
    for name, cell in (pair for row in rows for pair in row.items()):
        number = name in ("value", "low", "high", "n")
        assert number or not cell or cell[0] not in "=+-@\t\r＝＋－＠"


def test_the_studio_shows_text(places: tuple[Path, Path]):
    pages = []
    for place in places:
        wanted = Selection(BOARD, "generators", details=True)
        record = record_of(place / "results", wanted, "mine-1")
        shown = tables_html(place / "results", wanted), provenance_html(record)
        pages.append([Page(html) for html in shown])
    for calm, hostile in zip(*pages, strict=True):
        # An address with a quote in it is not made a link of.
        assert hostile.tags in (calm.tags, [tag for tag in calm.tags if tag != "a"])
        assert {n for n, _ in hostile.attributes} <= {n for n, _ in calm.attributes}
        assert {v for n, v in hostile.attributes if n == "href"} <= {URL}
    assert "<script>" in pages[1][1].text, "shown as text"


def card_of(manifest: dict[str, Any], words: Any) -> str:
    texts = {
        field.name: next(words)
        for field in dataclasses.fields(SourceCard)
        if field.type == "str" or field.type is str
    }
    card = dataclasses.asdict(SourceCard()) | texts | {"tags": [next(words), next(words)]}
    return write_card(manifest | {"source": next(words), "version": next(words), "card": card})


@pytest.mark.parametrize("start", range(0, len(ALL), 8))
def test_a_dataset_card_has_the_elements_of_a_harmless_one(tiny_root: Path, start: int):
    """What a source of another package says of itself, and what it is called."""
    manifest = read_manifest(tiny_root)
    turned = [*ALL[start:], *ALL[:start]]
    bodies = []
    for words in ([CALM] * 30, turned):
        card = card_of(manifest, iter(words))
        head, _, body = card.removeprefix("---\n").partition("\n---\n")
        assert all(c.isprintable() or c == "\n" for c in head + body)
        front = yaml.safe_load(head)
        assert set(front) and front["configs"][0]["config_name"] == "frames"
        bodies.append((set(front), rendered(body)))
    assert bodies[0][0] == bodies[1][0]
    for calm, hostile in zip(bodies[0][1], bodies[1][1], strict=True):
        assert hostile.tags == calm.tags
        assert [n for n, _ in hostile.attributes] == [n for n, _ in calm.attributes]
        links = [v for n, v in hostile.attributes if n in ("href", "src")]
        assert not [link for link in links if "evil" in str(link)]
