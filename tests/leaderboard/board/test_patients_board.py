"""Boards of patients: rows are collected, pinned, ranked and audited as those of the one heart."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
import torch
import yaml

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.patients.splits import split_of
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.evaluation.patients import PatientsConfig, StartSet, evaluate_patients
from racines_envs.worlds.making import patients_recipe
from racines_leaderboard.board import recompute as recomputing
from racines_leaderboard.board.belonging import board_of
from racines_leaderboard.board.collect import collect, read_board, read_scores
from racines_leaderboard.board.rank import rankings
from racines_leaderboard.board.recompute import Ground, recompute
from racines_leaderboard.board.standing import is_bound
from racines_leaderboard.fresh.draws import draw_in_secret, secret_starts
from racines_leaderboard.fresh.rounds import Secret, commit
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import PATIENT_AGENTS, TRACKS, track_of
from racines_leaderboard.studio.boards import Selection, tables_html
from racines_leaderboard.submissions import intake
from racines_leaderboard.submissions.probe import Probed
from tests.conftest import ROOT
from tests.leaderboard.called import racines
from tests.leaderboard.conftest import artefact, write_submission
from tests.leaderboard.graphs import lookup_policy, sound_policy
from tests.leaderboard.handed_in import Watched, inbox, submitted

SETTINGS = {
    "board": "mini",
    "patient_boards": ["patients", "beating"],
    "seed": 0,
    "patient_agents": {"constant-pose": {"patients": 3}},
    "evaluation_patients": {"split": "validation", "patients": 3, "starts": 2},
}
RESULTS, SCORES = Path("leaderboard/results"), Path("envs/runs/scores")
ROW = RESULTS / "patients/patient-agents/planner-a4c.json"


@pytest.fixture(scope="module")
def made(made_once) -> Path:
    """A workplace with a board of patients that holds its two anchors."""
    return made_once("patients-board", make_board)


def make_board(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("params.yaml").write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
        shutil.copytree(ROOT / "leaderboard/submissions", "leaderboard/submissions")
        racines("train", "agent", "constant-pose", "--json")
        for agent in ("constant-pose", "planner"):
            racines("eval", "agent", agent, "--view", "A4C", "--tier", "patients")
        racines("leaderboard", "--board", "patients", "--collect", str(SCORES))
        racines("board", "pin", "patients")


@pytest.fixture
def board(made, tmp_path, monkeypatch) -> Path:
    shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def test_anchors_stand_at_their_ends_and_without_a_place(board):
    (board / "params.yaml").write_text(yaml.safe_dump(SETTINGS))
    records = read_board(RESULTS, "patients")[PATIENT_AGENTS.name]
    scores = {each["name"]: each["standing"].score.value for each in records}
    assert scores == {"constant-pose-a4c": 0.0, "planner-a4c": 1.0}
    assert all(map(is_bound, records))
    ranked = rankings(PATIENT_AGENTS, records)
    assert [each.place for each in ranked] == [None, None]
    assert ranked[0].standing.units == 3, "patients"
    shown = racines("leaderboard", "--board", "patients")
    assert "A4C-patients" in shown and "Found and declared" in shown


def test_a_track_without_other_weights_or_papers_figures_is_shown_all_the_same(board):
    said = racines("study", "weightings", "patients")
    assert "each of its tasks ranks by one metric" in said
    tables = tables_html(RESULTS, Selection("patients", PATIENT_AGENTS.name))
    assert "planner-a4c" in tables and "Found and declared" in tables
    none = tables_html(RESULTS, Selection("patients", "generators"))
    assert "This board has no generators: choose patient-agents" in none


def test_steps_to_success_may_be_lacking_on_patients_alone(board):
    path = SCORES / "planner-a4c.json"
    scores = json.loads(path.read_text())
    assert "steps" not in scores["metrics"] and read_scores(path)
    path.write_text(json.dumps({key: scores[key] for key in scores if key != "by_pathology"}))
    with pytest.raises(RacinesError, match="steps|by_pathology"):
        read_scores(path)


def test_rows_are_those_of_the_boards_own_starts(board):
    racines("eval", "agent", "planner", "--view", "A4C", "--tier", "patients", "--starts", "1")
    other = SCORES / "planner-a4c-patients-validation.json"
    assert json.loads(other.read_text())["board"] == "patients"
    for path in SCORES.glob("*a4c.*"):
        path.unlink()
    with pytest.raises(RacinesError, match=r"task\.start_set: .*evaluate it from the board's"):
        collect([SCORES], RESULTS, Path("leaderboard/submissions"), "patients")


def test_an_audit_makes_every_number_again(board):
    said = json.loads(racines("audit", "--all", "--board", "patients", "--json"))
    verdicts = {each["name"]: each["verdict"] for each in said["reports"]}
    assert verdicts == {"constant-pose-a4c": "holds", "planner-a4c": "holds"}


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("metrics", "position_error_median", "value"), 0.001),
        (("by_pathology", "healthy", "success_declared", "low"), 0.0),
        (("task", "start_set", "digest"), "0" * 64),
        (("task", "split"), "train"),
        (("phantom", "version"), "0.0.1"),
    ],
)
def test_what_is_changed_afterwards_does_not_hold(board, place, value):
    record = json.loads(ROW.read_text())
    node = record["scores"]
    for key in place[:-1]:
        node = node[key]
    node[place[-1]] = value
    ROW.write_text(json.dumps(sealed(record)))
    said = json.loads(racines("audit", "planner-a4c", "--board", "patients", "--json", code=1))
    assert said["reports"][0]["verdict"] == "does not hold"


@pytest.mark.thorough
def test_what_an_agent_goes_by_is_pinned_by_its_hash(board):
    """The hill-climber climbs the opinion of the grader of patients."""
    guide = Path("models/weights/phantom-patients/grader")
    shutil.copytree(ROOT / guide, guide)
    racines("eval", "agent", "hill-climber", "--view", "A4C", "--tier", "patients")
    scores = json.loads((SCORES / "hill-climber-a4c.json").read_text())
    sha256 = sha256_file(guide / "grader.safetensors")
    assert {kind: each["sha256"] for kind, each in scores["extractors"].items()} == {
        "guide": sha256
    }
    assert "extractors" not in json.loads((SCORES / "planner-a4c.json").read_text())
    collect([SCORES], RESULTS, Path("leaderboard/submissions"), "patients")
    words = ("audit", "hill-climber-a4c", "--board", "patients", "--json")

    def told(code: int, *more: str) -> tuple[str, dict[str, str]]:
        (report,) = json.loads(racines(*words, *more, code=code))["reports"]
        return report["verdict"], {e["subject"]: e["verdict"] for e in report["verdicts"]}

    verdict, claims = told(0)
    assert verdict == "holds" and claims["extractors.guide"] == "holds"
    path = RESULTS / "patients/patient-agents/hill-climber-a4c.json"
    (SCORES / "hill-climber-a4c.json").unlink()  # which would tell that the record was changed
    record = json.loads(path.read_text())
    record["scores"]["extractors"]["guide"]["sha256"] = hashlib.sha256(b"another").hexdigest()
    path.write_text(json.dumps(sealed(record)))
    verdict, claims = told(3)
    assert verdict == "not verified" and claims["extractors.guide"] == "cannot be checked"
    assert claims["metrics.success_declared"] == "cannot be checked", "that grader is not here"
    del record["scores"]["extractors"]
    path.write_text(json.dumps(sealed(record)))
    assert told(1)[0] == "does not hold", "left out"


def test_a_track_is_told_by_whom_an_agent_scanned(board):
    scores, track = read_scores(SCORES / "planner-a4c.json")
    assert track is PATIENT_AGENTS and track_of(scores) is PATIENT_AGENTS
    scores["task"]["view"] = "A4C"
    assert track_of(scores) is TRACKS[1]
    assert track_of({"schema": "racines.generator-scores/1"}) is TRACKS[0]
    assert track_of({"schema": "racines.pictures/1"}) is None
    record = json.loads(ROW.read_text())
    record["scores"]["task"]["view"] = "A4C"
    ROW.write_text(json.dumps(sealed(record)))
    with pytest.raises(RacinesError, match=r"scores\.task\.view: 'A4C' is none of track patient"):
        read_board(RESULTS, "patients")


def test_a_run_with_a_submission_of_its_own_stands_under_it(board):
    """Another run of a method shares the method's, unless it has one by its own name."""
    mine, own = Path("mine"), Path("leaderboard/submissions/patient-agents/planner-mine")
    mine.mkdir()
    scores = json.loads((SCORES / "planner-a4c.json").read_text())
    scores["agent"], scores["evidence"]["file"] = "planner-mine-a4c", "planner-mine-a4c.parquet"
    (mine / "planner-mine-a4c.json").write_text(json.dumps(scores))
    shutil.copy(SCORES / "planner-a4c.parquet", mine / "planner-mine-a4c.parquet")
    for named in ("planner", "planner-mine"):
        racines("leaderboard", "--board", "patients", "--collect", str(mine), "--force")
        record = json.loads(ROW.with_name("planner-mine-a4c.json").read_text())
        assert record["submission"]["name"] == named
        shutil.copytree(own.with_name("planner"), own, dirs_exist_ok=True)
        told = yaml.safe_load((own / "submission.yaml").read_text())
        (own / "submission.yaml").write_text(yaml.safe_dump(told | {"name": "planner-mine"}))


def test_a_policy_handed_in_is_scored_on_patients(board, monkeypatch):
    path = sound_policy(inbox(board, "in") / "policy.onnx", view="A4C-patients")
    recipe = patients_recipe("patients")
    dataset = {"source": "phantom", "version": recipe["version"], "digest": recipe["recipe_digest"]}
    about = {"track": "patient-agents", "dataset": dataset}
    folder = submitted(board, "policy", path, recipe["recipe_digest"], **about)
    settings = SETTINGS | {"patient_agents": {}}
    assert board_of(folder, settings) == "patients"
    with pytest.raises(RacinesError, match=r"do not make \(patient_boards: beating\)"):
        board_of(folder, settings | {"patient_boards": ["beating"]})
    record = recompute(folder, Ground("patients", settings, grader=None), RESULTS)
    assert record["track"] == "patient-agents" and record["tier"] == "recomputed"
    assert record["scores"]["metrics"]["success_declared"]["n"] == 6
    rows = {each["name"] for each in read_board(RESULTS, "patients")["patient-agents"]}
    assert rows == {"constant-pose-a4c", "planner-a4c", "mine"}
    with pytest.raises(RacinesError, match="is for A4C-patients, and board beating for tasks of"):
        recompute(folder, Ground("beating", settings, grader=None), RESULTS)
    moving = sound_policy(inbox(board, "other") / "policy.onnx", view="A4C-beating")
    about |= {"name": "other"}
    with pytest.raises(RacinesError, match=r"dataset\.digest: .*; the world of A4C-beating is"):
        submitted(board, "policy", moving, recipe["recipe_digest"], **about)
    with pytest.raises(RacinesError, match=r"dataset\.digest: .*; the world of A4C-beating is"):
        intake.look_at(moving.parent, board / "leaderboard/submissions")
    monkeypatch.setattr(intake, "check_world", lambda *_: None)  # by one of another version
    other = submitted(board, "policy", moving, recipe["recipe_digest"], **about)
    assert board_of(other, settings) == "beating"
    with pytest.raises(RacinesError, match=r"other: dataset\.digest: .*; the world of board beat"):
        recompute(other, Ground("beating", settings, grader=None), RESULTS)


def test_a_policy_of_the_one_heart_is_refused_before_it_is_taken_in(board):
    path, recipe = (
        sound_policy(inbox(board, "in") / "p.onnx", view="SC"),
        patients_recipe("patients"),
    )
    dataset = {"source": "phantom", "version": recipe["version"], "digest": recipe["recipe_digest"]}
    about = {"track": "patient-agents", "dataset": dataset}
    with pytest.raises(RacinesError, match=r"p\.onnx is for SC of the one heart: give track: ag"):
        submitted(board, "policy", path, recipe["recipe_digest"], **about)
    assert not (board / "leaderboard/submissions/patient-agents/mine").exists()
    path = sound_policy(inbox(board, "on") / "p.onnx", view="SC-beating")
    with pytest.raises(RacinesError, match="is for SC-beating of patients: give track: patient-a"):
        submitted(board, "policy", path, recipe["recipe_digest"])


@pytest.mark.thorough
def test_policies_on_patients_are_the_trainings_of_one_method(board):
    recipe, folder = patients_recipe("patients"), inbox(board, "in")
    paths = [sound_policy(folder / f"{k}.onnx", k, view="A4C-patients") for k in range(3)]
    dataset = {"source": "phantom", "version": recipe["version"], "digest": recipe["recipe_digest"]}
    about = {
        "track": "patient-agents",
        "dataset": dataset,
        "tier": "recomputed",
        "seeds": [2, 4, 6],
    }
    write_submission(folder, *(artefact("policy", path) for path in paths), **about)
    taken = intake.take_in(folder, board / "leaderboard/submissions").folder
    scores = recompute(taken, Ground("patients", SETTINGS, grader=None), RESULTS)["scores"]
    config = fill(PatientsConfig, SETTINGS["evaluation_patients"], "evaluation_patients")
    first, *further = [OnnxPolicyAgent(path) for path in paths]
    wanted = evaluate_patients("", board, config, agent=first, further=further).scores
    assert scores["metrics"] == json.loads(json.dumps(wanted["metrics"]))
    assert scores["runs"] == 3 and scores["weights"].keys() == {path.name for path in paths}
    assert [each["seed"] for each in scores["trainings"]] == [2, 4, 6]
    alone = evaluate_patients("", board, config, agent=first).scores
    assert alone["metrics"]["return"]["value"] != scores["metrics"]["return"]["value"]


def test_a_trace_is_a_bound_on_patients_too(board):
    told = ["--tier", "patients", "--view", "A4C"]
    racines("export", "trace", "planner", "--out", "in/trace.json", *told)
    recipe = patients_recipe("patients")
    dataset = {"source": "phantom", "version": recipe["version"], "digest": recipe["recipe_digest"]}
    about = {"track": "patient-agents", "dataset": dataset}
    folder = submitted(board, "trace", board / "in/trace.json", recipe["recipe_digest"], **about)
    assert board_of(folder, SETTINGS) == "patients"
    record = recompute(folder, Ground("patients", SETTINGS, grader=None), RESULTS)
    metrics = json.loads(ROW.read_text())["scores"]["metrics"]
    assert record["scores"]["metrics"]["success_declared"] == metrics["success_declared"]
    assert record["tier"] == "recomputed" and is_bound(record)
    assert racines("audit", "patient-agents/mine", "--board", "patients")
    fewer = SETTINGS | {"evaluation_patients": SETTINGS["evaluation_patients"] | {"patients": 2}}
    with pytest.raises(RacinesError, match=r"trace\.json: start_set: recorded from"):
        recompute(folder, Ground("patients", fewer, grader=None), board / "other")


def test_a_policy_that_knows_the_test_patients_is_flagged(board, monkeypatch):
    watched = Watched()
    config = fill(PatientsConfig, SETTINGS["evaluation_patients"], "evaluation_patients")
    evaluate_patients("", board, config, agent=watched)
    known = torch.cat(watched.seen), torch.cat(watched.done)
    path = lookup_policy(inbox(board, "in") / "policy.onnx", *known, view="A4C-patients")
    recipe = patients_recipe("patients")
    dataset = {"source": "phantom", "version": recipe["version"], "digest": recipe["recipe_digest"]}
    about = {"track": "patient-agents", "dataset": dataset}
    monkeypatch.setattr(
        recomputing.confined, "ConfinedPolicyAgent", lambda p, _: OnnxPolicyAgent(p)
    )
    # The contract would refuse it: it acts alike at starts that it was not told of.
    monkeypatch.setattr(intake, "probe", lambda *_, **__: Probed())
    monkeypatch.setattr(recomputing, "_try_contract", lambda *_: None)
    folder = submitted(board, "policy", path, recipe["recipe_digest"], **about)
    ground = Ground("patients", SETTINGS, grader=None)
    public = recompute(folder, ground, RESULTS)["scores"]["metrics"]["success_declared"]
    assert public["value"] == 1.0
    secret = Secret("patients", 1, hashlib.sha256(b"a nonce").digest())
    commit(RESULTS, "patients", secret.nonce, "2026-11-24", board / "nonce.json")
    drawn = draw_in_secret(folder, ground, RESULTS, secret, "2026-11-24")
    assert drawn["basis"] == {"n": 6, "units": 3, "digest": None}
    (flag,) = drawn["flags"]
    assert flag.startswith("sharp drop from public to secret (Found and declared 100.0 to ")
    shown = racines("leaderboard", "--board", "patients")
    assert "Flagged, patient-agents/mine: sharp drop" in " ".join(shown.split())


def test_a_merged_agent_acts_on_patients_of_a_round(board, tmp_path):
    private = str(tmp_path / "nonce.json")
    racines("board", "commit-secret", "patients", "--out", private)
    again = ["leaderboard", "--board", "patients", "--secret", private, "--recompute"]
    record = RESULTS / "patients/patient-agents/constant-pose-a4c.json"
    before = record.read_bytes()
    for name in ("constant-pose-a4c", "patient-agents/constant-pose-a4c"):
        racines(*again, name)  # the second time it comes out the same
    (path,) = RESULTS.glob("patients/secret/round-1/patient-agents/*.json")
    drawn = json.loads(path.read_text())
    assert drawn["basis"] == {"n": 6, "units": 3, "digest": None}
    figures, public = drawn["figures"]["success_declared"], json.loads(record.read_text())["scores"]
    assert figures["public"]["value"] == public["metrics"]["success_declared"]["value"]
    assert figures["secret"]["n"] == 6 and drawn["weights"] == public["weights"]["files"]
    assert record.read_bytes() == before, "the record stays what it was"
    ends = drawn["figures"]["position_error_median"]
    assert ends["secret"]["value"] != ends["public"]["value"], "other patients, other ends"
    racines("board", "reveal", "patients", "--secret", private)
    racines(*again[:-3], "--secret", str(RESULTS / "patients/secrets.json"), "--recompute",
            "constant-pose-a4c", "--force")  # fmt: skip
    assert json.loads(path.read_text())["flags"] == [
        "drawn after the reveal, when the draws were public"
    ]


def test_what_cannot_be_confirmed_in_secret_is_refused(board, tmp_path):
    private = str(tmp_path / "nonce.json")
    racines("board", "commit-secret", "patients", "--out", private)
    again = ["leaderboard", "--board", "patients", "--secret", private, "--recompute"]
    with pytest.raises(RacinesError, match=r"planner-a4c\.json: it learns nothing"):
        racines(*again, "planner-a4c")
    with pytest.raises(RacinesError, match="no submission in"):
        racines(*again, "nobody")
    with pytest.raises(RacinesError, match="no submission in"):
        racines(*again[:-3], "--recompute", "constant-pose-a4c")
    shutil.rmtree("envs/runs/constant-pose")
    with pytest.raises(RacinesError, match="cannot be drawn in secret: no policy of it in"):
        racines(*again, "constant-pose-a4c")


def test_secret_patients_are_others_each_round_and_nobody_elses():
    public = StartSet(tuple(range(20_000, 20_140)), 3, 0)
    rounds = [
        secret_starts(Secret("patients", number, hashlib.sha256(b"a nonce").digest()), public)
        for number in (1, 1, 2)
    ]
    assert rounds[0] == rounds[1] != rounds[2]
    for drawn in rounds:
        assert len(set(drawn.patients)) == 140 and {*map(split_of, drawn.patients)} == {"secret"}
        assert drawn.starts == 3
    assert not set(rounds[0].patients) & set(rounds[2].patients)
