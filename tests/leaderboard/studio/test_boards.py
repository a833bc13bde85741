"""The boards as the Studio shows them: filters, intervals, charts, provenance."""

import dataclasses
import json
import shutil

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import boards
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import TIERS
from racines_leaderboard.studio.boards import (
    Selection,
    charts_html,
    held,
    names,
    provenance_html,
    record_of,
    selected,
    tables_html,
    track_held,
)
from racines_leaderboard.studio.parts import Place

GENERATORS = Selection("tiny", "generators")
AGENTS = Selection("tiny", "agents")


def test_tables_have_intervals_and_the_papers_figures(place: Place):
    shown = tables_html(place.results, GENERATORS)
    assert '0.900<span class="rc-between">0.800 – 1.000</span>' in shown
    assert "reported in the paper, on other data" in shown
    assert names(place.results, GENERATORS) == ["mine", "other"]


def test_details_add_a_table(place: Place):
    further = dataclasses.replace(GENERATORS, details=True)
    assert "MS-SSIM" in tables_html(place.results, further)
    assert "MS-SSIM" not in tables_html(place.results, GENERATORS)
    assert charts_html(place.results, further).count("<img") == (
        charts_html(place.results, GENERATORS).count("<img") + 1
    )


@pytest.mark.parametrize(
    ("view", "sees", "left"),
    [
        ("all", "all", {"sc-image", "sc-params", "pl-image"}),
        ("SC", "all", {"sc-image", "sc-params"}),
        ("all", "the image", {"sc-image", "pl-image"}),
        ("SC", "the pose", {"sc-params"}),
        ("PL", "the pose", set()),
    ],
)
def test_agents_are_filtered_by_view_and_by_what_they_see(place: Place, view, sees, left):
    wanted = dataclasses.replace(AGENTS, view=view, sees=sees)
    assert set(names(place.results, wanted)) == left
    assert ("No result fits" in tables_html(place.results, wanted)) == (not left)


def test_a_tier_that_nobody_reached_leaves_nothing(place: Place):
    assert not names(place.results, dataclasses.replace(GENERATORS, tiers=("reproduced",)))


@pytest.mark.parametrize(
    "values",
    [
        ("../tiny", "generators", "all", "all", list(TIERS), False),
        ("tiny", "expert", "all", "all", list(TIERS), False),
        ("tiny", "agents", "all", "the truth", list(TIERS), False),
        ("tiny", "agents", "all", "all", ["gold"], False),
        (None, "agents", "all", "all", [], False),
    ],
)
def test_what_was_not_offered_is_refused(place: Place, values):
    with pytest.raises(RacinesError):
        selected(place.results, *values)


def test_provenance_escapes_what_submitters_wrote(place: Place):
    shown = provenance_html(record_of(place.results, GENERATORS, "mine"))
    assert "&lt;script&gt;" in shown and "<script" not in shown and "<img" not in shown
    assert "recipe_digest" in shown and "python 3.11.7" in shown
    with pytest.raises(RacinesError, match="was not offered"):
        record_of(place.results, GENERATORS, "sc-image")


def test_tables_escape_methods(place: Place):
    shown = tables_html(place.results, GENERATORS)
    assert "&lt;script&gt;" in shown and "<script" not in shown and "<img" not in shown


def test_a_new_result_shows_without_a_restart(place: Place, tmp_path):
    results = tmp_path / "results"
    shutil.copytree(place.results, results)
    assert names(results, GENERATORS) == ["mine", "other"]
    (results / "tiny" / "generators" / "other.json").unlink()
    assert names(results, GENERATORS) == ["mine"]


@pytest.fixture
def two_boards(place: Place, tmp_path) -> Place:
    """A board with both tracks, and one that has agents alone."""
    results = tmp_path / "results"
    shutil.copytree(place.results / "tiny", results / "tiny")
    for path in (place.results / "tiny/agents").glob("*.json"):
        record = json.loads(path.read_text()) | {"board": "zoo"}
        kept = results / "zoo/agents" / path.name
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(sealed(record)))
    return dataclasses.replace(place, results=results)


def test_a_board_is_shown_by_a_track_that_it_has(two_boards: Place):
    results = two_boards.results
    assert held(results, "zoo") == ["agents"]
    assert track_held(results, "tiny") == track_held(results, "tiny", "patient-agents")
    assert track_held(results, "tiny", "agents") == "agents", "what was chosen stays, where it is"
    gradio = pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
    from racines_leaderboard.studio.tabs import leaderboards

    moved, kept = (
        leaderboards._track(two_boards, *b) for b in (("zoo", "generators"), ("tiny", "agents"))
    )
    assert moved.value == "agents" and [name for name, _ in moved.choices] == ["agents"]
    assert kept.value == "agents" and len(kept.choices) == 2
    with pytest.raises(RacinesError, match="was not offered"):
        leaderboards._track(two_boards, "zoo", "<script>")
    with gradio.Blocks() as page:
        leaderboards.build(two_boards)
    parts = {getattr(each, "label", None): each for each in page.blocks.values()}
    assert parts["Board"].value == "tiny" and parts["Track"].value == "generators"
    offered = [value for _, value in parts["Track"].choices]
    assert offered == ["generators", "agents"], "tracks that the board has"


def test_boards_on_patients_stand_first(tmp_path):
    for board in ("beating", "zoo", "patients", "anything"):
        (tmp_path / board / "agents").mkdir(parents=True)
        (tmp_path / board / "agents" / "x.json").write_text("{}")
    assert boards(tmp_path) == ["patients", "beating", "anything", "zoo"]
