"""Records that no computation can have made are refused, wherever they come from."""

import json
import math

import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.run import audit
from racines_leaderboard.board.collect import collect, read_board
from racines_leaderboard.records.ranges import RANGES, faults, range_of
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import TRACKS
from tests.conftest import ROOT
from tests.leaderboard.conftest import agent_scores, generator_scores

INVENTED = {
    "SSIM of 5": ("ssim", {"value": 5.0, "low": 4.9, "high": 5.1}),
    "FID of -50": ("fid", {"value": -50.0, "low": -60.0, "high": -40.0}),
    "KID of -5": ("kid", {"value": -5.0, "low": -6.0, "high": -4.0}),
    "PSNR of 400 dB": ("psnr", {"value": 400.0, "low": 399.0, "high": 401.0}),
    "an interval above its value": ("ssim", {"value": 0.5, "low": 0.6, "high": 0.7}),
    "an interval below its value": ("ssim", {"value": 0.5, "low": 0.3, "high": 0.4}),
    "an interval turned round": ("ssim", {"value": 0.5, "low": 0.6, "high": 0.4}),
    "an interval beyond the range": ("ssim", {"value": 0.9, "low": 0.8, "high": 1.2}),
    "half an interval": ("ssim", {"low": None}),
    "an interval of nothing": ("ssim", {"value": None}),
    "no frame": ("ssim", {"n": 0}),
}
INVENTED_AGENTS = {
    "success of 110 %": ("success_true", {"value": 1.1, "low": 1.0, "high": 1.2}),
    "steps backwards": ("steps", {"value": -3.0, "low": -4.0, "high": -2.0}),
    "grade 11": ("final_grade", {"value": 11.0, "low": 10.5, "high": 11.5}),
}


@pytest.mark.parametrize("case", INVENTED)
def test_an_invented_generator_is_not_collected(tmp_path, write_scores, case):
    name, lie = INVENTED[case]
    scores = generator_scores("liar")
    scores["metrics"][name] |= lie
    folder = write_scores("g", scores, generator_scores("honest"))
    with pytest.raises(RacinesError, match=rf"liar\.json: metrics\.{name}\.\w+: .*score it again"):
        collect([folder], tmp_path / "results", tmp_path, "b")
    assert not (tmp_path / "results").exists(), "nothing is written unless all are sound"


@pytest.mark.parametrize("case", INVENTED_AGENTS)
def test_an_invented_agent_is_not_collected(tmp_path, write_scores, case):
    name, lie = INVENTED_AGENTS[case]
    scores = agent_scores("liar")
    scores["metrics"][name] |= lie
    with pytest.raises(RacinesError, match=rf"liar\.json: metrics\.{name}"):
        collect([write_scores("a", scores)], tmp_path / "results", tmp_path, "b")


def test_a_start_set_cannot_lie_either(tmp_path, write_scores):
    scores = agent_scores("liar")
    scores["by_seed"] = {"1": {"spl": {"value": 2.0, "low": None, "high": None, "n": 4}}}
    with pytest.raises(RacinesError, match=r"by_seed\.1\.spl\.value: 2 is beyond"):
        collect([write_scores("a", scores)], tmp_path / "results", tmp_path, "b")


def test_a_record_put_on_a_board_by_hand_is_refused_and_does_not_hold(tmp_path, write_scores):
    results = tmp_path / "results"
    (path,) = collect([write_scores("g", generator_scores("one"))], results, tmp_path, "b")
    record = json.loads(path.read_text())
    record["scores"]["metrics"]["ssim"] |= {"value": 5.0, "low": 4.9, "high": 5.1}
    path.write_text(json.dumps(sealed(record)))
    with pytest.raises(RacinesError, match=r"one\.json: scores: metrics\.ssim\.value"):
        read_board(results, "b")
    report = audit(path, Bench("b", Places(results=results)), quick=True)
    assert not report.holds


def test_every_metric_that_is_shown_has_a_range():
    shown = {c.key for track in TRACKS for c in (*track.columns, *track.details)}
    assert {key for key in shown if range_of(key) == (-math.inf, math.inf)} == {"return"}


def test_published_records_are_possible_and_each_range_is_met_by_one():
    met = set()
    for path in (ROOT / "leaderboard/results").glob("*/*/*.json"):
        metrics = json.loads(path.read_text())["scores"]["metrics"]
        for name, metric in metrics.items():
            assert not list(faults(name, metric)), (path, name)
            met.add(range_of(name))
    assert met >= set(RANGES.values())
