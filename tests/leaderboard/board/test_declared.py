"""What a submission declares of its training: beside the row, in its words, and of no weight."""

import copy
import csv
import io

import pytest

from racines_leaderboard.board.declared import (
    CSV_DECLARED,
    declared,
    declared_columns,
    declared_note,
)
from racines_leaderboard.board.table import board_csv, board_tables, plain
from racines_leaderboard.records.tracks import TRACKS
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
