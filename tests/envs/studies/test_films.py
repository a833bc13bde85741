"""The films of the servo: they follow from the rule, end as published, and are small."""

import io
import json
from dataclasses import dataclass

import numpy as np
import polars as pl
import pytest
import torch
from PIL import Image

from racines_data.geometry import Pose
from racines_envs.agents.servo import mind
from racines_envs.worlds.ward import make_ward
from tests.envs.studies import films

MOST, TOGETHER = 1_500_000, 5_000_000


def test_what_is_tracked_is_what_the_rule_names():
    told = json.loads(films.RESULT.read_text())["tables"]["episodes"]["rows"]
    episodes = films.chosen()
    assert [row[0] for row in told] == [each.title for each in episodes]
    assert [row[1] for row in told] == [str(each.patient) for each in episodes]
    assert [row[3] for row in told] == [f"{each.distance:.1f} mm" for each in episodes]
    assert [row[-1] for row in told] == ["yes", "yes", "yes", "no"]
    sizes = {}
    for each in episodes:
        path = films.IMAGES / f"servo-{each.title}.gif"
        sizes[each.title] = path.stat().st_size
        with Image.open(path) as film:
            steps = int(told[len(sizes) - 1][2])
            assert film.size == (films.WIDTH, films.HEIGHT)
            assert film.n_frames == steps // films.EVERY + 1 + steps % films.EVERY + 1
    assert max(sizes.values()) <= MOST and sum(sizes.values()) <= TOGETHER


def test_the_rule_takes_quarters_of_the_found_and_the_middle_of_the_others(tmp_path, monkeypatch):
    """Eight patients, two starts each: of the first ones five are found, 1 to 5 mm away."""
    found = [1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1]
    away = [3.0, 9, 1, 9, 2, 9, 7.0, 0, 5, 9, 8.0, 0, 4, 9, 6.0, 0]
    rows = [
        {"metric": metric, "training": training, "item": i, "unit": 20_000 + i // 2, "value": value}
        for metric, values in (("success_declared", found), ("position_error_median", away))
        for training in (1, 0)
        for i, value in enumerate(values if training == 0 else [1.0] * 16)
    ]
    frame = pl.DataFrame(rows, schema_overrides={"value": pl.Float64}).sample(
        fraction=1.0, shuffle=True, seed=1
    )
    frame.write_parquet(tmp_path / "row.parquet")
    record = {"scores": {"task": {"start_set": {"starts": 2}}}}
    (tmp_path / "row.json").write_text(json.dumps(record))
    monkeypatch.setattr(films, "EVIDENCE", tmp_path / "row")
    assert films.chosen() == [
        films.Episode("found-1", 20_002, 0, 2.0),
        films.Episode("found-2", 20_000, 0, 3.0),
        films.Episode("found-3", 20_006, 0, 4.0),
        films.Episode("failure", 20_003, 0, 7.0),
    ]


def test_a_film_that_ends_elsewhere_is_not_drawn(tmp_path, monkeypatch):
    """A validation patient, of whom nothing is published; where it ends is beside the point."""
    monkeypatch.setattr(mind, "CHOOSE", 10)
    episode = films.Episode("found-1", 10_000, 0, 0.0)
    with pytest.raises(ValueError, match="patient=10000.*ends [0-9.]+ mm away"):
        films.make([episode], "validation", tmp_path)
    assert not list(tmp_path.iterdir())


@dataclass
class Standing:
    """An environment whose one row stands somewhere."""

    phantom: object
    state: object


@dataclass
class At:
    position: torch.Tensor
    rotation: torch.Tensor
    case: torch.Tensor


def test_the_reason_is_told_by_what_lies_in_the_plane():
    ward = make_ward("beating", "validation", (10_003,))
    case = torch.zeros(1, dtype=torch.int64)
    own = ward.scene(case, torch.zeros(1, dtype=torch.float64)).target("A4C")

    def told(pose: Pose):
        return films.reason(Standing(ward, At(*pose, case)), 0)

    same = told(own)
    assert same["here"] == same["own"] and same["apart"] == 0.0
    assert same["own"]["apex"] > 80 and 55 < same["own"]["length"] < 110
    across = ward.pool.hearts[0].chest.across[0].float()
    shift = torch.tensor([[*(0.02 * across).tolist(), 0.0]])
    apart = told(Pose(own.position + shift, own.rotation))
    assert apart["apart"] == apart["across"] == 20.0 and 25 < apart["spacing"] < 32
    assert apart["here"]["apex"] < 60 < apart["own"]["apex"]
    turned = torch.tensor([[*(0.02 * across.flip(0) * torch.tensor([-1.0, 1.0])).tolist(), 0.0]])
    assert told(Pose(own.position + turned, own.rotation))["across"] < 0.1, "between the same ribs"
    lifted = Pose(own.position + torch.tensor([[0.0, 0.0, 0.3]]), own.rotation)
    assert told(lifted)["here"]["length"] == 0, "no ventricle there"


def test_a_film_shows_every_other_step_and_the_end():
    picture = np.zeros((128, 128), np.uint8)
    shots = [films.Shot(picture + 10 * i, i, i / 2, 9.0, 3.0, 1.0, i == 5) for i in range(6)]
    episode = films.Episode("found-1", 10_000, 0, 9.0)
    with Image.open(io.BytesIO(films.film(episode, shots, picture + 200, True, 1.3))) as film:
        assert film.n_frames == 5, "0, 2, 4, the end, and the end beside the patient's own view"
        film.seek(4)
        last = np.asarray(film.convert("L"))
        assert last[100, films.WIDTH - 60] > 150, "the patient's own view stands at its right"
        assert film.info["duration"] == films.HELD * films.MILLISECONDS
