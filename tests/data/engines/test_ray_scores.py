"""What Ray evaluates, scores, annotates and audits has the numbers of this process, bit by bit."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.build.dataset import DataConfig, build
from racines_data.engines import LOCAL
from racines_data.engines.ray import RayEngine
from racines_data.errors import RacinesError
from racines_data.store.asked import AskedStore
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.random import RandomAgent
from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients
from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
from racines_leaderboard.audit.bench import Places
from racines_leaderboard.audit.run import audit_all
from racines_models.cli.device import spread
from racines_models.generators.nearest_pose import NearestPose
from racines_models.judges.grader.annotate import annotate
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
from racines_models.judges.segmentation.model import (
    SegmentationConfig,
    SegmentationJudge,
    SegmentationNetwork,
)
from racines_models.provenance import same_result
from racines_models.scores import scoring
from racines_models.scores.on_patients import Judges, PatientScoresConfig, score_on_patients
from racines_models.scores.scoring import ScoresConfig, score
from tests.conftest import ROOT
from tests.data.build.test_build import files
from tests.data.engines.tasks import DyingAgent
from tests.data.fake_source import FakeConfig, FakeSource
from tests.envs.fakes import FakeGrader, FakePhantom
from tests.models.labelled import LabelledStore, Replay
from tests.models.scores.test_scores import Coarse

FEW = EvaluationConfig(starts=8, resamples=50, latency=0)


def written(result: Any, folder: Path) -> tuple[dict[str, Any], bytes]:
    """Return the scores file, and the bytes of its evidence."""
    folder.mkdir()
    path = folder / "random.json"
    write_evaluation(result, path, None)
    return json.loads(path.read_text()), path.with_suffix(".parquet").read_bytes()


def test_an_agents_numbers_are_equal_though_a_worker_is_killed(engine: RayEngine, tmp_path: Path):
    grader, dying = FakeGrader(), DyingAgent(tmp_path)
    here = evaluate("random", tmp_path, FEW, None, grader, RandomAgent())
    there = evaluate("random", tmp_path, FEW, None, grader, dying, engine=engine)
    assert (tmp_path / "agent.died").exists(), "a worker was killed in the middle of a set"
    for name in ("positions", "probabilities"):
        assert (getattr(there.episodes, name) == getattr(here.episodes, name)).all()
    assert torch.equal(there.episodes.parameters, here.episodes.parameters)
    (one, items), (other, others) = (
        written(each, tmp_path / str(place)) for place, each in enumerate((here, there))
    )
    assert same_result(one, other) and items == others


def test_numbers_on_patients_are_equal(engine: RayEngine, tmp_path: Path):
    config = PatientsConfig(view="A4C-patients", patients=3, starts=2, chunk=2)
    found = [evaluate_patients("random", tmp_path, config, engine=by) for by in (None, engine)]
    (one, items), (other, others) = (
        written(each, tmp_path / str(place)) for place, each in enumerate(found)
    )
    assert same_result(one, other) and items == others


def judges() -> tuple[Grader, PoseRegressor]:
    torch.manual_seed(0)
    grader = Grader(GraderNetwork(32, 0.125), GraderConfig(input_size=32, width=0.125))
    return grader, PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125))


@pytest.mark.parametrize("extractor", [Coarse, pytest.param(None, marks=pytest.mark.thorough)])
def test_a_generators_numbers_are_equal(
    engine: RayEngine, extractor: Any, monkeypatch: pytest.MonkeyPatch
):
    if extractor is not None:
        monkeypatch.setattr(scoring, "InceptionFeatures", extractor)
    store, (grader, pose) = LabelledStore(trajectories=20, length=12), judges()
    config = ScoresConfig(samples=24, speed=False)
    drawn: list[Any] = [Replay(store, 0.2)]
    found = [
        score(drawn, store, config, "replay", grader, pose, engine=by) for by in (None, engine)
    ]
    here, there = (each.content for each in found)
    assert same_result(here, there) and torch.equal(found[0].images, found[1].images)
    assert {"fid", "fid_grader", "pose_error_mm"} <= set(here["metrics"])


@pytest.mark.thorough
def test_a_generators_numbers_on_patients_are_equal(engine: RayEngine):
    _, pose = judges()
    config = SegmentationConfig(channels=2, input_size=64, patch=2)
    judge = SegmentationJudge(SegmentationNetwork(config), config)
    looks = Judges(pose, judge, Coarse())
    wanted = PatientScoresConfig(patients=2)
    found, drawn = [], []
    for by in (None, engine):
        asked = AskedStore("validation", 2, 0, engine=by)
        scores = score_on_patients([NearestPose()], asked, wanted, "near", looks, engine=by)
        drawn.append((asked.images, asked.scouts, asked.masks, scores.images))
        found.append(scores.content)
        found[-1]["metrics"].pop("seconds_to_adapt")
    assert all(torch.equal(*each) for each in zip(*drawn, strict=True))
    assert same_result(*found) and {"fid", "dice", "pose_error_mm"} <= set(found[0]["metrics"])


def test_annotations_are_equal(engine: RayEngine, tmp_path: Path):
    build(FakeSource(FakeConfig(frames=60)), tmp_path / "racines", DataConfig(workers=1, shards=2))
    grader, _ = judges()
    grader.save(tmp_path / "grader")
    for name, by in (("here", None), ("ray", engine)):
        annotate(tmp_path / "racines", grader, tmp_path / name, engine=by)
    assert files(tmp_path / "ray") == files(tmp_path / "here")


def test_audits_are_equal(engine: RayEngine, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(ROOT)
    paths = sorted(Path("leaderboard/results").glob("*/generators/*.json"))[:3]
    here, there = (list(audit_all(paths, Places(), True, by)) for by in (None, engine))
    assert len(here) == 3 and here == there


def test_a_command_takes_no_device_that_workers_have_not():
    with spread(LOCAL, None, "cuda") as opened:
        assert opened is None
    with pytest.raises(RacinesError, match="--engine ray works on CPUs: give --device cpu"):
        spread("ray", None, "cuda")


def test_experience_is_equal(engine: RayEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    turns: list[int] = []
    given = engine.map

    def counted(work: Any, state: Any, tasks: Any, *told: Any) -> Any:
        turns.append(len(tasks))
        return given(work, state, tasks, *told)

    monkeypatch.setattr(engine, "map", counted)
    config = PPOConfig(
        frames=32, update_every=16, envs=4, epochs=1, validation_starts=1, collectors=2
    )
    for name, by in {"here": None, "ray": engine}.items():
        where = {"phantom": FakePhantom(), "progress": False, "engine": by}
        PPOAgent.train(config, tmp_path / name, seed=3, **where)
    here, there = (
        (tmp_path / name / "policy.safetensors").read_bytes() for name in ("here", "ray")
    )
    assert here == there and turns == [2, 2], "two turns of two groups, on the workers"
