"""The leakage report: what a random split of frames would have scored."""

import json

import pytest
import torch
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.studies.leakage import LeakageConfig, measure_leakage
from tests.data.fake_source import FakeConfig
from tests.data.validate.test_leaks import CopyingSource
from tests.models.conftest import pictures, random_parameters
from tests.models.labelled import LabelledStore

CONFIG = LeakageConfig(samples=60, resamples=200)


class SweepStore(LabelledStore):
    """Twenty sweeps of twenty frames; neighbours are near-copies, or frames are independent."""

    def __init__(self, sweeps: bool):
        super().__init__(trajectories=20, length=20)
        starts, ends = random_parameters(20, 1), random_parameters(20, 2)
        along = torch.linspace(0, 1, 20)[:, None]
        self.parameters = torch.lerp(starts[:, None], ends[:, None], 0.2 * along).flatten(0, 1)
        self.parameters[:, 9] = 3.1
        if not sweeps:
            self.parameters = random_parameters(400, 3)
        # What differs from sweep to sweep and no pose tells: gain, and where the block lies.
        gain = 0.5 + 0.5 * torch.rand(20).repeat_interleave(20) if sweeps else torch.ones(400)
        self.images = (pictures(self.parameters) * gain[:, None, None]).to(torch.uint8)
        self.timestamps = (torch.arange(20) / 25.0).repeat(20).double()
        self.sessions = ["session-1"] * 15 + ["session-2"] * 5


@pytest.fixture(scope="module")
def sweeps():
    torch.manual_seed(0)
    return measure_leakage(SweepStore(sweeps=True), CONFIG)


def test_near_copies_in_a_sweep_leak_under_a_split_of_frames(sweeps):
    gain, splits = sweeps.content["gain"], sweeps.content["splits"]
    assert gain["ssim"]["value"] > 0.05 and gain["psnr"]["value"] > 20
    assert gain["ssim"]["low"] > 0 and gain["psnr"]["low"] > 2, "six trajectories"
    assert splits["frame"]["psnr"]["low"] > splits["trajectory"]["psnr"]["high"]
    assert splits["frame"]["same_trajectory"] > 0.9 > splits["trajectory"]["same_trajectory"] == 0
    assert splits["frame"]["seconds"] == pytest.approx(0.04)
    assert splits["trajectory"]["seconds"] is None
    assert splits["frame"]["position_mm"] < splits["trajectory"]["position_mm"]
    assert splits["frame"]["rotation_deg"] < splits["trajectory"]["rotation_deg"]


def test_the_gain_is_that_of_the_same_frames(sweeps):
    splits = sweeps.content["splits"]
    for name in ("ssim", "psnr"):
        difference = splits["frame"][name]["value"] - splits["trajectory"][name]["value"]
        assert sweeps.content["gain"][name]["value"] == pytest.approx(difference)
    trajectory, frame = (sweeps.retrievals[name] for name in ("trajectory", "frame"))
    assert torch.equal(trajectory.sample.frames.index, frame.sample.frames.index)
    assert splits["frame"]["train"] == splits["trajectory"]["train"] == 240
    assert trajectory.sample.frames.index.min() >= 280  # the test split
    assert trajectory.sample.digest == sweeps.content["sample"]


def test_no_test_frame_finds_itself(sweeps):
    for retrieval in sweeps.retrievals.values():
        assert (retrieval.figures["psnr"] < 100).all()


@pytest.fixture(scope="module")
def independent():
    return SweepStore(sweeps=False)


@pytest.fixture(scope="module")
def unleaked(independent):
    return measure_leakage(independent, CONFIG).content


def test_independent_frames_do_not_leak(unleaked):
    content = unleaked
    for figure in content["gain"].values():
        assert figure["low"] < 0 < figure["high"]
    assert content["splits"]["frame"]["same_trajectory"] < 0.3


def test_seeds_decide_the_split_of_frames(independent, unleaked):
    same = measure_leakage(independent, CONFIG).content
    other = measure_leakage(independent, LeakageConfig(60, 1, 200)).content
    assert unleaked["gain"] == same["gain"] != other["gain"]


def test_a_held_out_session_is_a_split_of_its_own():
    store = SweepStore(sweeps=True)
    store.manifest["held_out_session"] = "session-2"
    found = measure_leakage(store, CONFIG)
    assert found.content["splits"]["session"]["train"] == 300
    assert found.retrievals["session"].sample.trajectory.min() >= 15
    assert found.content["splits"]["session"]["same_trajectory"] == 0


def test_data_without_poses_or_test_frames_are_refused():
    store = SweepStore(sweeps=True)
    store._splits["test"] = [400, 400]
    with pytest.raises(RacinesError, match="too few frames"):
        measure_leakage(store, CONFIG)
    store = SweepStore(sweeps=True)
    store.parameters[3, 8] = torch.nan
    with pytest.raises(RacinesError, match="no poses"):
        measure_leakage(store, CONFIG)


def test_command(workplace, monkeypatch):
    monkeypatch.chdir(workplace)
    words = ["study", "leakage", "--samples", "20", "--out", "report/leak"]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, done.exception
    content = json.loads(done.stdout)
    assert content["schema"] == "racines.leakage/1"
    assert content == json.loads((workplace / "report/leak.json").read_text())
    assert set(content["splits"]) == {"trajectory", "frame", "session"}
    assert (workplace / "report/leak.png").read_bytes()[:4] == b"\x89PNG"
    assert content["leaks"]["leaking"] == [] and len(content["leaks"]["trajectories"]) == 10
    shown = CliRunner().invoke(app, words).stdout
    assert "0 of 10 held-out trajectories leak (limits" in " ".join(shown.split())
    assert "of the same sweep" in shown and "what the split by frame adds" in shown


def test_command_fails_on_a_leak(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    build(CopyingSource(FakeConfig()), tmp_path / "racines", DataConfig(workers=1))
    words = ["study", "leakage", "racines", "--samples", "20", "--out", "leak"]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, RacinesError) and done.exit_code == 1
    assert "held-out trajectories leak: t0" in str(done.exception)
    leaks = json.loads((tmp_path / "leak.json").read_text())["leaks"]
    assert leaks["leaking"] and all(row["exact"] == 0 for row in leaks["trajectories"])
