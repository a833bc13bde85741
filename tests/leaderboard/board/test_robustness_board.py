"""Robustness on a board: a report handed in, pinned, looked into, shown, ranking nothing."""

import copy
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.studies.robustness.disturbances import DISTURBANCES
from racines_envs.studies.robustness.run import RobustnessConfig, evaluate_robustness
from racines_leaderboard.audit.leaves import leaves
from racines_leaderboard.board import robustness
from racines_leaderboard.board.collect import collect, read_board
from racines_leaderboard.board.rank import metric_of, rankings
from racines_leaderboard.board.table import board_tables
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import PATIENT_AGENTS, TRACK
from racines_leaderboard.submissions.document import find_submission, read_document
from racines_leaderboard.submissions.intake import take_in
from tests.conftest import ROOT
from tests.leaderboard.called import racines
from tests.leaderboard.conftest import artefact, write_submission

SETTINGS = {
    "board": "mini",
    "patient_boards": ["patients", "beating"],
    "seed": 0,
    "evaluation_patients": {"split": "validation", "patients": 2, "starts": 1},
}
TWO = {name: DISTURBANCES[name] for name in ("haze", "slip")}
RESULTS, SCORES = Path("leaderboard/results"), Path("envs/runs/scores")
SUBMISSIONS = Path("leaderboard/submissions")
KEPT = RESULTS / "patients/robustness/planner-a4c.json"
ROW = RESULTS / "patients/patient-agents/planner-a4c.json"
Change = Callable[[dict[str, Any]], Any]


@pytest.fixture(scope="module")
def made(made_once) -> Path:
    """A workplace with the scores of the planner, and its robustness report in `report.json`."""
    return made_once("robustness-board", make_board)


def make_board(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("params.yaml").write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
        shutil.copytree(ROOT / "leaderboard/submissions", SUBMISSIONS)
        racines("eval", "agent", "planner", "--view", "A4C", "--tier", "patients")
        config = RobustnessConfig(patients=2, disturbances=tuple(TWO))
        evaluate_robustness("planner", folder, config, folder / "report.json")


@pytest.fixture
def work(made, tmp_path, monkeypatch) -> Path:
    """A copy of the workplace, where two disturbances on two patients are all that is asked for."""
    shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setattr(robustness, "DISTURBANCES", TWO)
    monkeypatch.setattr(robustness, "FEWEST", 2)
    return tmp_path / "work"


def hand_in(change: Change = lambda _: None) -> Path:
    """Put a report, changed, into the planner's submission; return where it lies."""
    document = read_document(SUBMISSIONS / "patient-agents/planner/submission.yaml")
    report = json.loads(Path("report.json").read_text(encoding="utf-8"))
    change(report)
    path = SUBMISSIONS / "patient-agents/planner/a4c.json"
    path.write_text(json.dumps(report))
    about = {key: document[key] for key in document if key != "artefacts"}
    write_submission(path.parent, *document["artefacts"], artefact("robustness", path), **about)
    return path


def gather() -> dict[str, Any]:
    """Collect the scores, and return the planner's row as it is read."""
    collect([SCORES], RESULTS, SUBMISSIONS, "patients", force=True)
    (row,) = read_board(RESULTS, "patients")["patient-agents"]
    return row


def test_a_report_is_a_column_that_names_its_patients_and_ranks_nothing(work):
    before = gather()
    assert metric_of(before, "disturbed_found") is None
    alone = rankings(PATIENT_AGENTS, [before])
    hand_in()
    row = gather()
    metric = metric_of(row, "disturbed_found")
    assert metric is not None and metric["n"] == 2
    found = json.loads(Path("report.json").read_text(encoding="utf-8"))["conditions"]
    shares = [found[f"{name}, moderate"]["metrics"]["success_declared"]["value"] for name in TWO]
    assert metric["value"] == pytest.approx(sum(shares) / 2)
    assert "disturbed_found" not in row["scores"]["metrics"], "scores say nothing of it"
    assert "disturbed_found" not in PATIENT_AGENTS.ranked_by
    (ranked,) = rankings(PATIENT_AGENTS, [row])
    assert ranked.place == alone[0].place and ranked.standing == alone[0].standing
    table = board_tables("patients", read_board(RESULTS, "patients"))[0]
    assert "Disturbed, validation patients (%) ↑" in table.head
    notes = " ".join(table.notes)
    assert "2 disturbances at moderate strength, on 2 validation patients" in notes
    shown = json.loads(racines("leaderboard", "--board", "patients", "--json"))
    (told,) = shown["boards"]["patients"]["patient-agents"]
    assert told["robustness"]["metrics"]["disturbed_found"] == metric


def test_a_report_that_is_withdrawn_or_of_another_record_is_shown_no_more(work):
    plain = (SUBMISSIONS / "patient-agents/planner/submission.yaml").read_text()
    hand_in()
    gather()
    # Another record in its place, of a submission that does not name the report.
    record = json.loads(ROW.read_text())
    record["submission"]["artefacts"].pop()
    ROW.write_text(json.dumps(sealed(record)))
    (row,) = read_board(RESULTS, "patients")["patient-agents"]
    assert row["robustness_stale"] and "robustness" not in row
    table = board_tables(
        "patients",
        {track: [] for track in TRACK} | {"patient-agents": [row]},
    )[0]
    assert "or data, or no longer handed in (planner-a4c)." in " ".join(table.notes)
    (SUBMISSIONS / "patient-agents/planner/submission.yaml").write_text(plain)
    (SUBMISSIONS / "patient-agents/planner/a4c.json").unlink()
    assert "robustness" not in gather() and not KEPT.exists()


def _split(report: dict[str, Any]) -> None:
    report["task"]["start_set"]["split"] = "test"


def _patients(report: dict[str, Any]) -> None:
    report["patients"][1] = 10_007


def _amounts(report: dict[str, Any]) -> None:
    report["disturbances"]["haze"]["amounts"][1] = 1.0


def _without(report: dict[str, Any]) -> None:
    del report["conditions"]["slip, moderate"]


def _more(report: dict[str, Any]) -> None:
    easy = report["conditions"]["nothing"] | {"name": "ease", "strength": "moderate"}
    report["conditions"]["ease, moderate"] = easy


def _milder(report: dict[str, Any]) -> None:
    report["conditions"]["slip, moderate"]["amounts"]["slip"] = 0.0


def _another(report: dict[str, Any]) -> None:
    report["submission"] = "random"


def _fewer(report: dict[str, Any]) -> None:
    report["patients"].pop()


def _better(report: dict[str, Any]) -> None:
    report["conditions"]["slip, moderate"]["metrics"]["success_declared"]["value"] = 0.25


def _shorter(report: dict[str, Any]) -> None:
    report["conditions"]["haze, mild"]["found"] = [[1]]


def _weights(report: dict[str, Any]) -> None:
    report["weights"] = {"sha256": None, "files": {"policy.safetensors": "ab" * 32}}


def _world(report: dict[str, Any]) -> None:
    report["phantom"]["recipe_digest"] = "ab" * 32


def _one_heart(report: dict[str, Any]) -> None:
    report["task"]["view"] = "A4C"


def _unknown(report: dict[str, Any]) -> None:
    report["score"] = 1.0
    report["conditions"]["haze, mild"]["found"][0][0] = 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_split, "task.start_set: a board shows 2 or more validation patients"),
        (_patients, "patients: others, or other starts, than the start set's here"),
        (_amounts, "disturbances: other amounts than those here"),
        (_without, "conditions: without slip, moderate"),
        (_more, r"conditions\.ease, moderate: none of those here"),
        (_milder, r"conditions\.slip, moderate: none of those here, or of other amounts"),
        (_another, "submission: 'random', and the row is of 'planner'"),
        (_fewer, "patients: 1, and the start set has 2 patients"),
        (_better, r"conditions\.slip, moderate\.metrics\.success_declared: 0\.25, and its ep"),
        (_shorter, r"conditions\.haze, mild\.found: not of 1 trainings and 2 starts"),
        (_weights, "of other weights than the row planner-a4c: make it again"),
        (_world, "of another world of patients than the row planner-a4c"),
        (_one_heart, "task.view: 'A4C' is no task on patients"),
        (_unknown, r"conditions\.haze, mild\.found\.0\.0: 2 is not one of \[0, 1\]"),
    ],
)
def test_a_report_at_fault_is_refused_and_nothing_is_written(work, change, message):
    gather()
    before = ROW.read_text()
    path = hand_in(change)
    with pytest.raises(RacinesError, match=message) as refused:
        gather()
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)
    assert ROW.read_text() == before and not KEPT.exists()


def test_a_report_is_looked_into_when_it_is_handed_in(work):
    folder = Path("inbox")
    folder.mkdir()
    shutil.copy("report.json", folder / "a4c.json")
    about = {"name": "mine", "track": "patient-agents", "tier": "reproduced"}
    about |= {"dataset": {"source": "phantom", "version": "0.5.0"}}
    adapter = {"kind": "adapter", "adapter": "racines_envs.agents.planner:PlannerAgent"}

    def write() -> None:
        write_submission(folder, adapter, artefact("robustness", folder / "a4c.json"), **about)

    write()
    taken = take_in(folder, SUBMISSIONS)
    assert find_submission(SUBMISSIONS, "patient-agents", "mine") == taken.document
    report = json.loads(Path("report.json").read_text(encoding="utf-8"))
    _better(report)
    (folder / "a4c.json").write_text(json.dumps(report))
    about["name"] = "other"
    write()
    with pytest.raises(RacinesError, match="and its episodes say"):
        take_in(folder, SUBMISSIONS)
    about["track"] = "agents"
    write()
    with pytest.raises(RacinesError, match="robustness is none of agents"):
        take_in(folder, SUBMISSIONS)


def test_two_reports_of_one_task_are_refused(work):
    path = hand_in()
    second = path.with_name("again.json")
    second.write_text(path.read_text() + "\n")
    document = read_document(path.with_name("submission.yaml"))
    about = {key: document[key] for key in document if key != "artefacts"}
    write_submission(path.parent, *document["artefacts"], artefact("robustness", second), **about)
    with pytest.raises(RacinesError, match=r"again\.json: a second robustness report of A4C-pat"):
        gather()


def test_an_audit_makes_what_is_shown_again_leaf_by_leaf(work):
    hand_in()
    gather()
    words = ("audit", "planner-a4c", "--board", "patients", "--quick", "--json")

    def subjects() -> dict[str, str]:
        (report,) = json.loads(CliRunner().invoke(app, words).stdout)["reports"]
        return {each["subject"]: each["verdict"] for each in report["verdicts"]}

    told = subjects()
    assert told["robustness"] == "holds" and told["robustness.report"] == "informative"
    kept = json.loads(KEPT.read_text())
    places = [place for place, _ in leaves(kept)]
    assert "metrics.disturbed_found.value" in places
    for place in places:
        changed = copy.deepcopy(kept)
        node, keys = changed, place.split(".")
        for key in keys[:-1]:
            node = node[int(key) if isinstance(node, list) else key]
        last = int(keys[-1]) if isinstance(node, list) else keys[-1]
        value = node[last]
        node[last] = f"{value}x" if isinstance(value, str) else (value or 0) / 2 + 0.125
        KEPT.write_text(json.dumps(changed))
        assert subjects()["robustness"] == "does not hold", place
    KEPT.unlink()
    assert subjects()["robustness"] == "does not hold", "left out"
