"""Truth against truth: disjoint halves of a split, at several n."""

import json

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.scores import metrics
from racines_models.studies.floor import (
    FloorConfig,
    draw_floor,
    frames_needed,
    halve,
    measure_floor,
)
from tests.models.labelled import LabelledStore
from tests.models.scores.test_scores import Coarse

CONFIG = FloorConfig(sizes=(8, 16, 32, 900), splits=5)


@pytest.fixture(scope="module")
def labelled():
    return LabelledStore(trajectories=40, length=8)


def test_halves_share_no_trajectory_and_are_nearly_equal(labelled):
    pool = frames_needed(labelled, CONFIG)
    assert set(pool.frames.index.tolist()) <= set(labelled.split_indices("test").tolist())
    pairs = halve(pool.trajectory, CONFIG)
    assert len(pairs) == 5
    for first, second in pairs:
        assert sorted([*first, *second]) == list(range(len(pool.trajectory)))
        assert not set(pool.trajectory[first]) & set(pool.trajectory[second])
        assert abs(len(first) - len(second)) <= 8
    assert len({tuple(first) for first, _ in pairs}) > 1
    again = halve(pool.trajectory, CONFIG)
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(pairs, again, strict=True))


def test_figures_are_means_over_halvings_of_equal_n(labelled, tmp_path):
    content = measure_floor(labelled, {"coarse": Coarse()}, CONFIG, tmp_path)
    rows = content["rows"]["coarse"]
    assert [row["n"] for row in rows] == [8, 16, 32]  # 900 are not there
    pool = frames_needed(labelled, CONFIG)
    features = Coarse()(pool.frames.images)
    values = []
    for pair in halve(pool.trajectory, CONFIG):
        a, b = (features[half[torch.arange(16) * len(half) // 16]] for half in pair)
        values.append(metrics.fid(a, b))
    told = rows[1]["fid"]
    assert told["value"] == pytest.approx(np.mean(values))
    assert (told["low"], told["high"]) == pytest.approx((min(values), max(values)))
    assert content["dataset"]["digest"] == labelled.manifest["digest"]
    assert content["extractors"]["coarse"] == Coarse.settings
    json.dumps(content, allow_nan=False)
    Coarse.calls = 0
    assert measure_floor(labelled, {"coarse": Coarse()}, CONFIG, tmp_path)["rows"] == {
        "coarse": rows
    }
    assert Coarse.calls == 0  # the features are kept
    assert draw_floor(content).startswith(b"\x89PNG")


def test_fid_falls_with_n_and_kid_does_not_depend_on_it(labelled):
    rows = measure_floor(labelled, {"coarse": Coarse()}, CONFIG)["rows"]["coarse"]
    fid, kid = ([row[key]["value"] for row in rows] for key in ("fid", "kid"))
    assert fid[0] > fid[1] > fid[2] > 0
    spread = rows[0]["kid"]["high"] - rows[0]["kid"]["low"]
    assert max(abs(value) for value in kid) < spread


def test_what_cannot_be_halved_is_refused(labelled):
    with pytest.raises(RacinesError, match="fewer than the smallest"):
        measure_floor(labelled, {}, FloorConfig(sizes=(900,)))
    one = LabelledStore(trajectories=1, length=12)
    one._splits["test"] = [0, 12]
    with pytest.raises(RacinesError, match="no two trajectories"):
        measure_floor(one, {}, CONFIG)
