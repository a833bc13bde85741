"""Sittings of the expert study: names and codes, answers, two windows, the end."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.expert.ratings import read_all
from racines_leaderboard.studio import labelling
from racines_leaderboard.studio.labelling import (
    KINDS,
    Sitting,
    answer,
    begin,
    finished_html,
    image_html,
)
from tests.leaderboard.expert_kit import kit_of

TRIAL, EXPERT = KINDS


@pytest.fixture
def kits(tmp_path: Path) -> Path:
    kit_of(tmp_path, images=6, repeats=1)
    return tmp_path


def started(kits: Path, name: str = "anna", kind: str = TRIAL, about: str = "", code: str = ""):
    return begin(kits, "kit", name, kind, about, code)


def finish(sitting: Sitting) -> Sitting:
    while sitting.image is not None:
        sitting = answer(sitting, "SC", 7)
    return sitting


def test_a_finished_study_is_what_the_command_scores(kits: Path):
    sitting = finish(started(kits, kind=EXPERT, about="sonographer, 12 years"))
    kit = Kit.open(kits / "kit")
    (ratings,) = read_all([kits / "kit-ratings" / "anna.jsonl"], kit)
    assert (ratings.kind, ratings.about) == ("expert", "sonographer, 12 years")
    assert len(ratings.answers) == sitting.done == sitting.total == 7
    assert "kit-ratings/anna.jsonl" in finished_html(sitting)
    assert image_html(sitting) == ""


def test_a_name_goes_on_with_its_code_alone(kits: Path):
    first = answer(started(kits, kind=EXPERT, about="nurse"), "SC", 7)
    for wrong in ("", "aaaa-bbbb-cccc", first.code[:-1]):
        with pytest.raises(RacinesError, match="anna: "):
            started(kits, code=wrong)
    again = started(kits, code=f" {first.code.upper()} ")
    assert (again.done, again.kind, again.about) == (1, "expert", "nurse")
    assert finish(again).done == 7


def test_of_many_who_begin_at_once_under_one_name_one_gets_it(kits: Path):
    def attempt(_: int) -> str | None:
        try:
            return started(kits).code
        except RacinesError:
            return None

    with ThreadPoolExecutor(8) as pool:
        codes = [code for code in pool.map(attempt, range(16)) if code]
    assert len(codes) == 1
    assert sorted(path.name for path in (kits / "kit-ratings").iterdir()) == ["anna.code"]


def test_ratings_that_no_page_began_are_nobodys_to_go_on(kits: Path):
    (kits / "kit-ratings").mkdir()
    (kits / "kit-ratings" / "anna.jsonl").write_text("")
    with pytest.raises(RacinesError, match="is taken"):
        started(kits)


def test_the_code_is_not_on_the_disk(kits: Path):
    code = started(kits).code
    kept = (kits / "kit-ratings" / "anna.code").read_text()
    assert code not in kept and code.replace("-", "") not in kept


def test_two_windows_of_a_rater_never_answer_an_image_twice(kits: Path):
    one = started(kits)
    other = started(kits, code=one.code)
    assert one.image == other.image
    one = answer(one, "SC", 7)
    other = answer(other, "PL", 2)
    assert other.image == one.image and other.done == 1
    text = (kits / "kit-ratings" / "anna.jsonl").read_text()
    assert text.count("\n") == 1 and '"SC"' in text


def test_no_view_needs_no_grade(kits: Path):
    answer(started(kits), "Random", None)
    assert '"grade": 0' in (kits / "kit-ratings" / "anna.jsonl").read_text()


@pytest.mark.parametrize(
    ("view", "grade"),
    [
        (None, 5), ("SC", None), ("SC", 0), ("SC", 11), ("SC", 2.5), ("SC", float("nan")),
        ("SC", "7"), ("sc", 7), ("<b>", 7), (["SC"], 7), ("SC", True),
    ],
)  # fmt: skip
def test_answers_at_fault_are_refused_and_not_written(kits: Path, view, grade):
    sitting = started(kits)
    with pytest.raises(RacinesError):
        answer(sitting, view, grade)
    assert not (kits / "kit-ratings" / "anna.jsonl").exists()


@pytest.mark.parametrize(
    "fields",
    [
        {"name": "<script>alert(1)</script>"}, {"name": "../anna"}, {"name": ""},
        {"name": "Anna"}, {"name": "a" * 33}, {"name": "oracle"}, {"name": None},
        {"about": "<img src=x onerror=alert(1)>"}, {"about": "x" * 201}, {"kind": "oracle"},
        {"code": "<b>"}, {"code": "x" * 41}, {"code": None},
    ],
)  # fmt: skip
def test_fields_at_fault_are_refused_and_take_no_name(kits: Path, fields):
    with pytest.raises(RacinesError):
        started(kits, **fields)
    assert not (kits / "kit-ratings").exists()


@pytest.mark.parametrize("kit", ["..", "/etc", "absent", None, "kit/../kit"])
def test_only_kits_of_the_folder_are_opened(kits: Path, kit):
    with pytest.raises(RacinesError, match="was not offered"):
        begin(kits, kit, "anna", TRIAL, "")


def test_where_there_are_no_kits(tmp_path: Path):
    assert labelling.kits(None) == labelling.kits(tmp_path / "absent") == []
