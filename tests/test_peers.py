"""The table of peers: what is kept of a run, and that the peers draw what they should."""

import json
from functools import partial

import pytest
import torch

from racines_data.phantom import shared_phantom
from racines_data.randomness import sample_seeds
from racines_models.scores.metrics import frechet_distance
from tests.benchmarks import aims, growth, limits, lines, test_steps, tried
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


def test_rows_of_patients_are_held_to_single_environments(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(test_steps, "ENVS", 2)
    settings = {"observation": "params", "reward": "oracle", "split": "validation", "patients": 1}
    rows = test_steps.rows_of("SC-patients-v0", **settings)
    test_steps.assert_rows_are_single(rows, "SC-patients-v0", **settings)
    with pytest.raises(AssertionError):
        test_steps.assert_rows_are_single(rows, "PL-patients-v0", **settings)


def test_what_operations_move_and_compute_is_counted():
    left, right = torch.ones(4, 6), torch.ones(6, 5)
    table, places = torch.arange(1_000), torch.tensor([3, 5])
    product = limits.counted(lambda: (left @ right).view(-1))
    assert product == {"operations": 1, "bytes": 4 * (24 + 30 + 20), "flops": 2 * 4 * 6 * 5}
    gathered = limits.counted(lambda: table.index_select(0, places))
    assert gathered == {"operations": 1, "bytes": 8 * (2 + 2 + 2), "flops": 0}
    shifted = limits.counted(lambda: left.add_(right[:, :1].expand(6, 6)[:4], alpha=0.5))
    assert shifted == {"operations": 1, "bytes": 4 * (24 + 4 + 24), "flops": 2 * 24}


@pytest.mark.thorough
def test_the_limits_and_what_was_tried_are_told():
    small = limits.Size(copied=1 << 20, read=1 << 12, product=32, rows=2, hearts=1, rounds=1)
    told = limits.document(small, "limits.json")
    works = told["measured"]["works"].values()
    assert all(len(work["longest"]) == 5 and work["operations"] > 50 for work in works)
    assert [work["voxels"] > 0 for work in works] == [True, True, False, False]
    assert [work["flops"] > 0 for work in works] == [True, True, True, False]
    assert [len(told["tables"][name]["rows"]) for name in ("ceilings", "limits", "longest")] == [
        5, 4, 4,
    ]  # fmt: skip
    few = tried.Size(rows=2, hearts=1, rounds=1, chunks=(1, 2), patience=0)
    ways = tried.document(few, "tried.json")
    assert len(ways["tables"]["tried"]["rows"]) == 7 + 5
    for world in ways["measured"].values():
        apart = {name: way["apart"] for name, way in world.items() if name != tried.TODAY}
        assert apart["1 at a time"] == apart["2 at a time"] == 0 and max(apart.values()) <= 8


def test_a_way_pays_where_it_is_quicker_in_every_round_and_draws_the_same():
    told = {"ratio": 1.2, "low": 1.1, "high": 1.3, "apart": 1}
    assert tried.verdict(told, 1) == "pays"
    assert tried.verdict(told, 0) == "quicker, but other pictures"
    assert tried.verdict(told | {"prepared_seconds": 20.1}, 1) == "pays, after 20 s"
    assert tried.verdict(told | {"low": 0.9}, 1) == "does not pay"
    assert tried.verdict({"failed": "not compiled within 60 s"}, 1) == "not compiled within 60 s"


def test_a_part_that_does_not_grow_has_no_exponent():
    flat = {"seconds": [0.44, 0.41, 0.44], "fixed": 0.1, "exponent": 3.0}
    assert growth.law_of("pool, hearts", flat) == ("all", "– (flat)")
    grown = {"seconds": [1.0, 2.0, 4.0], "fixed": 0.0, "exponent": 1.0}
    assert growth.law_of("build, frames", grown) == ("0.00", "1.00")
    assert growth.law_of(next(iter(growth.PAIRS)), grown)[1] == "1.00 (every pair)"
