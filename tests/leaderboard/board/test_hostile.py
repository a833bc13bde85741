"""A board whose records were written by somebody hostile, on every road out of it."""

import copy
import csv
import io
import itertools
import json
import re
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import collect, read_board
from racines_leaderboard.board.table import board_csv
from racines_leaderboard.records.schema import check, sealed
from tests.conftest import command
from tests.data.test_escape import rendered
from tests.hostile import ALL
from tests.leaderboard.conftest import agent_scores, generator_scores, write_submission

BOARD = "tiny"


def leaves(document: Any, path: tuple[Any, ...] = ()):
    """Yield the place of every text in a document."""
    pairs = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in pairs:
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))
        elif isinstance(value, str):
            yield (*path, key)


def poisoned(record: dict[str, Any], texts: Any) -> dict[str, Any]:
    """Write something hostile wherever the schemas let anybody write what they like."""
    scores = "generator-scores" if record["track"] == "generators" else "agent-scores"
    for place in list(leaves(record)):
        changed = copy.deepcopy(record)
        parent = changed
        for key in place[:-1]:
            parent = parent[key]
        parent[place[-1]] = f"{next(texts)} {next(texts)}"
        try:
            check(changed, "record", "x")
            check(changed["scores"], scores, "x")
        except RacinesError:
            continue
        record = changed
    return sealed(record)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The results of a harmless board, and of the same one in hostile words."""
    root = tmp_path_factory.mktemp("hostile")
    for name in ("mine", "other", "third"):
        write_submission(root / "submissions/generators" / name, name=name)
        write_submission(root / "submissions/agents" / name, name=name, track="agents")
        for kind, scores in (("g", generator_scores(name)), ("a", agent_scores(name))):
            (root / kind).mkdir(exist_ok=True)
            (root / kind / f"{name}.json").write_text(json.dumps(scores))
    calm = root / "calm"
    collect([root / "g", root / "a"], calm, root / "submissions", BOARD)
    texts, hostile = itertools.cycle(ALL), root / "hostile"
    for path in sorted(calm.glob("*/*/*.json")):
        record = json.loads(path.read_text())
        place = hostile / path.relative_to(calm)
        place.parent.mkdir(parents=True, exist_ok=True)
        made = poisoned(record, texts)
        if record["track"] == "agents":  # one task, so that there are as many tables
            for key in ("view", "backend", "reward", "start_set"):
                made["scores"]["task"][key] = f"{ALL[0]} | {ALL[1]} \x1b[31m"
        place.write_text(json.dumps(sealed(made)))
    return calm, hostile


def test_much_of_a_record_is_anybodys(boards: tuple[Path, Path]):
    """Else nothing is tested here."""
    record = json.loads((boards[1] / BOARD / "generators/mine.json").read_text())
    assert "evil" in json.dumps(record) and record["submission"]["method"] != "a method"


def test_a_page_of_a_hostile_board_has_the_elements_of_a_harmless_one(boards: tuple[Path, Path]):
    from racines_leaderboard.board.pages import write_page

    pages = []
    for results in boards:
        write_page(results / "PAGE.md", results)
        pages.append(rendered((results / "PAGE.md").read_text()))
    for calm, hostile in zip(*pages, strict=True):
        assert hostile.tags == calm.tags
        assert [n for n, _ in hostile.attributes] == [n for n, _ in calm.attributes]
        for name, value in hostile.attributes:
            assert name not in ("href", "src") or "evil" not in str(value)


def test_an_audit_of_hostile_records_is_a_page_of_its_own_elements(boards: tuple[Path, Path]):
    from racines_leaderboard.audit.verdicts import Report, audit_markdown, fails

    def page(word: str) -> list[Any]:
        told = tuple(fails(word, word, word, word) for _ in range(2))
        return rendered(audit_markdown([Report(BOARD, "agents", "mine", "recomputed", told)]))

    for text in ALL:
        for calm, hostile in zip(page("word"), page(text), strict=True):
            assert set(hostile.tags) == set(calm.tags) and len(hostile.tags) == len(calm.tags)


def test_a_terminal_shows_a_hostile_board_without_control_characters(
    boards: tuple[Path, Path], tmp_path: Path
):
    for words in (("--details",), ("--json",), ("--board", BOARD)):
        shown = command(tmp_path, "racines", "leaderboard", "--results", str(boards[1]), *words)
        for line in (shown.stdout + shown.stderr).split("\n"):
            assert line.isprintable(), line
    assert "mine" in shown.stdout


def test_no_cell_of_a_hostile_boards_csv_is_a_formula(boards: tuple[Path, Path], tmp_path: Path):
    out = tmp_path / "board.csv"
    command(tmp_path, "racines", "leaderboard", "--results", str(boards[1]), "--csv", str(out))
    content = read_board(boards[1], BOARD)
    assert out.read_bytes().decode() == board_csv({BOARD: content})
    rows = list(csv.DictReader(io.StringIO(out.read_bytes().decode())))
    figures = sum(len(r["scores"]["metrics"]) for records in content.values() for r in records)
    read = pl.read_csv(out, infer_schema=False)
    assert len(rows) == len(read) == figures > 20
    number = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")
    for row in (*rows, *read.iter_rows(named=True)):
        for name, cell in row.items():
            if name in ("value", "low", "high", "n") and cell:
                assert number.fullmatch(cell)
            else:
                assert not cell or cell[0] not in "=+-@\t\r"


def test_a_hostile_view_is_no_mathematics_of_a_chart(boards: tuple[Path, Path], tmp_path: Path):
    from matplotlib.figure import Figure

    from racines_leaderboard.board.pages import panel
    from racines_leaderboard.board.rank import rankings
    from racines_leaderboard.records.tracks import TRACK

    records = read_board(boards[0], BOARD)["agents"]
    for record in records:
        record["scores"]["task"]["view"] = r"$\nothing{$"
    track = TRACK["agents"]
    figure = Figure()
    panel(figure.subplots(), track.columns[0], rankings(track, records))
    figure.savefig(tmp_path / "chart.png")
    assert (tmp_path / "chart.png").stat().st_size
