"""What scores rest on: kept beside them, and enough to make every figure again."""

import hashlib
import json

import numpy as np
import polars as pl
import pytest
import torch

from racines_data.errors import RacinesError
from racines_leaderboard.records.ranges import check_possible
from racines_leaderboard.records.schema import read_json
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from racines_models.sample import draw, take_sample
from racines_models.scores import scorer as module
from racines_models.scores import scoring
from racines_models.scores.metrics import fid
from racines_models.scores.plugin import Metric
from racines_models.scores.scorer import Scorer, ScoresConfig
from racines_models.scores.scoring import score
from racines_models.statistics import Evidence, write_scores
from tests.models.labelled import LabelledStore, Replay
from tests.models.scores.test_scores import COUNT, QUICK, Coarse, Noise
from tests.models.scores.test_scores_more import KnownPose, Upside

PLAIN = {"distinct"}
"""A count, without an interval."""


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(scoring, "InceptionFeatures", Coarse)


@pytest.fixture(scope="module")
def labelled():
    return LabelledStore(trajectories=20, length=12)


class Trained(Noise):
    """Noise whose trainings differ in how dark their images are."""

    def __init__(self, store, darker):
        super().__init__(store)
        self.darker = darker

    def generate(self, parameters, seed):
        return (super().generate(parameters, seed) * (1 - self.darker)).byte()


def judges(store):
    network = GraderNetwork(32, 0.125)
    return {"grader": Grader(network, GraderConfig(input_size=32, width=0.125, bf16=False))}


def same(told, found) -> bool:
    """Whether a figure in JSON is what the evidence gives, to the last bit."""
    settings = told["settings"]
    said = *(told[key] for key in ("value", "low", "high", "n")), settings["units"]
    here = found.value, found.low, found.high, found.n, found.units
    method = (settings["interval"], settings["trainings"]) == (found.method, found.trainings)
    return said == here and method


def test_every_figure_follows_from_the_file_alone(labelled, tmp_path, monkeypatch):
    each = Metric("dark", "Dark", "lower", lambda a, b: (a.images * 0.2).mean((1, 2)), minimum=0.0)
    whole = Metric("far", "Far", "lower", lambda a, b: (a - b).norm(), features=True, minimum=0.0)
    monkeypatch.setattr(module, "installed_metrics", lambda: [each, whole])
    runs = [Trained(labelled, darker) for darker in (0.1, 0.2, 0.15)]
    scores = score(runs, labelled, QUICK, "noise", seeds=[0, 1, 2], **judges(labelled))
    path = tmp_path / "noise.json"
    content = write_scores(path, scores.content, scores.evidence)
    read = read_json(path, "generator-scores")
    assert read == json.loads(json.dumps(content)) and read["runs"] == 3 and read["trained"] is True
    beside = tmp_path / read["evidence"]["file"]
    assert read["evidence"]["sha256"] == hashlib.sha256(beside.read_bytes()).hexdigest()

    kept = Evidence.read(beside)
    assert kept.figures.keys() == read["metrics"].keys() - PLAIN
    for name, figures in kept.figures.items():
        told = read["metrics"][name]
        assert same(told, figures.interval()), name
        trainings = 1 if name.endswith("_truth") else 3
        assert told["settings"]["trainings"] == trainings and told["settings"]["units"] == 6, name
        by_set = told["settings"].get("by_set", [told["value"]])
        assert by_set == figures.replicates().whole.tolist() and len(by_set) == trainings
    check_possible(read, "scores")
    # Whatever ranks has replicates over the same blocks, and so do scores made of it.
    shapes = {
        kept.figures[name].replicates().without.shape for name in ("ssim", "psnr", "fid", "kid")
    }
    assert shapes == {(3, 6)}
    truth = take_sample(labelled, "test", COUNT).frames
    assert (kept.figures["ssim"].items == truth.index.numpy()).all()


def test_replicates_of_a_set_are_those_of_the_images_that_are_left(labelled):
    runs = [Trained(labelled, 0.1), Trained(labelled, 0.3)]
    found = score(runs, labelled, QUICK, "noise", seeds=[0, 1, 2]).evidence.figures["fid"]
    sample, embed = take_sample(labelled, "test", COUNT), Coarse()
    truth = embed(sample.frames.images)
    left = sample.trajectory != np.unique(sample.trajectory)[2]
    for k, seeds in ((0, (0, 2)), (1, (1, 3))):  # in turns, each training as often
        drawn = [embed(draw(runs[k], sample.frames, seed)) for seed in seeds]
        whole = np.mean([fid(each, truth) for each in drawn])
        without = np.mean([fid(each[left], truth[left]) for each in drawn])
        assert found.whole.whole[k] == pytest.approx(whole, rel=1e-6)
        assert found.whole.without[k, 2] == pytest.approx(without, rel=1e-6)


def test_trainings_apart_widen_every_interval(labelled):
    def told(*darker):
        runs = [Trained(labelled, each) for each in darker]
        return score(runs, labelled, QUICK, "noise").content["metrics"]

    apart, alike = told(0.0, 0.4), told(0.2, 0.2)
    for name in ("ssim", "psnr", "fid", "kid"):
        width = [each[name]["high"] - each[name]["low"] for each in (apart, alike)]
        assert width[0] > 2 * width[1], name
        assert "t over 2 trainings" in apart[name]["settings"]["interval"]
    # A training is as diverse as its own draws, not as the trainings are apart.
    assert apart["diversity"]["settings"]["trainings"] == 2
    assert apart["diversity"]["value"] < 20


def test_scored_twice_it_is_the_same_bytes(labelled):
    made = [
        score(
            Noise(labelled), labelled, QUICK, "noise", seeds=[0, 1], pose=None
        ).evidence.to_bytes()
        for _ in range(2)
    ]
    assert made[0] == made[1]
    other = score(Noise(labelled), labelled, QUICK, "noise", seeds=[0, 2]).evidence.to_bytes()
    assert other != made[0]


def test_frames_without_a_measurement_are_null_and_not_counted(tmp_path):
    store = LabelledStore(trajectories=20, length=13)
    scores = score(Upside(store), store, QUICK, "any", pose=KnownPose(store), **judges(store))
    views = scores.sample.frames.views
    scores.evidence.write(tmp_path / "any.parquet")
    table = pl.read_parquet(tmp_path / "any.parquet")
    for name in ("pose_error_mm_view", "grade_error", "grade_agreement_truth"):
        values = table.filter(metric=name)["value"]
        assert (values.is_null().to_numpy() == (views == 5).numpy()).all()
        told = scores.content["metrics"][name]
        assert told["n"] == int((views != 5).sum()) < COUNT == len(values)
        assert same(told, Evidence.read(tmp_path / "any.parquet").figures[name].interval())


def test_a_view_that_one_trajectory_alone_shows_has_a_median_without_an_interval():
    store = LabelledStore(trajectories=20, length=13)
    sample = take_sample(store, "test", COUNT)
    alone = torch.from_numpy(sample.trajectory == sample.trajectory[0])
    store.views[:] = 5
    frames = sample.frames._replace(views=torch.where(alone, 0, 5))
    sample = type(sample)(frames, sample.trajectory)
    judge = Scorer(ScoresConfig(), store, sample, [frames.images])
    told = judge.poses(KnownPose(store))["pose_error_mm_view"]
    assert told["value"] == pytest.approx(0.0, abs=1e-3) and told["n"] == int(alone.sum())
    assert told["low"] is None and told["settings"]["units"] == 1


def test_one_trajectory_has_figures_and_no_interval(tmp_path):
    store = LabelledStore(trajectories=1, length=12)
    store._splits["test"] = [0, 12]
    scores = score(Replay(store, 0.1), store, QUICK, "replay")
    content = write_scores(tmp_path / "replay.json", scores.content, scores.evidence)
    kept = Evidence.read(tmp_path / "replay.parquet")
    for name, figures in kept.figures.items():
        told = content["metrics"][name]
        # A rate of none or all is bounded by one trajectory too, if loosely: a single trial.
        assert told["low"] is None or name.startswith("copies"), name
        assert same(content["metrics"][name], figures.interval())


def test_two_frames_of_two_trajectories_can_be_scored():
    """Without one of them no set is left that has a spread."""
    store = LabelledStore(trajectories=10, length=12)
    content = score(Replay(store, 0.1), store, ScoresConfig(samples=2, speed=False), "few").content
    assert content["metrics"]["fid"]["low"] is None
    assert content["metrics"]["ssim"]["low"] is not None


def test_whether_a_method_is_trained_is_said_by_its_card(labelled):
    class Card:
        stochastic, trained = False, False

    class Fixed(Replay):
        card = Card()

    assert score(Fixed(labelled), labelled, QUICK, "fixed").content["trained"] is False
    assert score(Replay(labelled), labelled, QUICK, "unknown").content["trained"] is True


def test_a_metric_without_a_finite_value_is_refused(labelled, monkeypatch):
    for metric, reason in (
        (Metric("m", "M", "lower", lambda a, b: a.images[:, 0, 0] * torch.nan), "no value of any"),
        (Metric("m", "M", "lower", lambda a, b: float("nan"), features=True), "not finite"),
    ):
        monkeypatch.setattr(module, "installed_metrics", lambda metric=metric: [metric])
        with pytest.raises(RacinesError, match=f"metric 'm': .*{reason}"):
            score(Replay(labelled), labelled, QUICK, "any")


def test_a_thousand_frames_of_three_trainings_are_less_than_a_megabyte():
    """Figures that do not compress; the names and number of those of a phantom's scores."""
    random, frames, kept = np.random.default_rng(0), 1024, Evidence()
    units = np.sort(random.integers(0, 140, frames))
    for k in range(14):
        kept.add(f"drawn_{k}", "mean", random.random((3, 1, frames)), np.arange(frames), units)
    for k in range(11):
        kept.add(f"truth_{k}", "median", random.random((1, 1, frames)), np.arange(frames), units)
    assert len(kept.to_bytes()) < 1 << 20


def scored(folder, evidence=None, force=False, value=1.0):
    kept = Evidence()
    kept.add("ssim", "mean", np.full(6, value), np.arange(6), np.arange(6))
    metrics = {"ssim": kept.figures["ssim"].interval().to_json()}
    return write_scores(folder / "a.json", {"metrics": metrics}, evidence or kept, force)


def test_what_is_there_is_replaced_only_when_told(tmp_path):
    scored(tmp_path)
    scored(tmp_path)  # the same may be written again
    both = [(tmp_path / name).read_bytes() for name in ("a.json", "a.parquet")]
    with pytest.raises(RacinesError, match="another result.*--force"):
        scored(tmp_path, value=0.5)
    assert both == [(tmp_path / name).read_bytes() for name in ("a.json", "a.parquet")]
    scored(tmp_path, value=0.5, force=True)
    told = json.loads((tmp_path / "a.json").read_text())
    assert Evidence.read(tmp_path / "a.parquet").figures["ssim"].interval().value == 0.5
    assert told["metrics"]["ssim"]["value"] == 0.5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.parquet"]


def test_a_strangers_file_in_the_place_of_the_evidence_stays(tmp_path):
    (tmp_path / "a.parquet").write_bytes(b"predictions, say")
    with pytest.raises(RacinesError, match=r"a\.parquet: is there, and is not.*--force"):
        scored(tmp_path)
    assert (tmp_path / "a.parquet").read_bytes() == b"predictions, say"
    assert not (tmp_path / "a.json").exists()


def test_killed_between_the_two_files_it_is_not_half_a_result(tmp_path, monkeypatch):
    from racines_models.statistics import evidence

    def killed(path, content):
        raise KeyboardInterrupt

    scored(tmp_path)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(evidence, "write_json", killed)
        scored(tmp_path, value=0.5, force=True)
    told = json.loads((tmp_path / "a.json").read_text())["evidence"]["sha256"]
    # The scores are the former ones, and name other evidence than is there now.
    assert told != hashlib.sha256((tmp_path / "a.parquet").read_bytes()).hexdigest()
    scored(tmp_path, value=0.5, force=True)
    told = json.loads((tmp_path / "a.json").read_text())["evidence"]["sha256"]
    assert told == hashlib.sha256((tmp_path / "a.parquet").read_bytes()).hexdigest()
