"""What a submission declares of its training: beside the row, in its words, and of no weight."""

import copy
import csv
import io
import json
from pathlib import Path

import pytest

from racines_data.files import sha256_file
from racines_leaderboard.board.declared import (
    CSV_DECLARED,
    declared,
    declared_columns,
    declared_note,
)
from racines_leaderboard.board.table import board_csv, board_tables, plain
from racines_leaderboard.board.trained import training_of
from racines_leaderboard.records.tracks import TRACKS
from tests.conftest import ROOT
from tests.leaderboard.conftest import generator_scores

TRAINING = {"budget": "24,000 images | each", "hardware": "a core", "images": 24000, "hours": 0.5}


def record(name: str, trained: bool = True, **submission):
    scores = generator_scores(name) | {"trained": trained}
    told = {"method": "m", "seeds": [3], "training": TRAINING, "artefacts": []} | submission
    return {"board": "b", "name": name, "tier": "recomputed", "submission": told, "scores": scores}


def test_figures_stand_in_columns_and_words_below():
    records = [record("one"), record("floor", trained=False), record("two", seeds=[0, 1])]
    columns = dict(declared_columns(records))
    assert columns == {
        "Training seeds": ["3", "–", "0, 1"],
        "Images": ["24,000", "–", "24,000"],
        "Hours": ["0.5", "–", "0.5"],
    }
    assert "one, two: 24,000 images | each." in declared_note(records)
    assert declared_columns([records[1]]) == [] and declared_note([records[1]]) == ""


def test_seeds_that_the_record_keeps_stand_before_those_declared():
    kept = record("one")
    kept["scores"]["trainings"] = [{"seed": n, "published": False} for n in (5, 6)]
    assert declared(kept)["seeds"] == [5, 6]
    further = record("two", seeds=[0])
    further["scores"]["weights"] = {"model.safetensors": "", "seed-1/model.safetensors": ""}
    assert declared(further)["seeds"] == [0, 1]
    assert declared(record("three") | {"submission": None}) == {}


@pytest.mark.parametrize("change", [{"training": {}}, {"seeds": [9, 8]}, {"training": TRAINING}])
def test_nothing_ranks_by_it(change: dict):
    content = {track.name: [] for track in TRACKS}
    content["generators"] = [record("one"), record("two")]
    other = copy.deepcopy(content)
    other["generators"][0]["submission"] |= change
    places = [[row[:4] for row in board_tables("b", each)[0].rows] for each in (content, other)]
    assert places[0] == places[1]
    assert plain(content)["generators"][0]["training"]["images"] == 24000


def a_run(folder: Path, config: dict, metrics: dict) -> dict[str, str]:
    """Leave a run; return the sha256 of its weights, by name."""
    folder.mkdir(parents=True)
    (folder / "model.safetensors").write_bytes(folder.name.encode())
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "metrics.json").write_text(json.dumps(metrics))
    return {"model.safetensors": sha256_file(folder / "model.safetensors")}


def test_what_is_not_declared_is_told_by_the_run_of_these_weights(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = {"images": 700, "steps": 7, "seconds": 1000.0}
    weights = a_run(tmp_path / "models/runs/one", {}, {"training": told})
    mine = record("one", training={"budget": "by the run", "hours": 2.5})
    mine["scores"]["weights"] = weights | {"seed-1/model.safetensors": "ab" * 32}
    assert declared(mine) == {"seeds": [1, 3], "budget": "by the run", "hours": 2.5, "images": 700}
    assert "as declared, or else as the first run tells, which" in declared_note([mine])
    mine["submission"] = None
    assert declared(mine) == {"images": 700, "hours": 0.28}
    mine["scores"]["weights"] = {"model.safetensors": "ab" * 32}  # of another training
    assert declared(mine) == {}


@pytest.mark.parametrize(
    ("config", "metrics", "told"),
    [
        ({}, {"frames": 640, "seconds": 36.0}, {"steps": 640, "hours": 0.01}),
        ({"config": {"training": {"images": 90}}}, {}, {"images": 90}),
        (
            {"training": {
                "training": {"images": 50, "seconds": 9.0},
                "rounds": [{"training": {"images": 40, "seconds": 27.0}}],
            }},
            {"training": {"images": 50}},
            {"images": 50, "hours": 0.01},
        ),
        ({"training": "damaged"}, {"training": []}, {}),
    ],
)  # fmt: skip
def test_how_runs_tell_of_their_training(tmp_path, config, metrics, told):
    a_run(tmp_path / "run", config, metrics)
    assert training_of(tmp_path / "run") == told


def test_a_published_training_is_known_by_its_hash():
    path = ROOT / "leaderboard/results/phantom-default/agents/ppo.json"
    found = declared(json.loads(path.read_text()))
    metrics = json.loads((ROOT / "envs/weights/phantom-default/ppo/metrics.json").read_text())
    assert found["steps"] == metrics["frames"] and "images" not in found


def test_a_csv_file_has_the_same_figures_and_no_formula():
    content = {track.name: [] for track in TRACKS}
    content["generators"] = [record("one", seeds=[0, 1]), record("floor", trained=False)]
    content["generators"].append(record("two", training={"images": "=1+1", "hours": -0.5}))
    lines = list(csv.DictReader(io.StringIO(board_csv({"b": content}))))
    told = {line["name"]: [line[head] for head in CSV_DECLARED] for line in lines}
    assert CSV_DECLARED == ("training_seeds", "training_images", "training_steps", "training_hours")
    assert told == {
        "one": ["0 1", "24000", "", "0.5"],
        "floor": ["", "", "", ""],
        "two": ["3", "'=1+1", "", "-0.5"],
    }


def test_the_table_of_details_does_not_repeat_it():
    content = {track.name: [] for track in TRACKS}
    content["generators"] = [record("one")]
    content["generators"][0]["scores"]["metrics"]["recall"] = {
        "value": 0.5, "low": 0.4, "high": 0.6, "n": 100,
    }  # fmt: skip
    main, further, *_ = board_tables("b", content, details=True)
    assert "Images" in main.head and "Images" not in further.head
    assert all(len(row) == len(main.head) for row in main.rows)
