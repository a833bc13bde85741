import csv
import dataclasses
import io
import json
import re

import pytest
from PIL import Image
from rich.console import Console
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import collect, read_board
from racines_leaderboard.board.pages import BEGIN, END, with_tables, write_page
from racines_leaderboard.board.table import (
    REPORTED,
    board_csv,
    board_tables,
    figure_text,
    plain,
    show,
    steady,
    titled_markdown,
)
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.columns import Column
from racines_leaderboard.records.schema import seal_of
from racines_leaderboard.records.verdicts import Audited, keep_verdicts
from racines_leaderboard.studio.boards import Selection, charts_html, names, tables_html
from tests.leaderboard.conftest import DIGEST, agent_scores, generator_scores, write_submission
from tests.leaderboard.evidence import generator, pinned


@pytest.fixture
def results(tmp_path, write_scores):
    generators = write_scores(
        "g",
        generator_scores("vae-gan", fid=80.0, kid=0.05, view_agreement_truth=0.9),
        generator_scores("mean-image", ssim=0.25, kid=None),
    )
    agents = write_scores(
        "a",
        agent_scores("ppo", success_true=0.75),
        agent_scores("other", view="PL") | {"sees": "truth"},
    )
    collect([generators, agents], tmp_path / "results", tmp_path, "phantom-smoke")
    return tmp_path / "results"


def test_tables_show_figures_intervals_n_and_the_papers_figures_apart(results):
    tables = board_tables("phantom-smoke", read_board(results, "phantom-smoke"))
    titles = [table.title for table in tables]
    assert titles == [
        "phantom-smoke · generators",
        f"generators · {REPORTED}",
        "phantom-smoke · agents · PL, phantom backend",
        "phantom-smoke · agents · SC from the image, phantom backend",
        f"agents · {REPORTED}",
    ]
    assert tables[0].rows[1][:2] == ("no anchors", "vae-gan"), "in the order of names"
    assert "SSIM ↑" in tables[0].head and "FID ↓" in tables[0].head
    text = titled_markdown(tables[0])
    assert "80.0 (79.9 – 80.1)" in text
    assert "| – |" in text, "a missing figure is a dash, not a zero"
    assert "self-reported" in text and "100" in text
    assert f"phantom 1.0.0 (simulated), recipe {DIGEST[:12]}" in text
    assert "On the true frames the view agrees in 90.0 %" in text
    assert "0.4253" in titled_markdown(tables[1]) and "0.4253" not in text
    assert "75.0 (65.0 – 85.0)" in titled_markdown(tables[3])
    assert tables[3].head[2] == "Sees" and tables[3].rows[0][2] == "image"
    assert tables[2].rows[0][2] == "truth", "not all that it is shown, but what it says it goes by"


def test_an_interval_that_covers_less_says_how_much(tmp_path, write_scores):
    scores = generator_scores("vae-gan")
    scores["metrics"]["fid"]["settings"] = {"level": 0.92}
    scores["metrics"]["kid"]["settings"] = {"level": 0.95}
    collect([write_scores("g", scores)], tmp_path / "results", tmp_path, "b")
    content = read_board(tmp_path / "results", "b")
    text = titled_markdown(board_tables("b", content)[0])
    assert "100.0 (99.9 – 100.1; 92 %)" in text and text.count("; 92 %") == 1 and "; 95" not in text
    assert "95 % intervals; where such intervals were found to cover less, how much." in text
    lines = csv.DictReader(io.StringIO(board_csv({"b": content})))
    assert {line["figure"]: line["level"] for line in lines}["fid"] == "0.92"


def test_further_figures_stand_in_a_table_of_their_own(tmp_path, write_scores):
    truth = {"pose_error_mm_truth": 1.25, "pose_error_deg_truth": 2.5}
    scores = generator_scores("vae-gan", ms_ssim=0.75, pose_error_mm=4.5, **truth)
    collect([write_scores("g", scores)], tmp_path / "results", tmp_path, "b")
    content = read_board(tmp_path / "results", "b")
    main, further, _ = board_tables("b", content, details=True)
    assert [table.title for table in (main, further)] == [
        "b · generators",
        "b · generators · in detail",
    ]
    assert "Pose error (mm) ↓" in main.head and "MS-SSIM ↑" not in main.head
    assert "MS-SSIM ↑" in further.head and "Density ↑" not in further.head
    assert "0.750" in titled_markdown(further)
    assert "the pose is read with an error of 1.2 mm and 2.5°" in titled_markdown(main)
    assert len(board_tables("b", content)) == 2


def test_a_submitters_words_are_text_on_a_page_and_on_a_terminal(tmp_path, write_scores):
    hostile = "net | x | [y](https://a.b) <img src=z> `code` [red]"
    write_submission(tmp_path / "s" / "generators" / "net", name="net", method=hostile)
    collect([write_scores("g", generator_scores("net"))], tmp_path / "r", tmp_path / "s", "b")
    table = board_tables("b", read_board(tmp_path / "r", "b"))[0]
    shown = r"net \| x \| \[y\](https&#58;//a.b) &lt;img src=z&gt; \`code\` \[red\]"
    assert f"Systems: net, {shown}." in titled_markdown(table)
    out = io.StringIO()
    show(dataclasses.replace(table, title=hostile), Console(file=out, width=200))
    assert f"Systems: net, {hostile}." in out.getvalue() and hostile in out.getvalue()


def test_a_terminal_gets_every_cell(results):
    out = io.StringIO()
    for table in board_tables("phantom-smoke", read_board(results, "phantom-smoke")):
        show(table, Console(file=out, width=200))
    text = out.getvalue()
    assert "80.0" in text and "(79.9–80.1)" in text and "0.4253" in text


def test_a_narrow_terminal_gets_a_column_a_system(results):
    out = io.StringIO()
    table = board_tables("phantom-smoke", read_board(results, "phantom-smoke"))[0]
    show(table, Console(file=out, width=60))
    assert re.search(r"System +mean-image +vae-gan", out.getvalue())
    assert "(79.9–80.1)" in out.getvalue()


def test_plain_data_has_every_figure(results):
    data = plain(read_board(results, "phantom-smoke"))
    assert [(r["rank"], r["name"]) for r in data["generators"]] == [
        (None, "mean-image"),
        (None, "vae-gan"),
    ]
    assert data["generators"][1]["metrics"]["fid"]["value"] == 80.0


def test_the_page_names_boards_and_draws_charts(results, tmp_path):
    page = tmp_path / "LEADERBOARD.md"
    write_page(page, results)
    text = page.read_text()
    assert "## phantom-smoke" in text and "not a medical device" in text
    for track in ("generators", "agents"):
        link = f"results/phantom-smoke/{track}.png"
        assert f"({link})" in text
        with Image.open(tmp_path / link) as image:
            assert image.width > 400
    first = page.read_bytes()
    write_page(page, results)
    assert page.read_bytes() == first


def test_a_readme_is_renewed_between_its_marks_only(results):
    begin = BEGIN.format(board="phantom-smoke")
    text = with_tables(f"before\n{begin}\nstale\n{END}\nafter\n", results, "README.md")
    assert text.startswith(f"before\n{begin}\n") and text.endswith(f"{END}\nafter\n")
    assert "stale" not in text and "80.0 (79.9 – 80.1)" in text
    assert with_tables(text, results, "README.md") == text


@pytest.mark.parametrize("text", ["no marks", BEGIN.format(board="phantom-smoke"), END])
def test_a_readme_without_marks_is_refused(results, text):
    with pytest.raises(RacinesError, match=r"README\.md: needs the lines"):
        with_tables(text, results, "README.md")


def test_a_readme_of_an_unknown_board_is_refused(results):
    with pytest.raises(RacinesError, match="board 'other' has no results"):
        with_tables(f"{BEGIN.format(board='other')}\n{END}", results, "README.md")


@pytest.fixture
def ranked(tmp_path):
    """A pinned board, one of whose records was audited."""
    results = pinned(tmp_path)
    for name, quality, seed in (("good", 0.8, 1), ("poor", 0.3, 2)):
        generator(tmp_path / "new", name, quality, seed)
    generator(tmp_path / "new", "once", 0.9, trainings=1)
    collect([tmp_path / "new"], results, tmp_path, "b")
    record = json.loads((results / "b/generators/good.json").read_text())
    said = Audited("not verified", seal_of(record), "self-reported")
    keep_verdicts(results / "b", {"generators/good": said})
    return results


def test_every_road_out_shows_score_place_trainings_units_and_verdict(ranked, tmp_path):
    content = read_board(ranked, "b")
    score = {r["name"]: r["standing"].score for r in content["generators"]}["good"]
    shown = f"{score.value:.3f} ({score.low:.3f} – {score.high:.3f})"
    table = board_tables("b", content)[0]
    rows = {row[1]: dict(zip(table.head, row, strict=True)) for row in table.rows}
    assert (
        rows["good"] | {"#": "1", "Score ↑": shown, "Trainings": "3", "Units": "8"} == rows["good"]
    )
    assert rows["good"]["Verdict"] == "not verified" and rows["poor"]["Verdict"] == "–"
    assert (rows["poor"]["#"], rows["once"]["#"], rows["once"]["Trainings"]) == (
        *("2", "one training"),
        "1",
    )
    assert "fixed for the board" in table.notes[0] and "Units: trajectories." in table.notes[1]
    write_page(tmp_path / "L.md", ranked)
    assert shown in (tmp_path / "L.md").read_text()
    text = with_tables(f"{BEGIN.format(board='b')}\n{END}", ranked, "README.md")
    assert shown in text and "not verified" in text
    data = {row["name"]: row for row in plain(content)["generators"]}
    assert data["good"]["rank"] == 1 and data["good"]["score"]["value"] == score.value
    assert (data["once"]["rank"], data["once"]["unplaced"]) == (None, "one training")
    lines = list(csv.DictReader(io.StringIO(board_csv({"b": content}))))
    (line,) = [each for each in lines if each["name"] == "good" and each["figure"] == "score"]
    assert (line["place"], line["trainings"], line["units"]) == ("1", "3", "8")
    assert float(line["low"]) == score.low and line["verdict"] == "not verified"
    wanted = Selection("b", "generators")
    page = tables_html(ranked, wanted)
    assert f'{score.value:.3f}<span class="rc-between">{score.low:.3f} – {score.high:.3f}' in page
    assert "one training" in page and "not verified" in page
    assert names(ranked, wanted)[1:3] == ["once", "good"]
    assert "Score ↑" in charts_html(ranked, wanted)


def test_the_studio_reads_a_board_again_when_its_own_file_changes(ranked):
    wanted = Selection("b", "generators")
    before = tables_html(ranked, wanted)
    (ranked / "b/audit.json").unlink()
    assert "not verified" in before and "not verified" not in tables_html(ranked, wanted)
    (ranked / "b/board.json").unlink()
    assert "Nothing is ranked" in tables_html(ranked, wanted)


def test_captions_say_the_level_of_the_intervals(ranked, monkeypatch):
    from racines_leaderboard.board import table as tables

    monkeypatch.setattr(tables, "PERCENT", "90 %")
    assert "90 % intervals" in board_tables("b", read_board(ranked, "b"))[0].notes[1]


def test_other_weights_give_other_orders(tmp_path):
    results = pinned(tmp_path)
    sharp = {"ssim": 0.2, "psnr": 0.2, "fid": 0.7, "kid": 0.7, "pose_error_mm": 0.7}
    alike = {"ssim": 0.9, "psnr": 0.9, "fid": 0.4, "kid": 0.4, "pose_error_mm": 0.6}
    for name, quality in (("sharp", sharp), ("alike", alike)):
        generator(tmp_path / "new", name, quality, seed=1)
    collect([tmp_path / "new"], results, tmp_path, "b")
    words = ["study", "weightings", "b", "--results", str(results)]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["generators"]
    assert {name: row["places"] for name, row in rows.items()} == {
        "alike": {"score": 1, "likeness": 1, "distribution": 2, "median": 2, "mean of ranks": 2},
        "sharp": {"score": 2, "likeness": 2, "distribution": 1, "median": 1, "mean of ranks": 1},
    }
    shown = CliRunner().invoke(app, [*words, "--markdown", str(tmp_path / "w.md")])
    assert shown.exit_code == 0 and "| alike | 0.6" in (tmp_path / "w.md").read_text()
    (results / "b/board.json").unlink()
    again = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)["generators"]
    assert again == rows, "an unpinned board takes its own anchors"


def test_the_last_bits_of_a_sum_are_not_shown():
    # A score at its anchor is 0 by one processor and -1e-16 by another.
    metric = {"value": -1.02e-16, "low": -0.0004, "high": 0.0474}
    assert figure_text(metric, Column("score", "Score", "higher")) == "0.000 (-0.000 – 0.047)"
    assert steady(0.26313544949272627) == steady(0.26313544949272633) == 0.263135449
