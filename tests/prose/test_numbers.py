"""Figures in prose come from result files, and what has no marker is declared."""

import dataclasses
import json
import shutil
import subprocess
from functools import partial
from pathlib import Path

import pytest

from racines_data.escape import visible
from racines_data.sources.base import SOURCES
from tests.data.test_escape import rendered
from tests.prose import claims, markers
from tests.prose.markers import MARKER, PLACES, ROOT, NoFigure, evaluate, redraw, redrawn

PAGES = markers.pages()
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
FIGURES = {
    "schema": "racines.figures/1",
    "source": "measured once",
    "figures": {"seconds": 12.34, "n": 21438, "share": {"value": 0.9633, "low": 0.94, "high": 1}},
    "tables": {"t": {"columns": ["a", "b"], "right": 1, "rows": [["`x`", "1 %"], ["y", "2"]]}},
}


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with one page and two result files."""
    for folder in ("docs/results", "data", "models", "envs", "leaderboard"):
        (tmp_path / folder).mkdir(parents=True)
    for page in ("README", "CHANGELOG", "CONTRIBUTING", "data/README", "models/README"):
        (tmp_path / f"{page}.md").write_text("")
    for page in ("envs/README", "leaderboard/README"):
        (tmp_path / f"{page}.md").write_text("")
    (tmp_path / "docs/results/study.json").write_text(json.dumps(FIGURES))
    other = FIGURES | {"figures": {"seconds": 20, "none": None}}
    (tmp_path / "docs/results/studied.json").write_text(json.dumps(other))
    markers._document.cache_clear()
    return tmp_path


def draw(template: str, root: Path) -> str:
    page = redrawn(f"It took <!--n {template}-->?<!--/n--> so.\n", "page.md", root)
    return MARKER.search(page)["drawn"]  # type: ignore[index]


@pytest.mark.parametrize(
    ("template", "shown"),
    [
        ("{results/study#seconds:.1f}", "12.3"),
        ("{results/study#n:,}", "21,438"),
        ("{results/study#share:%.1f}", "96.3"),
        ("{results/study#share:%.1f % (–)}", "96.3 % (94.0–100.0)"),
        ("{results/study#share:.2f ( to )}", "0.96 (0.94 to 1.00)"),
        ("{results/study#share.low * 10:.0f} of 10", "9 of 10"),
        ("{results/studied#seconds - results/study#seconds:.2f}", "7.66"),
        ("{max(results/study,studied#seconds)}", "20"),
        ("{median(results/stud*#seconds):.2f}", "16.17"),
        ("{len(results/study#tables.*.columns)}", "2"),
        ("{results/studied#none:.1f}", "–"),
        ("{python/racines_data.imaging#IMAGE_SIZE}", "128"),
    ],
)
def test_a_template_draws_what_the_files_say(repository: Path, template: str, shown: str):
    assert draw(template, repository) == shown


def test_a_block_draws_a_row_an_item_and_a_table_as_it_is_kept(repository: Path):
    rows = "| run | s |\n| --- | --- |\nfor name unit in study:s studied:`s`\n"
    page = f"<!--n\n{rows}| $name | {{results/$name#seconds:.0f}} $unit |\n-->\n\nx\n\n<!--/n-->\n"
    page += "\n<!--n\ntable results/study#t\n-->\n\n<!--/n-->\n"
    new = redrawn(page, "page.md", repository)
    assert "| study | 12 s |\n| studied | 20 `s` |" in new and "\nx\n" not in new
    assert "| a | b |\n| --- | ---: |\n| `x` | 1 % |\n| y | 2 |" in new
    assert redrawn(new, "page.md", repository) == new


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a <!--n {results/gone#x}--><!--/n-->", "page.md:2: results/gone#x: no result file"),
        ("a <!--n {results/study#gone:.1f}--><!--/n-->", "nothing at 'gone'"),
        ("a <!--n {results/g*#x}--><!--/n-->", "no result file"),
        ("a <!--n {elsewhere/study#x}--><!--/n-->", "no place 'elsewhere'"),
        ("a <!--n {results/study#seconds:.1q}--><!--/n-->", "as '.1q'"),
        ("a <!--n {__import__('os').getcwd()}--><!--/n-->", "no expression over figures"),
        ("a <!--n {().__class__}--><!--/n-->", "no expression over figures"),
        ("a <!--n {results/study#tables / 2}--><!--/n-->", "unsupported operand"),
        ("a <!--n {1 / 0}--><!--/n-->", "division"),
        ("a <!--n {1 +}--><!--/n-->", "invalid syntax"),
        ("a <!--n {max(results/study,studied#seconds) * 1:.1f (–)}--><!--/n-->", "not one metric"),
        ("a <!--assert results/study#seconds > 13-->", "page.md:2: no longer true"),
        ("a <!--assert results/study#seconds-->", "no longer true"),
        ("<!--n {1}-->1<!--/n--> begins", "begins a line"),
        ("- <!--n {1}-->1<!--/n--> begins", "begins a line"),
        ("a <!--n {1}-->1", "without its end"),
        ("a 1<!--/n-->", "without its end"),
    ],
)
def test_what_cannot_be_drawn_or_does_not_hold_is_told(repository: Path, text: str, told: str):
    with pytest.raises(NoFigure, match="page.md") as caught:
        redrawn(f"\n{text}\n", "page.md", repository)
    assert told in str(caught.value) and "Traceback" not in str(caught.value)


def test_a_changed_result_is_a_changed_page(repository: Path):
    page = repository / "docs/page.md"
    text = "It took <!--n {results/study#seconds:.1f}-->12.3<!--/n--> s.\n"
    page.write_text(text)
    assert redraw(repository) == [] and page.read_text() == text
    content = FIGURES | {"figures": {"seconds": 13.0}}
    (repository / "docs/results/study.json").write_text(json.dumps(content))
    markers._document.cache_clear()
    assert redraw(repository) == [page] and ">13.0<" in page.read_text()
    (repository / "README.md").write_text("a <!--n {results/gone#x}-->1<!--/n-->\n")
    shutil.move(repository / "docs/results/study.json", repository / "docs/results/lost.json")
    markers._document.cache_clear()
    with pytest.raises(NoFigure, match=r"(?s)README.*docs/page"):
        redraw(repository)


def changed(page: Path, root: Path) -> str:
    """Return what a page says otherwise than the results of a repository; empty if nothing."""
    text, name = page.read_text(encoding="utf-8"), str(page.relative_to(ROOT))
    try:
        new = redrawn(text, name, root)
    except NoFigure as error:
        return str(error)
    return "; ".join(
        f"{old['drawn'].strip()} is now {now['drawn'].strip()}"
        for old, now in zip(MARKER.finditer(text), MARKER.finditer(new), strict=True)
        if old["drawn"] != now["drawn"]
    )


@pytest.fixture(scope="session")
def staged(tmp_path_factory) -> Path | None:
    """The results that Git holds, where `make repro` has put others in their place; or None."""
    made = ("leaderboard/results", "leaderboard/LEADERBOARD.md", "envs/runs", "models/runs")
    git = partial(subprocess.run, cwd=ROOT, capture_output=True)
    if git(["git", "diff", "--quiet", "--", *made]).returncode != 1:
        return None
    files = git(["git", "ls-files", "-z", "*.json", "*.yaml", "leaderboard/results"]).stdout
    root = tmp_path_factory.mktemp("staged")
    git(["git", "checkout-index", "-z", "--stdin", f"--prefix={root}/"], input=files, check=True)
    return root


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_page_says_what_the_result_files_say(page: Path, staged: Path | None):
    """If this fails after a result changed: `make docs-numbers`.

    Whoever has run `make repro` has other results in places, on another processor: there it holds
    the page to those that Git holds, until they are staged.
    """
    told = changed(page, ROOT)
    if told and staged is not None:
        told = changed(page, staged)
    assert not told, f"draw anew by `make docs-numbers`: {told}"


def test_results_of_a_run_of_ones_own_are_not_the_pages(staged, tmp_path):
    """A page differs from made-up results, and from none of those that stand in its repository."""
    page = ROOT / "docs/generators.md"
    assert not changed(page, staged or ROOT)
    for kind in ("*.json", "*.yaml"):
        for path in [*(ROOT / "docs").rglob(kind), *(ROOT / "leaderboard").rglob(kind)]:
            copy = tmp_path / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
    for path in (tmp_path / "leaderboard/results/phantom-reference").rglob("*.json"):
        path.write_text(path.read_text("utf-8").replace('"value": 0.', '"value": 0.9'), "utf-8")
    markers._document.cache_clear()
    assert changed(page, tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_number_is_marked_or_declared(page: Path):
    """A measured number gets a marker (see markers.py); a constant stands in allowed.yaml."""
    name = str(page.relative_to(ROOT))
    found, stale = claims.unmarked(name, page.read_text(encoding="utf-8"))
    told = [f"{name}:{claim.line}: {claim.text!r} in {claim.context.strip()!r}" for claim in found]
    assert not told, "no marker, and not in tests/prose/allowed.yaml:\n" + "\n".join(told)
    assert not stale, "\n".join(stale)


@pytest.mark.parametrize(
    "line",
    [
        "It succeeds from 96.3 % of the starts.",
        "A batch takes 38 ms.",
        "SSIM rises to 0.75 there.",
        "It is off by 2.5 mm and 3.7°.",
        "From 93.7 to 96.7 % of the starts.",
        "| flow | 0.860 |",
        "The suite has 2,041 tests.",
        "It draws 1,696 images/s, 3 times as many.",
        "12 of 40 succeed.",
    ],
)
def test_a_new_claim_without_a_marker_is_found(line: str):
    page = ROOT / "docs" / "index.md"
    found, _ = claims.unmarked("docs/index.md", page.read_text() + f"\n{line}\n")
    assert found and found[0].context == line


def test_what_a_source_says_on_a_card_has_no_number_of_its_own():
    """Its figures are the manifest's, which the build counts; the sources' texts have none."""
    for source in ("phantom", "release", "cactus", "tracked"):
        for field, text in dataclasses.asdict(SOURCES.load(source).card).items():
            assert not claims.claims(str(text)), (source, field)


def test_what_is_no_claim_is_left_alone():
    text = "`0.5 mm`\n\n    takes 3 s\n\n```text\n4 %\n```\n[a](b-1.5.md) phantom 1.0.0\n"
    text += "95 % intervals\n"
    assert not claims.claims(text + "It took <!--n {1}-->1.5<!--/n--> s, SHA-256, 3-D, in 2019.\n")


def test_an_allowance_covers_its_own_words_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    allowed = tmp_path / "allowed.yaml"
    allowed.write_text("p.md: {constant: ['limit of 5 mm', '## Limits', gone], wish: [a]}\n")
    monkeypatch.setattr(claims, "ALLOWED", allowed)
    text = "A limit of\n5 mm a; a limit of 15 mm.\n\n## Limits\n\n7 s\n\n## Results\n\n8 s\n"
    found, stale = claims.unmarked("p.md", text)
    assert [claim.text for claim in found] == ["15 mm", "8 s"]
    assert len(stale) == 2 and "'gone'" in stale[0] and "'wish'" in stale[1]


def test_every_result_file_has_a_use_and_says_where_it_is_from():
    used = " ".join(page.read_text() for page in PAGES)
    for path in sorted((ROOT / PLACES["results"].format(name="x")).parent.glob("*.json")):
        content = json.loads(path.read_text())
        assert content["schema"] == "racines.figures/1" and content["source"] == "measured once"
        assert content["what"] and content["command"] and content["machine"], path.name
        for key in (*content.get("figures", {}), *content.get("tables", {})):
            assert f"results/{path.stem}#{key}" in used or path.stem == "tasks", (
                f"{path.name}: {key}"
            )


def test_markers_are_seen_by_no_reader():
    """In paragraphs, lists and tables, for GitHub and for the documentation's tool."""
    figure = "<!--n {results/x#y:.1f % (–)}-->1.5 % (1.0–2.0)<!--/n-->"
    page = f"Here *a* {figure} `b`. <!--assert a/b#c < 2-->\n\n- one {figure}\n\n"
    page += f"| a | b |\n| --- | --- |\n| x {figure} | `y` |\n\n"
    page += "<!--n\n| c | d |\n-->\n\n| c | d |\n| --- | --- |\n| *e* | f |\n\n<!--/n-->\n\nend\n"
    for shown in rendered(page):
        assert [tag for tag in shown.tags if tag not in ("thead", "tbody")] == [
            *("p", "em", "code", "ul", "li"),
            *("table", "tr", "th", "th", "tr", "td", "td", "code"),
            *("table", "tr", "th", "th", "tr", "td", "em", "td", "p"),
        ]
        words = " ".join(visible(shown.text).split())
        assert words.startswith("Here a 1.5 % (1.0–2.0) b.") and words.endswith("end")
        assert "results" not in words and "assert" not in words


def test_an_expression_calculates_and_compares():
    assert evaluate("-(2 + 3) * 4 / 5 - round(1.26, 1)") == pytest.approx(-5.3)
    assert evaluate("1 < 2 <= 2 and abs(-3) == 3") is True and evaluate("1 > 2") is False
