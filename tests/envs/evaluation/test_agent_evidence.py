"""What agents' scores rest on: the file beside them, what follows from it, who may replace it."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.agents.rollout import Episodes
from racines_envs.evaluation.measures import (
    METRICS,
    episode_values,
    interquartile_mean,
    measure,
    measure_by_seed,
)
from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
from racines_leaderboard.records.ranges import range_of
from racines_leaderboard.records.schema import read_json
from racines_models.statistics import Evidence

FEW = EvaluationConfig(starts=6, seeds=(0, 1), latency=50)
N = 30


def episodes(seed: int = 0, success: float = 0.5, n: int = N) -> Episodes:
    """Return made-up episodes; an agent of half the successes by default."""
    draw = np.random.default_rng(seed)
    final = {
        "success": draw.random(n) < success,
        "success_graded": draw.random(n) < success / 2,
        "steps": draw.integers(5, 200, n),
        "grade": draw.random(n) * 10,
        "return": draw.normal(40, 50, n),
        "peak_force": draw.random(n) * 20,
        "mean_force": draw.random(n) * 9,
        "workspace_hits": draw.integers(0, 4, n),
        "force_hits": draw.integers(0, 4, n),
        "position_error": draw.random(n) * 0.1,
        "rotation_error": draw.random(n) * 3,
    }
    paths = np.zeros((2, n, 3))
    return Episodes(final, paths, paths[..., 0], torch.zeros(n, 12), torch.zeros(n))


def values_of(*trainings: Episodes):
    return episode_values(trainings, np.full(len(trainings[0].seeds), 20))


def test_every_number_in_the_scores_follows_from_the_file(phantom, grader, tmp_path):
    write_evaluation(evaluate("random", tmp_path, FEW, phantom, grader), tmp_path / "r.json", None)
    scores = read_json(tmp_path / "r.json", "agent-scores")
    path = tmp_path / scores["evidence"]["file"]
    assert path == tmp_path / "r.parquet" and scores["evidence"]["sha256"] == sha256_file(path)
    assert (scores["runs"], scores["trained"], "trainings" in scores) == (1, False, False)
    kept = Evidence.read(path).figures
    valued = {name for name, each in scores["metrics"].items() if each["value"] is not None}
    assert valued - {"latency"} == set(kept), "and times alone do not"
    for name, figures in kept.items():
        told = scores["metrics"][name]
        assert figures.interval(*range_of(name)).to_json(told.get("unit")) == told, name
        assert told["settings"]["units"] <= 12 == len(kept["return"].items)


def test_what_a_metric_can_be_is_what_a_record_may_say():
    for name, what in METRICS.items():
        assert (what.least, what.most) == range_of(name), name
    for name in measure(values_of(episodes()))[0]:
        assert not name.endswith("_iqm") or METRICS[name[:-4]][2:] == range_of(name)


def test_the_same_evaluation_leaves_the_same_bytes(phantom, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        result = evaluate("random", tmp_path, replace(FEW, latency=0), phantom)
        write_evaluation(result, tmp_path / name / "r.json", None, force=False)
    one, two = (tmp_path / name / "r.parquet" for name in ("a", "b"))
    assert one.read_bytes() == two.read_bytes()
    write_evaluation(result, tmp_path / "b/r.json", None, force=False)  # the same, again


def test_trainings_are_kept_apart_and_widen_what_is_not_known():
    three = values_of(*(episodes(seed) for seed in range(3)))
    metrics, evidence = measure(three)
    steps = three["steps"]
    assert metrics["steps"]["value"] == pytest.approx(np.nanmean(steps, 1).mean())
    assert metrics["steps_median"]["value"] == pytest.approx(np.nanmedian(steps, 1).mean())
    middle = np.mean([stats.trim_mean(row, 0.25) for row in three["return"]])
    assert metrics["return_iqm"]["value"] == pytest.approx(middle)
    kept = evidence.figures["return"].values
    assert kept is not None and kept.shape == (3, 1, N)
    for name, told in metrics.items():
        assert told["settings"]["trainings"] == 3, name
        assert told["low"] <= told["value"] <= told["high"], name
    alone = measure({name: each[:1] for name, each in three.items()})[0]
    apart = [
        {**three, "final_grade": three["final_grade"] + [[0.0], [0.0], [shift]]} for shift in (0, 9)
    ]
    low, high = (measure(each)[0]["final_grade"] for each in apart)
    assert high["value"] - high["low"] > 2 * (low["value"] - low["low"])
    assert alone["final_grade"]["settings"]["trainings"] == 1


def test_the_interquartile_mean_is_scipys_to_the_last_bit():
    draw = np.random.default_rng(0)
    for count in range(1, 120):
        for values in (draw.normal(size=count), np.round(draw.normal(size=count)) * 7.1):
            assert interquartile_mean(values) == stats.trim_mean(values, 0.25)


def test_all_succeed_none_does_and_one_training_does_not():
    every = measure(values_of(episodes(success=1.1)))[0]["success_true"]
    assert (every["value"], every["high"]) == (1.0, 1.0)
    assert every["low"] == pytest.approx(stats.binomtest(N, N).proportion_ci(method="wilson").low)
    assert every["settings"]["interval"].startswith(f"Wilson, {N} units")
    for trainings in ([0.0], [0.5, 0.0]):
        several = [episodes(seed, success) for seed, success in enumerate(trainings)]
        metrics, evidence = measure(values_of(*several))
        for name in ("steps", "steps_median"):
            none = {"value": None, "low": None, "high": None, "n": 0}
            assert metrics[name] == none | {"unit": METRICS[name].unit}
            assert name not in evidence.figures
    assert metrics["success_true"]["value"] is not None


def test_a_single_start_has_no_interval_but_that_of_a_rate():
    metrics, evidence = measure(values_of(episodes(success=1.1, n=1)))
    ends = {name: (each["low"], each["high"]) for name, each in metrics.items()}
    assert ends.pop("success_true")[0] == pytest.approx(0.2065, abs=1e-4)
    rates = {name for name in ends if METRICS.get(name, METRICS["return"]).statistic == "rate"}
    assert all(ends[name] == (None, None) for name in ends.keys() - rates)
    assert evidence.figures["return"].interval().units == 1


def test_each_start_set_is_measured_by_itself():
    values = values_of(episodes(1), episodes(2))
    each = measure_by_seed(values, [7, 3])
    assert list(each) == ["7", "3"]
    second = {name: rows[:, N // 2 :] for name, rows in values.items()}
    assert each["3"] == measure(second)[0] and each["3"]["return"]["n"] == N // 2


def test_no_evidence_is_overwritten_in_silence(phantom, tmp_path):
    """A Parquet file of someone's beside scores to be, and one changed under scores that are."""
    result = evaluate("random", tmp_path, replace(FEW, latency=0), phantom)
    out, kept = tmp_path / "mine.json", tmp_path / "mine.parquet"
    kept.write_bytes(b"images of mine")
    with pytest.raises(RacinesError, match=r"mine\.parquet.*--force"):
        write_evaluation(result, out, None, force=False)
    assert kept.read_bytes() == b"images of mine" and not out.exists()
    write_evaluation(result, out, None, force=True)
    other = evaluate("random", tmp_path, replace(FEW, latency=0, starts=5), phantom)
    before = kept.read_bytes(), out.read_bytes()
    with pytest.raises(RacinesError, match="another result"):
        write_evaluation(other, out, None, force=False)
    assert before == (kept.read_bytes(), out.read_bytes()), "neither is touched"
    assert json.loads(before[1])["evidence"]["file"] == "mine.parquet"
