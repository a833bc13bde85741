"""Who estimates motion, on a board: collected, pinned, ranked, handed in, and audited."""

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from racines_data.build.dataset import recipe_of
from racines_data.config import read_params, section
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest
from racines_leaderboard.board.collect import read_board, read_scores
from racines_leaderboard.board.rank import rankings
from racines_leaderboard.board.standing import is_bound
from racines_leaderboard.board.weightings import orders
from racines_leaderboard.records.schema import check, sealed
from racines_leaderboard.records.tracks import MOTION
from racines_leaderboard.submissions.document import BLANKS
from racines_leaderboard.submissions.intake import check_content
from tests.conftest import ROOT, TINY, lay_workplace
from tests.leaderboard.called import racines

FLOORS = ("no-motion", "constant-motion", "mean-motion")
NAMES = (*FLOORS, "pair-cnn")
RESULTS, SCORES = Path("leaderboard/results"), Path("models/runs/motion-scores")
PARAMS = RESULTS / "moving/params.yaml"
PLACE, RUN = RESULTS / "moving/motion", Path("models/runs/motion/pair-cnn")
NETWORK = {"widths": [4, 6, 8], "hidden": 16}
TRAINING = {"images": 32, "batch_size": 16, "warmup_images": 16, "repeats": 3}
SETTINGS = {
    "board": "moving",
    "seed": 0,
    "data": TINY["data"],
    "motions": {"pair-cnn": NETWORK | {"training": TRAINING}},
}
ON = ("--config", "frames", "--params", str(PARAMS), "--json")


@pytest.fixture(scope="module")
def made(made_once, tiny_root) -> Path:
    """A workplace with a board of floors and of a network of three trainings, on the phantom."""
    return made_once("moving-board", lambda folder: make_board(lay_workplace(folder, tiny_root)))


def make_board(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        PARAMS.parent.mkdir(parents=True)
        PARAMS.write_text(yaml.safe_dump(SETTINGS))
        for name in ("mean-motion", "pair-cnn"):
            racines("train", "motion", name, *ON)
        for name in NAMES:
            racines("eval", "motion", name, *ON)
        racines("leaderboard", "--board", "moving", "--collect", str(SCORES))
        racines("board", "pin", "moving")


@pytest.fixture
def board(made, tmp_path, monkeypatch) -> Path:
    shutil.copytree(made, tmp_path / "work", symlinks=True)
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def audited(*words: str, code: int = 0) -> dict[str, dict[str, Any]]:
    said = json.loads(racines("audit", *words, "--board", "moving", "--json", code=code))
    return {each["name"]: each for each in said["reports"]}


def test_the_floor_is_0_the_truth_is_1_and_floors_have_no_place(board):
    records = read_board(RESULTS, "moving")[MOTION.name]
    by_name = {each["name"]: each for each in records}
    pin = json.loads((RESULTS / "moving/board.json").read_text())[MOTION.name]
    assert "one" not in pin["anchors"] and pin["anchors"]["zero"]["name"] == "no-motion"
    assert {ends[1] for ends in pin["anchors"]["values"].values()} == {0.0}
    assert {name for name in NAMES if is_bound(by_name[name])} == set(FLOORS)
    assert by_name["no-motion"]["standing"].score.value == 0.0
    ends, learned = pin["anchors"]["values"], by_name["pair-cnn"]
    metrics = learned["scores"]["metrics"]
    shares = [1 - metrics[key]["value"] / ends[key][0] for key in MOTION.ranked_by]
    score = learned["standing"].score
    assert score.value == pytest.approx(sum(shares) / 4) and score.low < score.value < score.high
    assert learned["standing"].trainings == 3 and learned["standing"].units > 1
    ranked = {each.record["name"]: each for each in rankings(MOTION, records)}
    assert ranked["pair-cnn"].place == 1
    assert {ranked[name].standing.why for name in FLOORS} == {"bound"}


def test_tables_show_intervals_and_other_weights(board):
    shown = racines("leaderboard", "--board", "moving", "--details")
    for told in ("GPE", "LLE", "Drift", "patients", "pair-cnn", "Step"):
        assert told in shown
    csv = board / "moving.csv"
    racines("leaderboard", "--board", "moving", "--csv", str(csv), "--markdown", "BOARDS.md")
    assert "moving,motion," in csv.read_text()
    assert (RESULTS / "moving/motion.png").is_file()
    assert "| bound | mean-motion |" in Path("BOARDS.md").read_text(encoding="utf-8")
    (rows,) = orders(RESULTS, "moving").values()
    assert set(rows) == {*NAMES} - {"no-motion"}
    assert set(rows["pair-cnn"]["places"]) >= {"score", "global", "local"}


def test_an_audit_makes_every_number_again(board):
    found = audited("--all")
    assert {name: each["verdict"] for name, each in found.items()} == dict.fromkeys(NAMES, "holds")
    roads = {name: each["made_again"]["road"] for name, each in found.items()}
    assert roads == {
        "no-motion": "no weights",
        "constant-motion": "no weights",
        "mean-motion": "fitted",
        "pair-cnn": "run",
    }


def test_further_trainings_are_retrainable_and_none_is_not_verified(board):
    for seed in (1, 2):
        shutil.rmtree(RUN / f"seed-{seed}")
    found = audited("pair-cnn")["pair-cnn"]
    assert found["verdict"] == "holds" and found["made_again"]["road"] == "first training"
    assert found["counts"]["retrainable"] == 1
    shutil.rmtree(RUN)
    found = audited("pair-cnn", code=3)["pair-cnn"]
    assert found["verdict"] == "not verified"
    train = f"racines train motion pair-cnn --params {PARAMS} --data data/racines"
    assert train in found["remedies"]


def test_without_the_data_an_audit_says_how_to_build_them(board):
    Path("data/racines").unlink()
    found = audited("no-motion", code=3)["no-motion"]
    assert found["remedies"][0] == f"racines data build --params {PARAMS} --out data/moving"


def test_what_is_trained_again_and_holds_is_reproduced(board):
    assert audited("no-motion", "mean-motion", "--retrain")["mean-motion"]["tier"] == "reproduced"
    record = json.loads((PLACE / "mean-motion.json").read_text())
    assert record["tier"] == "reproduced" and record["reproduced"]["seeds"] == [0]
    assert audited("mean-motion")["mean-motion"]["verdict"] == "holds"
    record["reproduced"]["metrics"]["gle"]["value"] += 0.1
    (PLACE / "mean-motion.json").write_text(json.dumps(sealed(record)))
    assert audited("mean-motion", code=1)["mean-motion"]["verdict"] == "does not hold"


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("metrics", "gpe", "value"), 1.0),
        (("metrics", "drift_deg", "high"), 179.0),
        (("explained", "turn_y"), 0.99),
        (("sweeps",), {"0": "another"}),
        (("counts", "left_out"), 3),
        (("dataset", "sweeps"), "0" * 64),
        (("dataset", "digest"), "0" * 64),
        (("dataset", "recipe_digest"), "0" * 64),
        (("learned_from", "digest"), "0" * 64),
        (("settings", "landmarks"), 2),
        (("told_first",), True),
        (("weights", "seed-1/model.safetensors"), "0" * 64),
    ],
)
def test_what_is_changed_afterwards_does_not_hold(board, place, value):
    path = PLACE / "pair-cnn.json"
    record = json.loads(path.read_text())
    node = record["scores"]
    for key in place[:-1]:
        node = node[key]
    node[place[-1]] = value
    path.write_text(json.dumps(sealed(record)))
    (RESULTS / "moving/board.json").unlink()
    assert audited("pair-cnn", code=1)["pair-cnn"]["verdict"] == "does not hold"


def test_the_figures_of_another_sweep_do_not_hold(board):
    """Evidence of who rests, under the name of who learned."""
    record, other = (
        json.loads((PLACE / f"{name}.json").read_text()) for name in ("mean-motion", "no-motion")
    )
    record["scores"]["metrics"] = other["scores"]["metrics"]
    shutil.copy(PLACE / "no-motion.parquet", PLACE / "mean-motion.parquet")
    sha256 = other["scores"]["evidence"]["sha256"]
    record["scores"]["evidence"] = {"file": "mean-motion.parquet", "sha256": sha256}
    (PLACE / "mean-motion.json").write_text(json.dumps(sealed(record)))
    assert audited("mean-motion", code=1)["mean-motion"]["verdict"] == "does not hold"


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("metrics", "gpe", "low"), -1.0, "beyond what it can be"),
        (("metrics", "drift_deg", "value"), 500.0, "metrics.drift_deg.value"),
        (("metrics", "score", "high"), 1.5, "metrics.score.high"),
        (("metrics", "gle", "n"), 0, "from no item"),
        (("dataset", "recipe_digest"), "0" * 64, "score it on the board's dataset"),
        (("dataset", "sweeps"), "0" * 64, "dataset.sweeps"),
        (("settings", "landmarks"), 2, "settings.landmarks"),
        (("settings", "pixel_mm"), 0.5, "settings.pixel_mm"),
        (("motion",), "another", "differs from the file's name"),
    ],
)
def test_what_cannot_stand_on_the_board_is_not_collected(board, place, value, message):
    path = SCORES / "pair-cnn.json"
    scores = json.loads(path.read_text())
    node = scores
    for key in place[:-1]:
        node = node[key]
    node[place[-1]] = value
    path.write_text(json.dumps(scores))
    before = (PLACE / "pair-cnn.json").read_bytes()
    with pytest.raises(RacinesError, match=message):
        racines("leaderboard", "--board", "moving", "--collect", str(SCORES), "--force")
    assert (PLACE / "pair-cnn.json").read_bytes() == before


def handed_in(digest: str, *files: str) -> None:
    """Write a submission of motions in files of the folder `mine`, filled in."""
    for file in files:
        racines("export", "motion", "mean-motion", "--out", f"mine/{file}", *ON)
    racines("submit", "--new", "mine", "--track", "motion")
    path = Path("mine/submission.yaml")
    text = path.read_text(encoding="utf-8").replace('"0000000"', '"0a1b2c3"')
    text = re.sub(r'digest: "[0-9a-f]{64}"', f'digest: "{digest}"', text)
    for blank in BLANKS:
        text = text.replace(blank, "an example")
    path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("named", ["digest", "recipe_digest"])
def test_motions_in_a_file_are_scored_again(board, named):
    handed_in(read_manifest(Path("data/racines"))[named], "mine.parquet")
    assert "motion of every test sweep" in racines("submit", "mine")
    racines("leaderboard", "--recompute", "motion/mine", "--params", str(PARAMS))
    scores, _ = read_scores(SCORES / "mean-motion.json")
    record = json.loads((PLACE / "mine.json").read_text())
    assert record["tier"] == "recomputed"
    assert record["scores"]["metrics"] == scores["metrics"]
    (mine,) = (
        each for each in rankings(MOTION, read_board(RESULTS, "moving")[MOTION.name])
        if each.record["name"] == "mine"
    )  # fmt: skip
    assert mine.place is None and mine.standing.why == "one training"
    found = audited("mine")["mine"]
    assert found["verdict"] == "holds" and found["made_again"]["road"] == "artefacts"


def test_motions_of_other_data_or_beyond_their_format_are_refused(board):
    handed_in(hashlib.sha256(b"other data").hexdigest(), "mine.parquet")
    racines("submit", "mine")
    with pytest.raises(RacinesError, match="no config of data/racines has it"):
        racines("leaderboard", "--recompute", "motion/mine", "--params", str(PARAMS))
    assert not (PLACE / "mine.json").exists()
    shutil.copy(PLACE / "no-motion.parquet", "evidence.parquet")
    with pytest.raises(RacinesError, match="give sweep, frame, to_first, to_previous"):
        check_content(Path("evidence.parquet"), "motion", MOTION.name)


def test_a_file_claims_no_place_of_its_own(board):
    racines("export", "motion", "mean-motion", "--out", "mine.parquet", *ON)
    told = json.loads(racines("eval", "motion", "mine.parquet", *ON, "--out", "mine"))
    assert told["trained"] is True


def test_the_published_board_is_of_the_recipe_that_its_settings_build():
    folder = ROOT / "leaderboard/results/trackerless"
    pin = json.loads((folder / "board.json").read_text())["motion"]
    data = section(read_params(folder / "params.yaml"), "data")
    assert recipe_of(data, pin["config"]) == pin["recipe_digest"]
    with pytest.raises(RacinesError, match="no source there adds config 'beating'"):
        recipe_of(data, "beating")
    for path in sorted((folder / "motion").glob("*.json")):
        check(json.loads(path.read_text()), "record", str(path))
    records = read_board(folder.parent, "trackerless")["motion"]
    assert {each["name"] for each in records} == set(NAMES)
