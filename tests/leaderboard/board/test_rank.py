"""Places by scores that no other entry can change."""

import copy
import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from racines_leaderboard.board.collect import collect, read_board
from racines_leaderboard.board.rank import by_task, rank, rankings
from racines_leaderboard.board.standing import standing
from racines_leaderboard.board.table import board_tables
from racines_leaderboard.records.tracks import AGENTS, GENERATORS
from tests.leaderboard.conftest import agent_scores, generator_scores
from tests.leaderboard.evidence import (
    ENDS,
    GENERATOR,
    agent,
    evidence,
    generator,
    judged,
    pinned,
    with_evidence,
)

PIN = {
    "board": "b",
    "generators": {
        "anchors": {
            "zero": {"name": "mean-image", "scores": "0" * 64},
            "one": {"name": "noise-ceiling", "scores": "0" * 64},
            "values": {name: list(ENDS[name]) for name in GENERATOR},
        }
    },
}


def entry(name: str, quality: Any, **how: Any) -> dict[str, Any]:
    """Return a record that stands on the board of PIN."""
    trained = how.pop("trained", True)
    figures = evidence(GENERATOR, quality, **how)
    scores = with_evidence(judged(generator_scores(name)), figures, trained)
    return placed({"name": name, "scores": scores, "tier": "recomputed"}, figures)


def placed(record: dict[str, Any], figures: Any) -> dict[str, Any]:
    record = {key: value for key, value in record.items() if key != "standing"}
    return record | {"standing": standing(record, figures, GENERATORS, PIN)}


QUALITY = st.floats(0.05, 0.95)
ENTRY = st.fixed_dictionaries(
    {
        "quality": st.fixed_dictionaries(dict.fromkeys(GENERATOR, QUALITY)) | QUALITY,
        "seed": st.integers(0, 9),
        "spread": st.sampled_from([0.0, 0.02, 0.3]),
        "trainings": st.sampled_from([1, 3, 3, 3]),
        "trained": st.booleans(),
    }
)
CALM = settings(
    max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


def made(told: list[dict[str, Any]]) -> list[dict[str, Any]]:
    names = ["nearest-pose", *(f"s{i}" for i in range(len(told)))]
    return [entry(name, **how) for name, how in zip(names, told, strict=False)]


def relations(records: list[dict[str, Any]]) -> dict[tuple[str, str], int]:
    """Return of every pair with places whether the first is ahead (1), behind (-1) or tied (0)."""
    with_place = [r for r in records if not r["standing"].why]
    return {
        (a["name"], b["name"]): int(a["standing"].ahead_of(b["standing"]))
        - int(b["standing"].ahead_of(a["standing"]))
        for a, b in itertools.permutations(with_place, 2)
    }


def told(records: list[dict[str, Any]]) -> dict[str, tuple[Any, Any]]:
    return {r.record["name"]: (r.place, r.standing.score) for r in rank(GENERATORS, records)}


@CALM
@given(st.lists(ENTRY, min_size=2, max_size=5), st.data())
def test_what_others_do_changes_no_score_and_no_pair(entries, data):
    """Removing an entry, adding it again, under another name, or twice."""
    records = made(entries)
    before, pairs = told(records), relations(records)
    one = data.draw(st.integers(0, len(records) - 1))
    rest = [r for i, r in enumerate(records) if i != one]
    twin = records[one] | {"name": "zz"}
    for others in (rest, [*rest, twin], [*records, twin], [*records, twin | {"name": "aa"}]):
        after, new = told(others), relations(others)
        for record in rest:
            name = record["name"]
            assert after[name][1] == before[name][1]
            ahead = [o for o in others if o is not record and new.get((o["name"], name)) == 1]
            if after[name][0] is not None:
                assert after[name][0] == 1 + len(ahead)
            for other in rest:
                pair = name, other["name"]
                assert new.get(pair) == pairs.get(pair)
    if not twin["standing"].why:
        both = relations([*records, twin])
        assert both["zz", records[one]["name"]] == 0, "a copy of an entry ties with it"
        assert told([*records, twin])["zz"] == told([*records, twin])[records[one]["name"]]


@CALM
@given(st.lists(ENTRY, min_size=2, max_size=5), st.randoms(use_true_random=False))
def test_the_order_of_reading_does_not_matter(entries, chance):
    records = made(entries)
    shuffled = list(records)
    chance.shuffle(shuffled)
    assert list(told(records).items()) == list(told(shuffled).items())


@CALM
@given(
    st.lists(ENTRY, min_size=2, max_size=4),
    st.sampled_from(GENERATOR),
    st.floats(0.001, 2.0),
)
def test_a_better_metric_never_hurts(entries, metric, gain):
    records = made(entries)
    (own, how), zero_one = (records[-1], entries[len(records) - 1]), ENDS[metric]
    figures = evidence(
        GENERATOR, **{k: v for k, v in how.items() if k != "trained"}
    )  # the same again
    better = copy.deepcopy(figures)
    shift, each = gain * (zero_one[1] - zero_one[0]), better.figures[metric]
    for array in (each.values,) if each.whole is None else (each.whole.whole, each.whole.without):
        array += shift
    changed = placed(own, better)
    assert changed["standing"].score.value > own["standing"].score.value
    before, after = relations(records), relations([*records[:-1], changed])
    for pair, relation in before.items():
        if pair[0] == own["name"]:
            assert after[pair] >= relation
    places = told(records)[own["name"]][0], told([*records[:-1], changed])[own["name"]][0]
    assert places[0] is None or places[1] <= places[0]


def test_a_score_is_the_mean_of_anchored_metrics_and_is_not_cut():
    half = entry("half", 0.5, spread=0.0, units=400)
    assert half["standing"].score.value == pytest.approx(0.5, abs=0.02)
    beyond = entry("beyond", {"ssim": 1.5, **dict.fromkeys(GENERATOR[1:], 1.0)}, spread=0.0)
    one = entry("one", 1.0, spread=0.0)
    gain = beyond["standing"].score.value - one["standing"].score.value
    assert gain == pytest.approx(0.5 / 5)
    below = entry("below", -0.5)
    assert below["standing"].score.value < 0
    score = half["standing"].score
    assert score.low < score.value < score.high and score.trainings == 3 and score.units == 400


def test_the_interval_of_a_score_holds_what_its_trainings_differ_by():
    alike, apart = (entry("a", 0.5, spread=0.0), entry("b", 0.5, spread=0.5))
    width = [r["standing"].score.high - r["standing"].score.low for r in (alike, apart)]
    assert width[1] > 1.5 * width[0]


def test_paired_differences_tell_apart_what_lone_intervals_do_not():
    """Units are hard or easy for both: the intervals overlap, the difference leaves out 0."""
    a, b = entry("a", 0.50, spread=0.001), entry("b", 0.49, spread=0.001, seed=1)
    assert b["standing"].score.high > a["standing"].score.low
    assert [r.place for r in rank(GENERATORS, [a, b])] == [1, 2]


def test_removing_a_retrieval_reverses_no_two_others(tmp_path: Path):
    """By the mean of ranks it did: the published boards' flow and cgan changed places."""
    results = pinned(tmp_path)
    likeness = {"ssim": 0.78, "psnr": 0.77, "fid": 0.50, "kid": 0.65, "pose_error_mm": 0.99}
    whole = {"ssim": 0.19, "psnr": 0.25, "fid": 0.68, "kid": 0.78, "pose_error_mm": 0.93}
    found = {"ssim": 0.44, "psnr": 0.46, "fid": 0.99, "kid": 0.99, "pose_error_mm": 0.98}
    for name, quality in (("flow", likeness), ("cgan", whole), ("nearest-pose", found)):
        generator(tmp_path / "new", name, quality)
    collect([tmp_path / "new"], results, tmp_path, "b")

    def shown() -> list[Any]:
        ranking = rank(GENERATORS, read_board(results, "b")["generators"])
        kept = [r for r in ranking if r.record["name"] in ("flow", "cgan")]
        return [(r.place, r.record["name"], r.standing.score) for r in kept]

    before = shown()
    assert [each[:2] for each in before] == [(1, "flow"), (2, "cgan")]
    for path in (results / "b/generators").glob("nearest-pose.*"):
        path.unlink()
    assert shown() == before
    # The anchors themselves may go: their figures stand in the board's file.
    for path in (results / "b/generators").glob("*-*.*"):
        path.unlink()
    assert shown() == before


def test_a_floor_handed_in_again_and_again_lifts_nobody(tmp_path: Path):
    """A hundred bad entries beat nobody, and move no score up or down."""
    results = pinned(tmp_path)
    for name, quality in (("a", 0.6), ("b", 0.4)):
        generator(tmp_path / "new", name, quality)
    collect([tmp_path / "new"], results, tmp_path, "b")
    before = told(read_board(results, "b")["generators"])
    for i in range(6):
        generator(tmp_path / "junk", f"junk-{i}", 0.1, seed=i)
    collect([tmp_path / "junk"], results, tmp_path, "b")
    after = told(read_board(results, "b")["generators"])
    assert {name: after[name] for name in before} == before


def test_who_has_no_place_and_why(tmp_path: Path):
    results = pinned(tmp_path)
    generator(tmp_path / "new", "three", 0.5)
    generator(tmp_path / "new", "one", 0.9, trainings=1)
    generator(tmp_path / "new", "two", 0.9, trainings=2)
    generator(tmp_path / "new", "rule", 0.4, trainings=1, trained=False)
    bare = generator(tmp_path / "new", "bare", 0.99)
    scores = bare.read_text().replace('"evidence"', '"notes_"')
    document = json.loads(scores)
    del document["notes_"]
    bare.write_text(json.dumps(document))
    generator(tmp_path / "new", "nearest-pose", 0.95, trained=False)
    collect([tmp_path / "new"], results, tmp_path, "b")
    ranking = rank(GENERATORS, read_board(results, "b")["generators"])
    assert {r.record["name"]: r.place or r.standing.why for r in ranking} == {
        "noise-ceiling": "bound",
        "bare": "no evidence",
        "nearest-pose": "bound",
        "one": "one training",
        "two": "two trainings",
        "three": 1,
        "rule": 2,
        "mean-image": "bound",
    }
    table = board_tables("b", read_board(results, "b"))[0]
    assert {row[1]: row[0] for row in table.rows}["one"] == "one training"
    assert {row[1]: row[table.head.index("Trainings")] for row in table.rows}["two"] == "2"


def test_a_bound_under_another_name_is_one():
    artefacts = [
        {"kind": "adapter", "adapter": "racines_models.generators.nearest_pose:NearestPose"}
    ]
    record = entry("clever", 0.99, trained=False)
    figures = evidence(GENERATOR, 0.99)
    assert not record["standing"].why
    assert (
        placed(record | {"submission": {"artefacts": artefacts}}, figures)["standing"].why
        == "bound"
    )
    traced = {"artefacts": [{"kind": "trace", "path": "x"}]}
    assert placed(record | {"submission": traced}, figures)["standing"].why == "bound"


def test_systems_that_the_data_do_not_tell_apart_share_a_place(tmp_path: Path):
    results = pinned(tmp_path)
    for name, quality, seed in (("a", 0.5, 1), ("b", 0.505, 2), ("c", 0.2, 3)):
        generator(tmp_path / "new", name, quality, seed=seed, spread=0.3)
    collect([tmp_path / "new"], results, tmp_path, "b")
    table = board_tables("b", read_board(results, "b"))[0]
    places = {row[1]: row[0] for row in table.rows}
    assert (places["a"], places["b"], places["c"]) == ("1=", "1=", "3")


def test_agents_rank_by_success_spl_and_grade_of_their_task_and_never_by_return(tmp_path: Path):
    results = pinned(tmp_path)
    agent(tmp_path / "new", "good", 0.8)
    path = agent(tmp_path / "new", "rich", 0.3, seed=1)
    path.write_text(
        path.read_text().replace('"return": {"value": 10.0', '"return": {"value": 10.1')
    )
    collect([tmp_path / "new"], results, tmp_path, "b")
    (group,) = by_task(read_board(results, "b")["agents"]).values()
    told = [(r.place, r.record["name"]) for r in rank(AGENTS, group)]
    assert told == [(None, "planner"), (1, "good"), (2, "rich"), (None, "random")]


def test_a_task_without_anchors_has_no_places(tmp_path: Path):
    results = pinned(tmp_path)
    path = agent(tmp_path / "new", "elsewhere", 0.8)
    path.write_text(path.read_text().replace('"view": "SC"', '"view": "PL"'))
    collect([tmp_path / "new"], results, tmp_path, "b")
    (only,) = [r for r in rankings(AGENTS, read_board(results, "b")["agents"])
               if r.record["name"] == "elsewhere"]  # fmt: skip
    assert (only.place, only.standing.why, only.standing.score) == (None, "no anchors", None)
    notes = [t.notes[0] for t in board_tables("b", read_board(results, "b")) if "PL" in t.title]
    assert notes and "this task has no anchors" in notes[0]


def records(*scores: dict[str, Any]) -> list[dict[str, Any]]:
    return [{"name": s.get("generator") or s.get("agent"), "scores": s} for s in scores]


def test_agents_of_different_tasks_stand_apart():
    told = records(
        agent_scores("looks", success_true=0.6),
        agent_scores("looks-too", success_true=0.7),
        agent_scores("knows-its-pose", observation="params", success_true=0.9),
        agent_scores("elsewhere", view="PL", success_true=0.95),
    )
    assert {title: [r["name"] for r in group] for title, group in by_task(told).items()} == {
        "PL from the image, phantom backend": ["elsewhere"],
        "SC from the image, phantom backend": ["looks", "looks-too"],
        "SC from the pose, phantom backend": ["knows-its-pose"],
    }


def test_bounds_stand_in_every_table_of_their_view():
    told = records(
        agent_scores("looks", success_true=0.6),
        agent_scores("knows-its-pose", observation="params", success_true=0.9),
        agent_scores("ceiling", observation="params") | {"sees": "truth"},
        agent_scores("floor", observation="params", success_true=0.0) | {"sees": "nothing"},
        agent_scores("floor-pl", view="PL", success_true=0.0) | {"sees": "nothing"},
    )
    tables = [{each.record["name"] for each in rank(AGENTS, g)} for g in by_task(told).values()]
    assert tables == [
        {"floor-pl"},
        {"looks", "ceiling", "floor"},
        {"knows-its-pose", "ceiling", "floor"},
    ]
    assert len(rankings(AGENTS, told)) == 5, "each once where all stand together"


def test_a_repeated_read_gives_the_same_scores(tmp_path: Path):
    results = pinned(tmp_path)
    generator(tmp_path / "new", "a", 0.5)
    collect([tmp_path / "new"], results, tmp_path, "b")
    shutil.copytree(results, tmp_path / "again")
    first, second = (
        told(read_board(each, "b")["generators"]) for each in (results, tmp_path / "again")
    )
    assert first == second and np.isfinite(first["a"][1].low)
