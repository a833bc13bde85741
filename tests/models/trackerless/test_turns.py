"""Turns about an apex as sweeps: which frames follow one another, and what is told of them."""

import json
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.schema import SPLITS
from racines_data.sources.rotation.source import RotationSource
from racines_data.store.frames import FrameStore, open_store
from racines_leaderboard.cli.command import app
from racines_models.protocol import Run
from racines_models.trackerless.floors import ConstantMotion, MeanMotion, NoMotion
from racines_models.trackerless.metrics import TURNS as ANGLES
from racines_models.trackerless.pair_cnn.network import PairConfig
from racines_models.trackerless.pair_cnn.training import PairLearner, Pairs
from racines_models.trackerless.scoring import MotionScoresConfig, estimate_all, score_motion
from racines_models.trackerless.sweeps import EVERY, SweepSet
from tests.data.sources.rotation_folder import PHASES, TURNS, degrees_of, write_rotation

NO_METRES = "positions of these data have no metres"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rotation(tmp_path_factory.mktemp("turns") / "heart")


@pytest.fixture(scope="module")
def root(folder: Path) -> Path:
    return made(folder, folder.parent / "pixels")


def made(folder: Path, out: Path, **settings) -> Path:
    build(RotationSource.from_config(settings, [folder]), out, DataConfig(workers=1, shards=1))
    return out


def turns_of(store: FrameStore, rows: torch.Tensor) -> list[int]:
    names = [store.trajectories[place] for place in store.trajectory_index[rows].tolist()]
    return [int(name.removeprefix("turn-")) for name in names]


def test_a_sweep_has_a_splits_turns_in_the_order_of_the_file_at_one_phase(root: Path):
    store = open_store(root)
    sweeps, seen = SweepSet(store), 0
    for split in SPLITS:
        found = sweeps.sweeps(split)
        assert len(found) == PHASES and sweeps.left_out[split] == 0
        for phase, sweep in enumerate(found):
            turns = turns_of(store, sweep.rows)
            assert turns == sorted(set(turns)) and set(store.frame[sweep.rows].tolist()) == {phase}
            assert sweep.id == f"turn-{turns[0]:04d}-phase-{phase}"
        rows = torch.cat([each.rows for each in found])
        assert sorted(rows.tolist()) == sorted(store.split_indices(split).tolist())
        seen += len(rows)
    assert seen == len(store)


def test_all_turns_together_are_not_broken_by_the_splits(root: Path):
    sweeps = SweepSet(open_store(root))
    found = sweeps.sweeps(EVERY)
    assert [turns_of(sweeps.store, each.rows) for each in found] == [list(range(TURNS))] * PHASES
    assert len({each.number for each in found}) == len({each.id for each in found}) == PHASES
    assert {each.unit for each in found} == {0}  # one heart
    # About the beam it turns as the file has it, but for what the beam leans.
    true = torch.tensor(degrees_of()).diff()
    steps = torch.rad2deg(sweeps.steps(EVERY)[1][: TURNS - 1, 5])
    assert float((steps - true).abs().max()) < 0.1


def test_angles_alone_are_told_and_of_the_truth_none(root: Path, tmp_path: Path):
    sweeps = SweepSet(open_store(root))
    config = MotionScoresConfig()
    mean = MeanMotion()
    mean.fit(sweeps, Run(tmp_path, progress=False))
    told = {}
    for floor in (NoMotion(), ConstantMotion(), mean):
        motions = estimate_all([floor], sweeps, sweeps.sweeps("test"))
        told[floor.name] = score_motion(floor.name, motions, sweeps, config).content
    for content in told.values():
        assert set(content["metrics"]) == set(ANGLES)
        assert content["withheld"]["gpe"] == content["withheld"]["step_mm"] == NO_METRES
        assert content["counts"]["sweeps"] == PHASES
        step = content["metrics"]["step_deg"]
        assert step["value"] > 1.0 and step["low"] is None  # one heart has no interval
    true = [{each.id: each.motion for each in sweeps.sweeps("test")}]
    exact = score_motion("true", true, sweeps, config).content["metrics"]
    assert all(exact[key]["value"] < 1e-3 for key in ANGLES)


def test_with_a_scale_the_probes_way_is_told_in_millimetres(folder: Path, tmp_path: Path):
    sweeps = SweepSet(open_store(made(folder, tmp_path / "set", pixel_mm=0.5)))
    motions = estimate_all([NoMotion()], sweeps, sweeps.sweeps("test"))
    content = score_motion("no-motion", motions, sweeps, MotionScoresConfig()).content
    assert {"drift_mm", "step_mm", *ANGLES} == set(content["metrics"])
    assert content["withheld"]["gpe"].startswith("these data do not say where pixels lie")
    pairs, sweep = Pairs(sweeps, 3), sweeps.sweeps("train")[1]
    batch = pairs.take(sweep.rows[[1, 4]], torch.zeros(2, dtype=torch.int64))
    images = sweeps.shown(sweep).images
    assert torch.equal(batch.images, images[torch.tensor([[0, 0, 1], [2, 3, 4]])])


def test_pair_cnn_learns_nothing_without_metres(root: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="pair-cnn: .* have no metres.* with their scale"):
        PairLearner(SweepSet(open_store(root)), PairConfig(), Run(tmp_path, progress=False))


def test_the_command_scores_the_whole_file(root: Path, tmp_path: Path):
    words = ["--data", str(root), "--config", "frames", "--split", "all", "--out", str(tmp_path)]
    done = CliRunner().invoke(app, ["eval", "motion", "no-motion", *words, "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["counts"] == {"sweeps": PHASES, "frames": TURNS * PHASES, "left_out": 0}
    assert set(told["metrics"]) == set(ANGLES) and told["withheld"]["score"] == NO_METRES


def test_what_is_left_out_of_all_turns_is_counted_of_their_own_sweeps(root: Path):
    """A pose that is missing costs the whole file's sweep of its phase, as that of its split."""
    store = open_store(root)
    store.parameters = store.parameters.clone()
    store.parameters[store.split_indices("test")[0]] = torch.nan
    sweeps = SweepSet(store)
    lone = {"train": 0, "validation": 0, "test": 1, "all": 1}
    assert sweeps.left_out == lone and len(sweeps.sweeps("all")) == PHASES - 1
    # Of one turn alone no motion is told, but among all turns it is a step as any other.
    store = open_store(root)
    store.parameters = store.parameters.clone()
    rows = store.split_indices("validation")
    store.parameters[rows] = store.parameters[rows[:1]]
    sweeps = SweepSet(store)
    assert sweeps.left_out == {"train": 0, "validation": PHASES, "test": 0, "all": 0}
