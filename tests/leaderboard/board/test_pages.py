import dataclasses
import io
import re

import pytest
from PIL import Image
from rich.console import Console

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import collect, read_board
from racines_leaderboard.board.pages import BEGIN, END, with_tables, write_page
from racines_leaderboard.board.table import REPORTED, board_tables, plain, show, titled_markdown
from tests.leaderboard.conftest import DIGEST, agent_scores, generator_scores, write_submission


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
    assert tables[0].rows[0][:2] == ("1", "vae-gan")
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
    assert re.search(r"System +vae-gan +mean-image", out.getvalue())
    assert "(79.9–80.1)" in out.getvalue()


def test_plain_data_is_in_ranked_order(results):
    data = plain(read_board(results, "phantom-smoke"))
    assert [(r["rank"], r["name"]) for r in data["generators"]] == [
        (1, "vae-gan"),
        (2, "mean-image"),
    ]
    assert data["generators"][0]["metrics"]["fid"]["value"] == 80.0


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
