"""A board's file: what its records are held to, on every road onto it and out of it."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.board import collect as module
from racines_leaderboard.board.collect import collect, read_board, write_records
from racines_leaderboard.board.pinning import pin_board
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.pins import read_pin
from racines_leaderboard.records.schema import seal_of, sealed
from racines_leaderboard.records.verdicts import Audited, keep_verdicts
from racines_models.statistics import Evidence
from tests.leaderboard.conftest import agent_scores, generator_scores, metric
from tests.leaderboard.evidence import (
    AGENT,
    GENERATOR,
    agent,
    anchors,
    evidence,
    generator,
    judged,
    pinned,
    with_evidence,
    write,
)

OTHER = "cd" * 32


@pytest.fixture
def results(tmp_path: Path) -> Path:
    return pinned(tmp_path)


def take(results: Path, folder: Path, board: str = "b", force: bool = False) -> list[Path]:
    return collect([folder], results, results.parent / "none", board, force=force)


def test_a_pin_says_what_the_anchors_were_scored_on(results: Path):
    pin = read_pin(results, "b")
    assert pin is not None
    part, told = pin["generators"], pin["generators"]["anchors"]
    assert set(part["judges"]) == {"grader", "pose"} and set(part["extractors"]) == {"inception"}
    assert set(part["metrics"]) == set(GENERATOR)
    assert (told["zero"]["name"], told["one"]["name"]) == ("mean-image", "noise-ceiling")
    for name, (zero, one) in told["values"].items():
        for end, record in ((zero, "mean-image"), (one, "noise-ceiling")):
            path = results / "b/generators" / f"{record}.json"
            assert json.loads(path.read_text())["scores"]["metrics"][name]["value"] == end
    assert [task["view"] for task in pin["agents"]["tasks"]] == ["SC"]
    standing = {r["name"]: r["standing"] for r in read_board(results, "b")["generators"]}
    assert standing["mean-image"].score.value == pytest.approx(0, abs=1e-12)
    assert standing["noise-ceiling"].score.value == pytest.approx(1)
    assert {each.why for each in standing.values()} == {"bound"}


def edited(path: Path, *keys: str, value: object) -> Path:
    document = json.loads(path.read_text(encoding="utf-8"))
    node = document
    for key in keys[:-1]:
        node = node[key]
    if value is None:
        del node[keys[-1]]
    else:
        node[keys[-1]] = value
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


FOREIGN = [
    (generator, ("dataset", "recipe_digest"), OTHER, r"dataset\.recipe_digest: cdcd.*score it on"),
    (generator, ("dataset", "split"), "validation", r"dataset\.split: validation; .* has test"),
    (generator, ("dataset", "sample"), OTHER, r"dataset\.sample: cdcd"),
    (
        generator,
        ("extractors", "grader", "sha256"),
        OTHER,
        r"extractors\.grader\.sha256: cdcd.*jud",
    ),
    (generator, ("extractors", "pose"), None, r"extractors\.pose\.sha256: not there"),
    (generator, ("extractors", "inception", "sha256"), OTHER, r"extractors\.inception\.sha256"),
    (generator, ("metrics", "pose_error_mm"), None, r"metrics\.pose_error_mm: not there"),
    (agent, ("phantom", "recipe_digest"), OTHER, r"phantom\.recipe_digest: cdcd"),
    (agent, ("extractors", "grader", "sha256"), OTHER, r"extractors\.grader\.sha256: cdcd"),
    (agent, ("task", "start_set"), "easy-100", r"task\.start_set: easy-100; .* has fixed-100"),
    (agent, ("metrics", "spl"), None, r"metrics\.spl: not there"),
]


@pytest.mark.parametrize(("make", "keys", "value", "message"), FOREIGN)
def test_scores_that_are_not_the_boards_are_refused_on_every_road(
    results: Path, tmp_path: Path, make, keys, value, message
):
    path = make(tmp_path / "new", "mine", 0.5)
    take(results, tmp_path / "new")
    edited(path, *keys, value=value)
    with pytest.raises(RacinesError, match=message) as refused:
        take(results, tmp_path / "new", force=True)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)
    assert "board b has" in str(refused.value)
    # The same by hand, sealed again: reading refuses it, and so does taking in anything else.
    track = "generators" if make is generator else "agents"
    place = results / "b" / track / "mine.json"
    edited(place, "scores", *keys, value=value)
    place.write_text(json.dumps(sealed(json.loads(place.read_text()))))
    with pytest.raises(RacinesError, match=message):
        read_board(results, "b")
    other = make(tmp_path / "more", "other", 0.6)
    with pytest.raises(RacinesError, match=message):
        take(results, other.parent)
    with pytest.raises(RacinesError, match=message):  # the road of a recomputed record
        record = json.loads(place.read_text())
        write_records({place: record}, results, Path(), "b", True)


def test_an_easier_task_of_the_same_name_is_refused(tmp_path: Path):
    for name, sees, quality in (("random", "nothing", 0.1), ("planner", "truth", 0.9)):
        path = agent(tmp_path / "a", name, quality, sees=sees)
        edited(path, "task", "definition", value={"max_steps": 200})
    collect([tmp_path / "a"], tmp_path / "r", tmp_path, "b")
    pin_board(tmp_path / "r", "b")
    path = agent(tmp_path / "new", "mine", 0.8)
    edited(path, "task", "definition", value={"max_steps": 2000})
    with pytest.raises(RacinesError, match=r"task\.definition: .*2000.* has .*200"):
        take(tmp_path / "r", tmp_path / "new")


def test_an_existing_pin_needs_force_and_says_what_changes(results: Path, tmp_path: Path):
    before = (results / "b/board.json").read_bytes()
    assert pin_board(results, "b") == []
    again = generator(tmp_path / "again", "mean-image", 0.1, trainings=1, trained=False)
    shutil.copy(tmp_path / "anchors/g/noise-ceiling.json", again.parent)
    shutil.copy(tmp_path / "anchors/g/noise-ceiling.parquet", again.parent)
    with pytest.raises(RacinesError, match=r"is pinned, and .* would change \(generators\.anchors"):
        pin_board(results, "b", [again.parent, tmp_path / "anchors/a"])
    assert (results / "b/board.json").read_bytes() == before
    words = ["board", "pin", "b", "--results", str(results), "--force"]
    words += ["--scores", str(again.parent), "--scores", str(tmp_path / "anchors/a")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0
    assert re.search(r"generators\.anchors\.values\.ssim\.0: 0\.\d+ -> 0\.\d+\n", done.output)
    assert (results / "b/board.json").read_bytes() != before


def test_a_track_of_which_no_scores_are_given_keeps_its_pin(results: Path, tmp_path: Path):
    before = json.loads((results / "b/board.json").read_text())
    assert {"generators", "agents"} <= set(before)
    assert pin_board(results, "b", [tmp_path / "anchors/g"], force=True) == []
    assert json.loads((results / "b/board.json").read_text()) == before


def test_new_judges_reach_a_board_by_a_new_pin_and_new_records(results: Path, tmp_path: Path):
    generator(tmp_path / "old", "mine", 0.5)
    take(results, tmp_path / "old")
    shutil.copytree(tmp_path / "anchors", tmp_path / "new")
    for path in (tmp_path / "new").glob("*/*.json"):
        edited(path, "extractors", "grader", "sha256", value=OTHER)
    folders = [tmp_path / "new" / track for track in "ga"]
    with pytest.raises(RacinesError, match="the published judges"):
        collect(folders, results, tmp_path, "b", force=True)
    words = [word for folder in folders for word in ("--scores", str(folder))]
    done = CliRunner().invoke(
        app, ["board", "pin", "b", "--results", str(results), "--force", *words]
    )
    assert done.exit_code == 0 and "does not fit" in done.output and "mine.json" in done.output
    with pytest.raises(RacinesError, match=r"mine\.json: extractors\.grader\.sha256"):
        collect(folders, results, tmp_path, "b", force=True)
    again = generator(tmp_path / "new/g", "mine", 0.5)
    edited(again, "extractors", "grader", "sha256", value=OTHER)
    collect(folders, results, tmp_path, "b", force=True)
    assert len(read_board(results, "b")["generators"]) == 3


def test_anchors_that_make_no_scale_are_refused(tmp_path: Path):
    anchors(tmp_path)
    generator(tmp_path / "g", "noise-ceiling", {"ssim": -0.5} | dict.fromkeys(GENERATOR[1:], 1.0))
    collect([tmp_path / "g"], tmp_path / "r", tmp_path, "b")
    with pytest.raises(RacinesError, match=r"metrics\.ssim\.value: .* no better than"):
        pin_board(tmp_path / "r", "b")
    with pytest.raises(RacinesError, match="board c: no anchors: score mean-image and"):
        pin_board(tmp_path / "r", "c")


def test_anchors_of_two_judges_are_refused(tmp_path: Path):
    anchors(tmp_path)
    edited(tmp_path / "g/mean-image.json", "extractors", "pose", "sha256", value=OTHER)
    collect([tmp_path / "g"], tmp_path / "r", tmp_path, "b")
    with pytest.raises(RacinesError, match="judges: .*score both alike"):
        pin_board(tmp_path / "r", "b")


def test_a_pin_of_another_board_or_damaged_is_refused(results: Path):
    shutil.copytree(results / "b", results / "c")
    with pytest.raises(RacinesError, match="board: 'b', expected 'c' by its place"):
        read_board(results, "c")
    edited(results / "b/board.json", "generators", "anchors", "values", "ssim", value=[0.1])
    with pytest.raises(RacinesError, match=r"board\.json: generators\.anchors\.values\.ssim"):
        read_board(results, "b")


# Evidence


def test_evidence_is_copied_beside_the_record_and_a_stale_one_removed(
    results: Path, tmp_path: Path
):
    path = generator(tmp_path / "new", "mine", 0.5)
    (record,) = take(results, tmp_path / "new")
    beside = record.with_suffix(".parquet")
    assert beside.read_bytes() == path.with_suffix(".parquet").read_bytes()
    (beside.parent / "gone.parquet").write_bytes(b"of a record that is not there any more")
    edited(path, "evidence", value=None)
    take(results, tmp_path / "new", force=True)
    assert not beside.exists() and not (beside.parent / "gone.parquet").exists()
    assert (beside.parent / "mean-image.parquet").exists()


@pytest.mark.parametrize("what", ["changed", "missing", "of another name"])
def test_evidence_that_is_not_the_one_named_is_refused(results: Path, tmp_path: Path, what):
    path = generator(tmp_path / "new", "mine", 0.5)
    (place,) = take(results, tmp_path / "new")
    for each in (path, place):
        table = each.with_suffix(".parquet")
        if what == "changed":
            evidence(GENERATOR, 0.9).write(table)
        elif what == "missing":
            table.unlink()
        else:
            keys = ("evidence", "file") if each == path else ("scores", "evidence", "file")
            edited(each, *keys, value="other.parquet")
    said = {"changed": "sha256", "missing": "no evidence", "of another name": "evidence.file"}
    for road in (lambda: take(results, path.parent, force=True), lambda: read_board(results, "b")):
        with pytest.raises(RacinesError, match=said[what]):
            road()


@pytest.mark.parametrize("key", ["value", "low", "high", "n"])
def test_figures_that_do_not_follow_from_their_evidence_are_refused(
    results: Path, tmp_path: Path, key
):
    path = generator(tmp_path / "new", "mine", 0.5)
    (place,) = take(results, tmp_path / "new")
    told = json.loads(path.read_text())["metrics"]["psnr"][key]
    for each, keys in ((path, ()), (place, ("scores",))):
        better = told - 1 if key == "n" else told + (1e-4 if key != "high" else -1e-4)
        edited(each, *keys, "metrics", "psnr", key, value=better)
    with pytest.raises(RacinesError, match=rf"metrics\.psnr\.{key}: .*its evidence has"):
        take(results, path.parent, force=True)
    with pytest.raises(RacinesError, match=rf"metrics\.psnr\.{key}: .*its evidence has"):
        read_board(results, "b")


def test_more_trainings_than_the_evidence_has_are_refused(results: Path, tmp_path: Path):
    path = generator(tmp_path / "new", "mine", 0.5, trainings=1)
    edited(path, "runs", value=3)
    with pytest.raises(RacinesError, match=r"runs: 3; mine\.parquet has ssim of 1 trainings"):
        take(results, path.parent)


def test_evidence_without_a_ranked_metric_is_refused(results: Path, tmp_path: Path):
    figures = evidence(GENERATOR, 0.5)
    scores = with_evidence(judged(generator_scores("mine")), figures, True)
    del figures.figures["pose_error_mm"]
    write(tmp_path / "new", scores, figures)
    with pytest.raises(RacinesError, match="no figures of pose_error_mm"):
        take(results, tmp_path / "new")


def test_evidence_of_the_easy_trajectories_alone_is_refused(results: Path, tmp_path: Path):
    """The sample's digest is claimed, not recomputed: the items of the evidence are the board's."""
    generator(tmp_path / "new", "mine", 0.5, units=6)
    with pytest.raises(RacinesError, match="ssim: other items or units than those of the board's"):
        take(results, tmp_path / "new")


def test_a_training_handed_in_three_times_is_none_of_three(results: Path, tmp_path: Path):
    one, copied = evidence(GENERATOR, 0.5, trainings=1), Evidence()
    for name, each in one.figures.items():
        if each.whole is None:
            copied.add(name, each.statistic, np.repeat(each.values, 3, 0), each.items, each.units)
        else:
            whole = each.whole
            thrice = (np.repeat(whole.whole, 3), np.repeat(whole.without, 3, 0))
            copied.add_set(name, type(whole)(*thrice, whole.units, whole.n))
    write(tmp_path / "new", with_evidence(judged(generator_scores("mine")), copied, True), copied)
    generator(tmp_path / "new", "sound", 0.5)
    take(results, tmp_path / "new")
    why = {r["name"]: r["standing"].why for r in read_board(results, "b")["generators"]}
    assert why["mine"] == "repeated training" and why["sound"] == ""


def test_all_or_nothing_with_a_disk_that_fills_up(results: Path, tmp_path: Path, monkeypatch):
    for name in ("a", "b"):
        generator(tmp_path / "new", name, 0.5)
    take(results, tmp_path / "new")
    kept = {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    for name in ("a", "b", "c"):
        generator(tmp_path / "new", name, 0.7, seed=1)
    write_record, written = module.write_record, []

    def full(path: Path, record: dict) -> None:
        if written:
            raise OSError(28, "No space left on device", str(path))
        written.append(path)
        write_record(path, record)

    monkeypatch.setattr(module, "write_record", full)
    with pytest.raises(OSError, match="No space"):
        take(results, tmp_path / "new", force=True)
    assert {path: path.read_bytes() for path in results.rglob("*") if path.is_file()} == kept


def test_a_board_without_a_file_takes_scores_as_before_and_ranks_nothing(tmp_path, write_scores):
    folder = write_scores("g", generator_scores("one"), generator_scores("two", ssim=0.9))
    agents = write_scores("a", agent_scores("ppo"))
    collect([folder, agents], tmp_path / "r", tmp_path, "b")
    shown = CliRunner().invoke(app, ["leaderboard", "--results", str(tmp_path / "r")])
    assert shown.exit_code == 0 and "no anchors" in " ".join(shown.output.split())
    assert "racines board pin b" in " ".join(shown.output.split())
    told = CliRunner().invoke(app, ["leaderboard", "--results", str(tmp_path / "r"), "--json"])
    rows = json.loads(told.stdout)["boards"]["b"]["generators"]
    assert [(r["rank"], r["unplaced"], r["score"]) for r in rows] == [
        (None, "no anchors", None)
    ] * 2


def test_a_verdict_is_shown_of_the_record_that_it_is_of_alone(results: Path, tmp_path: Path):
    path = generator(tmp_path / "new", "mine", 0.5)
    (place,) = take(results, tmp_path / "new")
    said = Audited("holds", seal_of(json.loads(place.read_text())), "")
    keep_verdicts(results / "b", {"generators/mine": said})

    def verdicts() -> list[str]:
        words = ["leaderboard", "--results", str(results), "--json"]
        rows = json.loads(CliRunner().invoke(app, words).stdout)["boards"]["b"]["generators"]
        return [row["verdict"] for row in rows if row["name"] == "mine"]

    assert verdicts() == ["holds"]
    generator(tmp_path / "new", "mine", 0.9)
    take(results, path.parent, force=True)
    assert verdicts() == [None]
    (results / "b/audit.json").write_text('{"verdicts": {"generators/mine": "holds"}}')
    with pytest.raises(RacinesError, match=r"audit\.json"):
        read_board(results, "b")


def test_a_null_for_what_ranks_is_refused(results: Path, tmp_path: Path):
    scores = with_evidence(judged(agent_scores("mine")), evidence(AGENT, 0.5), True)
    scores["metrics"]["spl"] = metric(None, 0)
    write(tmp_path / "new", scores)
    with pytest.raises(RacinesError, match=r"metrics\.spl\.value: not there"):
        take(results, tmp_path / "new")
