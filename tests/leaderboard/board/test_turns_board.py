"""Generators on recorded turns on a board: pinned between floor and bound, ranked, never mixed."""

import hashlib
import json
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from racines_data.errors import RacinesError
from racines_leaderboard.board.collect import read_board, read_scores
from racines_leaderboard.board.rank import rankings
from racines_leaderboard.board.recompute import Ground
from racines_leaderboard.board.standing import is_bound
from racines_leaderboard.fresh.draws import draw_in_secret
from racines_leaderboard.fresh.rounds import Secret, commit
from racines_leaderboard.records.ranges import check_possible, range_of
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import GENERATORS, TURN_GENERATORS, track_of
from racines_models.scores import features, scoring
from tests.data.sources.rotation_folder import write_rotation
from tests.leaderboard.called import racines
from tests.leaderboard.handed_in import inbox, submitted
from tests.models.scores.test_scores import Coarse

BOUND = "racines_models.generators.neighbouring_frame:Generator"
NAMES = ("mean-image", "nearest-pose", "vae-gan", BOUND)
SETTINGS = {
    "board": "turned",
    "seed": 0,
    "generators": {
        "vae-gan": {
            "width": 4,
            "encoder_width": 4,
            "discriminator_width": 4,
            "learning_rate": 0.01,
            "training": {"images": 128, "batch_size": 8, "ema": 0.0, "repeats": 3},
        }
    },
    "scores": {"speed": False},
}
RESULTS, SCORES = Path("leaderboard/results"), Path("models/runs/scores")


@pytest.fixture(scope="module")
def made(made_once) -> Path:
    """A workplace whose board has floors, the bound, and one that learned thrice."""
    return made_once("turned-board", make_board)


def make_board(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        coarse(patch)
        write_rotation(folder / "recording", turns=36)
        Path("params.yaml").write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
        words = "--source", "rotation", "--set", "split=gap", "--out", "turns", "--workers", "1"
        racines("data", "import", "recording", *words)
        for name in NAMES:
            racines("train", "generator", name, "--data", "turns", "--json")
            alone = "--no-grader", "--no-pose", "--json"
            racines("eval", "generator", name, "--data", "turns", *alone)
        racines("leaderboard", "--board", "turned", "--collect", str(SCORES))
        racines("board", "pin", "turned")


def coarse(patch: pytest.MonkeyPatch) -> None:
    """Put block means in the place of Inception."""
    for module in (features, scoring):
        patch.setattr(module, "InceptionFeatures", Coarse)


@pytest.fixture
def board(made, tmp_path, monkeypatch) -> Path:
    shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def test_floor_and_bound_are_the_ends_and_have_no_place(board):
    records = read_board(RESULTS, "turned")[TURN_GENERATORS.name]
    by_name = {each["name"]: each for each in records}
    assert set(by_name) == {"mean-image", "nearest-pose", "vae-gan", "neighbouring-frame"}
    score = {name: each["standing"].score.value for name, each in by_name.items()}
    assert score["mean-image"] == 0.0 and score["neighbouring-frame"] == pytest.approx(1.0)
    assert {name for name, each in by_name.items() if is_bound(each)} == set(TURN_GENERATORS.bounds)
    why = {each.record["name"]: each.standing.why for each in rankings(TURN_GENERATORS, records)}
    assert why == dict.fromkeys(TURN_GENERATORS.bounds, "bound") | {"vae-gan": ""}
    pinned = json.loads((RESULTS / "turned/board.json").read_text())
    assert set(pinned) == {"schema", "board", TURN_GENERATORS.name}


def test_the_bound_scores_what_every_record_says_of_it(board):
    told = {path.stem: read_scores(path)[0]["metrics"] for path in SCORES.glob("*.json")}
    bound = told["neighbouring-frame"]
    for metrics in told.values():
        for key in ("ssim", "psnr", "feature_distance"):
            assert metrics[f"{key}_neighbour"]["value"] == pytest.approx(bound[key]["value"])


def test_the_table_says_one_heart_and_has_no_millimetres(board):
    shown = racines("leaderboard", "--board", "turned", "--details")
    told = " ".join(shown.split())
    assert "n = 1 patient" in told and "pose error" not in told.lower()
    racines("leaderboard", "--board", "turned", "--markdown", "page.md")
    page = Path("page.md").read_text(encoding="utf-8")
    assert "turn-generators" in page and " mm" not in page.replace("millimetres", "")
    listed = json.loads(racines("leaderboard", "--board", "turned", "--json"))
    rows = listed["boards"]["turned"][TURN_GENERATORS.name]
    assert len(rows) == 4 and all(row["verdict"] is None for row in rows)
    orders = json.loads(racines("study", "weightings", "turned", "--json"))
    assert "vae-gan" in str(orders)


def test_turns_stand_in_no_other_track_and_possible_figures_only(board):
    path = SCORES / "vae-gan.json"
    scores, track = read_scores(path)
    assert track is TURN_GENERATORS
    other = scores | {"dataset": scores["dataset"] | {"source": "phantom"}}
    assert track_of(other) is GENERATORS
    for key in ("feature_distance", "fid_train", "feature_distance_neighbour"):
        assert range_of(key)[0] == 0.0
        wrong = scores["metrics"] | {key: scores["metrics"][key] | {"value": -0.5, "low": -1.0}}
        with pytest.raises(RacinesError, match=f"metrics.{key}"):
            check_possible(scores | {"metrics": wrong}, "vae-gan.json")
    for key, value in (("ssim_train", 1.2), ("psnr_neighbour", -3.0)):
        wrong = scores["metrics"] | {key: scores["metrics"][key] | {"value": value}}
        with pytest.raises(RacinesError, match=f"metrics.{key}"):
            check_possible(scores | {"metrics": wrong}, "vae-gan.json")


def test_an_audit_makes_every_number_again(board, monkeypatch):
    coarse(monkeypatch)
    words = "--board", "turned", "--data", "turns", "--json"
    names = "nearest-pose", "vae-gan", "neighbouring-frame"  # the bound is not registered
    said = json.loads(racines("audit", *names, *words))
    assert len(said["reports"]) == 3
    for report in said["reports"]:
        open_ = {each["subject"] for each in report["verdicts"] if each["verdict"] != "holds"}
        assert open_ == {"submission"}, (report["name"], open_)


def test_an_audit_knows_the_recording_by_the_recipe_that_the_board_is_pinned_to(board, monkeypatch):
    coarse(monkeypatch)
    words = "--board", "turned", "--data", "turns", "--json", "--quick"
    pins = RESULTS / "turned/board.json"
    pinned = json.loads(pins.read_text())
    pinned[TURN_GENERATORS.name]["recipe_digest"] = hashlib.sha256(b"another").hexdigest()
    kept = pins.read_text()
    pins.write_text(json.dumps(pinned))
    (report,) = json.loads(racines("audit", "vae-gan", *words, code=1))["reports"]
    wrong = {each["subject"] for each in report["verdicts"] if each["verdict"] == "does not hold"}
    assert wrong == {"dataset.recipe_digest"}
    # Of recordings no settings name the recipe, whatever they say beside: that cannot be checked.
    unpinned = {key: each for key, each in pinned.items() if key != TURN_GENERATORS.name}
    for pin, settings in ((unpinned, SETTINGS), (unpinned, SETTINGS | {"data": {"workers": 1}})):
        pins.write_text(json.dumps(pin))
        Path("params.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
        (report,) = json.loads(racines("audit", "vae-gan", *words, code=3))["reports"]
        told = {each["subject"]: each["verdict"] for each in report["verdicts"]}
        assert told["dataset.recipe_digest"] == "cannot be checked"
        assert "does not hold" not in told.values()
    # Settings that say the phantom speak against recordings.
    told = yaml.safe_dump(SETTINGS | {"data": {"source": "phantom"}})
    Path("params.yaml").write_text(told, encoding="utf-8")
    (report,) = json.loads(racines("audit", "vae-gan", *words, code=1))["reports"]
    wrong = {each["subject"] for each in report["verdicts"] if each["verdict"] == "does not hold"}
    assert wrong == {"dataset.recipe_digest"}
    pins.write_text(kept)
    Path("params.yaml").write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
    # Settings that are not here speak against nothing; beside the results they are found.
    shutil.move("params.yaml", "aside.yaml")
    (report,) = json.loads(racines("audit", "vae-gan", *words, code=3))["reports"]
    assert "does not hold" not in {each["verdict"] for each in report["verdicts"]}
    assert "no settings of board turned" in json.dumps(report)
    Path("leaderboard/params").mkdir()
    shutil.move("aside.yaml", "leaderboard/params/turned.yaml")
    (report,) = json.loads(racines("audit", "vae-gan", *words, code=3))["reports"]
    assert "no settings of board" not in json.dumps(report)


def test_strata_have_the_frames_of_the_whole(board, monkeypatch):
    coarse(monkeypatch)
    path = RESULTS / "turned/turn-generators/vae-gan.json"
    record = json.loads(path.read_text())
    stratum = next(iter(record["scores"]["by_stratum"].values()))
    stratum["ssim"]["n"] += 1
    path.write_text(json.dumps(sealed(record)))
    words = "--board", "turned", "--data", "turns", "--json", "--quick"
    (report,) = json.loads(racines("audit", "vae-gan", *words, code=1))["reports"]
    wrong = {each["subject"] for each in report["verdicts"] if each["verdict"] == "does not hold"}
    assert "by_stratum.ssim.n" in wrong


def test_an_audit_without_the_recording_names_the_import(board, monkeypatch):
    coarse(monkeypatch)
    shutil.rmtree("turns")
    said = racines("audit", "vae-gan", "--board", "turned", "--json", code=3)
    assert "racines data import FOLDER --source rotation" in said


def test_images_of_turns_are_handed_in_scored_again_and_audited(board, monkeypatch):
    coarse(monkeypatch)
    path = inbox(board, "in") / "drawn.parquet"
    words = "nearest-pose", "--data", "turns", "--params", "params.yaml", "--out", str(path)
    racines("export", "predictions", *words)
    told = pq.read_schema(path).metadata
    digest, version = (told[b"racines." + key].decode() for key in (b"dataset", b"version"))
    dataset = {"source": "rotation", "version": version, "digest": digest}
    about = {"track": TURN_GENERATORS.name, "dataset": dataset}
    submitted(board, "predictions", path, digest, **about)
    racines("leaderboard", "--recompute", "mine", "--params", "params.yaml", "--data", "turns")
    record = json.loads((RESULTS / "turned/turn-generators/mine.json").read_text())
    by_name, _ = read_scores(SCORES / "nearest-pose.json")
    assert record["tier"] == "recomputed"
    # A file draws each pose once a seed: how its drawings differ is not told.
    metrics = {key: each for key, each in by_name["metrics"].items() if key != "diversity"}
    assert record["scores"]["metrics"] == metrics
    assert set(record["scores"]["extractors"]) == {"inception"}
    words = "--board", "turned", "--data", "turns", "--json"
    (report,) = json.loads(racines("audit", "mine", *words))["reports"]
    wrong = {each["subject"] for each in report["verdicts"] if each["verdict"] == "does not hold"}
    assert not wrong and report["counts"]["does not hold"] == 0
    secret = Secret("turned", 1, hashlib.sha256(b"a nonce").digest())
    commit(RESULTS, "turned", secret.nonce, "2026-11-26", board / "nonce.json")
    ground = Ground("turned", SETTINGS, Path("turns"), grader=None)
    folder = Path("leaderboard/submissions/turn-generators/mine")
    with pytest.raises(RacinesError, match="turn-generators is drawn in secret: images are no"):
        draw_in_secret(folder, ground, RESULTS, secret, "2026-11-26")
