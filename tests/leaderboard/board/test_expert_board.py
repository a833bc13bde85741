import copy
import json

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import boards, collect, read_board
from racines_leaderboard.board.table import board_tables, plain, titled_markdown
from racines_leaderboard.cli.command import app
from racines_leaderboard.expert import raters
from racines_leaderboard.expert.ratings import Session, read_all
from racines_leaderboard.expert.score import score
from racines_leaderboard.records.experts import publish
from tests.leaderboard.conftest import generator_scores
from tests.leaderboard.expert_kit import kit_of


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    return kit_of(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def reports(kit, tmp_path_factory):
    """The same answers, once by a program and once under a person's name."""
    folder = tmp_path_factory.mktemp("ratings")
    key = kit.read_key()
    machine = raters.simulate(kit, key, raters.Simulated(0.1), folder)
    answers = read_all([machine.path], kit)[0].answers
    person = Session.open(kit, folder, "anna")
    while (image := person.next_image()) is not None:
        person.save(image, answers[image].view, answers[image].grade, 2.0)
    return {
        session.kind: score(kit, key, read_all([session.path], kit), 20)
        for session in (machine, person)
    }


@pytest.fixture
def results(tmp_path, write_scores):
    scores = generator_scores("inverse")
    scores["weights"] = {"w": "12", "more": "34"}
    # A submission's own word for an expert's is no study.
    scores["metrics"]["expert_view"] = {"value": 1.0, "low": 0.9, "high": 1.0, "n": 9999}
    collect([write_scores("g", scores, generator_scores("other"))], tmp_path / "r", tmp_path, "b")
    return tmp_path / "r"


def test_experts_agreement_stands_beside_the_scores(results, reports):
    before = titled_markdown(board_tables("b", read_board(results, "b"))[0])
    assert "Expert" not in before and "9,999" not in before
    (path,) = publish(reports["expert"], results, "b")
    assert path == results / "b" / "expert" / "inverse.json" and boards(results) == ["b"]
    table = board_tables("b", read_board(results, "b"))[0]
    text = titled_markdown(table)
    assert "Expert, view (%) ↑" in text and "Expert, grade (%) ↑" in text
    metric = reports["expert"]["systems"]["inverse"]["references"]["oracle"]["metrics"]
    agreement = metric["view_agreement"]
    numbers = [f"{100 * agreement[k]:.1f}" for k in ("value", "low", "high")]
    assert f"{numbers[0]} ({numbers[1]} – {numbers[2]}), n = 30" in text
    assert "blinded study" in text and "does not rank" in text
    row = {name: cells for _, name, *cells in table.rows}
    place = table.head.index("Expert, view (%) ↑") - 2
    assert row["other"][place] == "–"
    document = plain(read_board(results, "b"))["generators"]
    assert {entry["name"]: "expert" in entry for entry in document} == {
        "inverse": True,
        "other": False,
    }


def test_what_programs_rate_never_gets_to_a_board(results, reports):
    with pytest.raises(RacinesError, match="no expert saw these images"):
        publish(reports["simulated"], results, "b")
    assert not (results / "b" / "expert").exists()
    (path,) = publish(reports["expert"], results, "b")
    path.write_text(path.read_text().replace('"kind": "expert"', '"kind": "simulated"'))
    with pytest.raises(RacinesError, match=r"inverse\.json: kind: 'expert' was expected"):
        read_board(results, "b")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r["dataset"].update(recipe_digest="99" * 32), "recipe 999999999999"),
        (lambda r: r["systems"]["inverse"].update(weights={"w": "99"}), "other weights"),
        (lambda r: r["systems"].update(nobody=r["systems"]["inverse"]), "no scores of nobody"),
        (lambda r: r["systems"].pop("inverse"), "no generator's images"),
    ],
)
def test_studies_of_something_else_are_refused(results, reports, change, message):
    report = copy.deepcopy(reports["expert"])
    change(report)
    with pytest.raises(RacinesError, match=message):
        publish(report, results, "b")
    assert not (results / "b" / "expert").exists()


def test_a_study_of_weights_that_were_replaced_is_left_out(results, reports):
    publish(reports["expert"], results, "b")
    path = results / "b" / "generators" / "inverse.json"
    record = json.loads(path.read_text())
    record["scores"]["weights"]["w"] = "99"
    path.write_text(json.dumps(record))
    text = titled_markdown(board_tables("b", read_board(results, "b"))[0])
    assert "Expert, view" not in text and "Left out: studies of other weights or data" in text


def test_a_study_in_anothers_place_is_refused(results, reports):
    (path,) = publish(reports["expert"], results, "b")
    path.rename(path.with_name("other.json"))
    with pytest.raises(RacinesError, match=r"other\.json: generator: 'inverse'"):
        read_board(results, "b")


def test_commands(kit, results, tmp_path):
    def run(*words, code=0):
        done = CliRunner().invoke(app, ["expert", *map(str, words)])
        assert done.exit_code == code, done.output
        return done

    ratings = tmp_path / "ratings"
    assert "not an expert's" in run("simulate", kit.folder, "--out", ratings).output, "an old name"
    run("rate", kit.folder, "--out", ratings)
    told = run("score", kit.folder, ratings / "simulated-0.jsonl", "--resamples", 20,
               "--out", tmp_path / "study")  # fmt: skip
    assert "view κ" in told.output and "no expert" in told.output
    assert (tmp_path / "study" / "report.png").stat().st_size > 10_000
    told = run("score", kit.folder, ratings / "simulated-0.jsonl", "--resamples", 20, "--json")
    written = json.loads((tmp_path / "study" / "report.json").read_text())
    assert json.loads(told.stdout) == written
    words = ("score", kit.folder, ratings / "simulated-0.jsonl", "--board", "b")
    refused = run(*words, "--results", results, code=1)
    assert isinstance(refused.exception, RacinesError) and "no expert" in str(refused.exception)
