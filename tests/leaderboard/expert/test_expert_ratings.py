import json

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.expert.ratings import Session, order_of, read_all, read_ratings
from tests.leaderboard.expert_kit import kit_of


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    return kit_of(tmp_path_factory.mktemp("study"))


def rate(session, count=None, view="SC", grade=5):
    while count != 0 and (image := session.next_image()) is not None:
        session.save(image, view, grade, 1.5)
        count = None if count is None else count - 1
    return session.path


def test_a_session_goes_through_all_images_and_resumes(kit, tmp_path):
    session = Session.open(kit.folder, tmp_path, "anna", about="sonographer")
    rate(session, 7)
    assert session.progress().done == 7 and session.progress().total == 72
    again = Session.open(kit, tmp_path, "anna", about="sonographer")
    assert again.order == session.order and again.next_image() == session.next_image()
    rate(again)
    assert again.next_image() is None and again.progress().done == 72
    told = read_ratings(again.path, kit)
    assert list(told.answers) == session.order
    assert (told.rater, told.kind, told.about) == ("anna", "expert", "sonographer")
    assert {answer.seconds for answer in told.answers.values()} == {1.5}


def test_raters_have_files_and_orders_of_their_own(kit, tmp_path):
    anna, ben = (Session.open(kit, tmp_path, name) for name in ("anna", "ben"))
    rate(anna, 3)
    assert ben.progress().done == 0 and not ben.path.exists()
    assert anna.order != ben.order and sorted(anna.order) == sorted(ben.order) == kit.images
    assert order_of(kit, "anna", 1) != anna.order


def test_repeats_stand_far_apart_in_every_order(kit):
    twins = [(e["repeat_of"], n) for n, e in kit.read_key()["images"].items() if e["repeat_of"]]
    starts = set()
    for name in "abcdefgh":
        place = {image: i for i, image in enumerate(order_of(kit, name))}
        assert min(abs(place[a] - place[b]) for a, b in twins) > len(kit.images) // 3
        starts.add(kit.blocks[0].count(order_of(kit, name)[0]))
    assert starts == {0, 1}, "some begin with the last block"


def test_an_answer_that_a_crash_cut_off_is_asked_again(kit, tmp_path):
    session = Session.open(kit, tmp_path, "anna")
    path = rate(session, 3)
    whole = path.read_bytes()
    path.write_bytes(whole[:-9])
    again = Session.open(kit, tmp_path, "anna")
    assert again.progress().done == 2
    assert len(read_ratings(path, kit).answers) == 2
    again.save(again.next_image(), "PL", 9)
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    assert [line["view"] for line in lines] == ["SC", "SC", "PL"]


def test_two_windows_of_one_rater_do_not_answer_twice(kit, tmp_path):
    one, two = (Session.open(kit, tmp_path, "anna") for _ in range(2))
    image = one.next_image()
    one.save(image, "SC", 5)
    with pytest.raises(RacinesError, match=f"image {image} has an answer already"):
        two.save(image, "PL", 5)
    assert two.next_image() == one.next_image() != image
    assert len(one.path.read_text().splitlines()) == 1


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (("9999", "SC", 5), "'9999' is not of this kit"),
        ((None, "XX", 5), "view 'XX' is none of A4C"),
        ((None, "SC", 0), "graded 1 to 10"),
        ((None, "SC", 11), "graded 1 to 10"),
        ((None, "SC", 5.5), "whole number"),
        ((None, "SC", "5"), "whole number"),
        ((None, "Random", 3), "Random is graded 0"),
        ((None, "SC", 5, -1.0), "give a time"),
        ((None, "SC", 5, float("nan")), "give a time"),
    ],
)
def test_answers_off_the_scale_are_refused_and_nothing_is_written(kit, tmp_path, answer, message):
    session = Session.open(kit, tmp_path, "anna")
    image, *rest = answer
    with pytest.raises(RacinesError, match=message):
        session.save(image or session.next_image(), *rest)
    assert not session.path.exists()


@pytest.mark.parametrize(
    ("rater", "kind"),
    [
        ("../anna", "expert"),
        ("Anna", "expert"),
        ("", "expert"),
        ("a" * 33, "expert"),
        ("oracle", "expert"),
        ("simulated-3", "expert"),
        ("anna", "professor"),
    ],
)
def test_names_that_mislead_or_leave_the_folder_are_refused(kit, tmp_path, rater, kind):
    with pytest.raises(RacinesError, match="rater"):
        Session.open(kit, tmp_path, rater, kind)


def test_a_session_keeps_its_kind_and_kit(kit, tmp_path):
    rate(Session.open(kit, tmp_path, "anna", "trial"), 1)
    with pytest.raises(RacinesError, match="kind 'trial', not 'expert'"):
        Session.open(kit, tmp_path, "anna")
    other = kit_of(tmp_path, seed=9)
    with pytest.raises(RacinesError, match="ratings of another kit"):
        Session.open(other, tmp_path, "anna", "trial")


DAMAGE = [
    ({"kit": "00" * 32}, "line 2: kit 000000000000"),
    ({"image": "9999"}, "line 2: image '9999' is not of this kit"),
    ({"view": "XX"}, "line 2: image .*: view 'XX'"),
    ({"grade": 11}, "line 2: image .*: grade 11"),
    ({"grade": "good"}, "line 2: grade"),
    ({"rater": "ben"}, "line 2: rater 'ben', but line 1 has 'anna'"),
    ({"seconds": float("inf")}, "line 2: seconds"),
    ({"extra": 1}, "line 2: .*extra"),
]


@pytest.mark.parametrize(("change", "message"), DAMAGE, ids=[next(iter(c)) for c, _ in DAMAGE])
def test_faults_of_a_file_are_named_by_line(kit, tmp_path, change, message):
    path = rate(Session.open(kit, tmp_path, "anna"), 3)
    lines = path.read_text().splitlines()
    lines[1] = json.dumps(json.loads(lines[1]) | change)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RacinesError, match=rf"anna\.jsonl: {message}"):
        read_ratings(path, kit)


def test_all_faults_are_named_at_once(kit, tmp_path):
    path = rate(Session.open(kit, tmp_path, "anna"), 3)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[0], lines[2]]) + "\n")
    with pytest.raises(RacinesError, match=r"line 4: image .* second time; line 5: image"):
        read_ratings(path, kit)
    path.write_text("{\n" + "\n".join(lines) + "\n[]\n")
    with pytest.raises(RacinesError, match=r"line 1: not JSON.*; line 5: "):
        read_ratings(path, kit)


def test_files_that_do_not_go_together_are_refused(kit, tmp_path):
    anna = rate(Session.open(kit, tmp_path, "anna"))
    ben = rate(Session.open(kit, tmp_path, "ben"), 70)
    trial = rate(Session.open(kit, tmp_path, "cleo", "trial"))
    with pytest.raises(RacinesError, match=r"ben\.jsonl: 2 of 72 images not rated: \d{4}, \d{4};"):
        read_all([anna, ben], kit)
    assert len(read_all([anna, ben], kit, partial=True)) == 2
    with pytest.raises(RacinesError, match="anna has two files"):
        read_all([anna, anna], kit)
    with pytest.raises(RacinesError, match="expert and trial raters"):
        read_all([anna, trial], kit)
    with pytest.raises(RacinesError, match="no ratings"):
        read_all([], kit)
    with pytest.raises(RacinesError, match="not readable"):
        read_all([tmp_path / "absent.jsonl"], kit)
