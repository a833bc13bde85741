"""The table of peers: what is kept of a run, and that the peers draw what they should."""

import json
from functools import partial

import pytest
import torch

from racines_data.phantom import shared_phantom
from racines_data.randomness import sample_seeds
from racines_models.scores.metrics import frechet_distance
from tests.benchmarks import aims, lines
from tests.benchmarks.lines import Line, line_of
from tests.benchmarks.peers.convolution import Convolution
from tests.benchmarks.peers.rays import Rays
from tests.benchmarks.peers.slices import LabelVolume
from tests.benchmarks.test_frechet import features, metrics, usual
from tests.benchmarks.test_render import assert_same_slices, assert_shows_the_block, poses

TIMES = {"ours": [1.0, 2.0, 1.0], "theirs": [3.0, 4.0, 4.0]}


def a_line(work: str = "work", **other: object) -> Line:
    return line_of(work, "frames/s", 10, TIMES, "theirs", "values", **other)  # type: ignore[arg-type]


def test_a_ratio_is_the_median_of_the_rounds():
    line = a_line(aim=2.0)
    assert (line.ratio, line.low, line.high, line.rounds) == (3.0, 2.0, 4.0, 3)
    assert line.ours == 10.0 and line.theirs == 2.5


def test_a_run_of_a_few_replaces_theirs_alone(tmp_path):
    path = tmp_path / "speed.json"
    lines.keep([a_line("one"), a_line("two")], path)
    lines.keep([a_line("two", aim=1.0)], path)
    document = json.loads(path.read_text())
    assert [(each["work"], each["aim"]) for each in document["lines"]] == [
        ("one", None),
        ("two", 1.0),
    ]
    assert {"cpu", "date", "versions", "threads", "cores"} <= document["lines"][0][
        "measured"
    ].keys()


def test_what_is_published_has_machine_date_ratio_and_what_is_equal():
    for each in lines.read():
        assert each["equal"] and each["peer"] and each["rounds"] >= 1
        assert each["low"] <= each["ratio"] <= each["high"]
        assert each["measured"]["cpu"] and each["measured"]["date"]


def test_an_aim_is_met_missed_or_not_measured():
    least = partial(aims.Aim, "work", 10.0, "steps/s", "make bench")
    assert [least(x).met for x in (10.0, 9.9, None)] == ["met", "missed", "not measured"]
    assert [least(x, most=True).met for x in (10.0, 10.1)] == ["met", "missed"]


def test_what_the_benchmarks_measure_reaches_the_aims():
    """A line of another name would leave its aim without a figure."""
    assert all(aim.measured for aim in aims.aims())


@pytest.mark.slow
def test_the_simulators_draw_the_same_slices_of_the_block():
    volume, pose = LabelVolume(), poses(5)
    assert_same_slices(volume, pose)
    drawn = Convolution(volume).render(pose)
    assert_shows_the_block(drawn, volume, pose)
    assert_shows_the_block(
        Rays(volume).render(pose, torch.Generator().manual_seed(0)), volume, pose
    )
    assert_shows_the_block(shared_phantom().render(pose, sample_seeds(0, 5)), volume, pose)
    moved = pose._replace(position=pose.position + torch.tensor([0.01, 0.0, 0.0]))
    assert not torch.equal(drawn, Convolution(volume).render(moved))


def test_the_distances_of_the_peers_are_ours():
    one, other = (features(200, seed)[:, :64] for seed in (10, 20))
    ours = frechet_distance(one, other)
    assert usual(one, other) == pytest.approx(ours, rel=1e-6)
    assert metrics(one, other) == pytest.approx(ours, rel=1e-6)
