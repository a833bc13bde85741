"""`racines study speed`: what it prints, that its timers change nothing, and what it refuses."""

import json
from typing import Any

import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.apis.gym_env import VectorScanEnv
from racines_envs.studies.step_profile import PHASES, SpeedConfig, Stopwatch, attach, step_speed
from racines_envs.worlds.making import make_core
from racines_leaderboard.cli.command import app


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_the_command_tells_speeds_and_shares(real_phantom):
    words = ["study", "speed", "--num-envs", "2", "--set", "steps=2", "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    content = json.loads(done.stdout)
    assert content["schema"] == "racines.speed/1" and content["observation"] == "image"
    (run,) = content["runs"]
    assert run["num_envs"] == 2 and 0 < run["low"] <= run["steps_per_second"] <= run["high"]
    assert set(run["shares"]) == set(PHASES)
    assert sum(run["shares"].values()) == pytest.approx(1.0)
    assert run["shares"]["render"] > 0.0 and run["shares"]["grade"] == 0.0
    assert len(run["operations"]) == 5
    shares = [each["share"] for each in run["operations"]]
    assert shares == sorted(shares, reverse=True) and 0 < sum(shares) <= 1


@pytest.mark.thorough
def test_patients_are_timed_as_the_one_heart_is(hearts, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(hearts))
    words = ["study", "speed", "--view", "SC-beating", "--num-envs", "2", "--set", "steps=1"]
    done = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    content = json.loads(done.stdout)
    shares = content["runs"][0]["shares"]
    assert content["view"] == "SC-beating" and shares["render"] > 0.0 and shares["truth"] > 0.0


def test_params_with_the_oracle_draw_nothing(real_phantom):
    words = ["study", "speed", "--observation", "params", "--num-envs", "1,2", "--set", "steps=2"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    rows = [line.split("|") for line in done.stdout.splitlines() if line.endswith("% |")]
    assert [(row[1].strip(), row[3].strip()) for row in rows] == [("1", "0%"), ("2", "0%")]


class Clock(Stopwatch):
    """A stopwatch whose time goes on only while a part works, by as much as is said."""

    time = 0.0

    def now(self) -> float:
        return self.time

    def slow(self, part: Any, method: str, seconds: float) -> None:
        """Let each call of a part's method take so many seconds."""
        work = getattr(part, method)

        def run(*arguments: Any) -> Any:
            self.time += seconds
            return work(*arguments)

        setattr(part, method, run)


def test_each_phase_gets_its_own_time(phantom, grader):
    core = make_core("SC", 2, phantom=phantom, grader=grader)
    clock = Clock(core.device)
    clock.slow(core.images, "generate", 1.0)
    clock.slow(grader, "probabilities_and_grade", 10.0)
    clock.slow(phantom, "judge", 100.0)
    clock.slow(phantom, "wrench", 1000.0)
    clock.slow(core, "_reward", 1e4)
    attach(core, clock)
    core.reset(0)
    once = dict(clock.seconds)
    core.step(torch.tensor([0, 12]))
    told = {name: seconds - once[name] for name, seconds in clock.seconds.items()}
    assert told == {
        "render": 1.0, "grade": 10.0, "truth": 100.0, "contact": 1000.0, "reward": 1e4, "rest": 0.0,
    }  # fmt: skip
    assert sum(clock.seconds.values()) == clock.time


def test_timers_change_no_result(phantom, grader):
    cores = [make_core("SC", 3, phantom=phantom, grader=grader) for _ in range(2)]
    attach(cores[1], Stopwatch(cores[1].device))
    for core in cores:
        core.reset(0)
    for action in torch.randint(13, (20, 3), generator=torch.Generator().manual_seed(0)):
        a, b = (core.step(action, autoreset=True) for core in cores)
        assert torch.equal(a.observation["image"], b.observation["image"])
        assert torch.equal(a.reward, b.reward) and torch.equal(a.terminated, b.terminated)


def test_what_measures_nothing_is_refused(phantom):
    with pytest.raises(RacinesError, match="1 or more"):
        SpeedConfig(num_envs=(0,))
    with pytest.raises(RacinesError, match="1 or more"):
        step_speed(SpeedConfig(steps=0), phantom)
    assert CliRunner().invoke(app, ["study", "speed", "--threads", "0"]).exit_code == 2
    assert CliRunner().invoke(app, ["study", "speed", "--num-envs", "x"]).exit_code == 2


def test_a_row_of_many_is_the_row_alone_to_the_last_bit(real_phantom):
    many = VectorScanEnv("SC", 40, observation="params", reward="oracle")
    alone = [VectorScanEnv("SC", 1, observation="params", reward="oracle") for _ in range(40)]
    many.reset(seed=0)
    for seed, env in enumerate(alone):
        env.reset(seed=seed)
    for action in torch.randint(13, (6, 40), generator=torch.Generator().manual_seed(1)).numpy():
        told = many.step(action)[1]
        assert told.tolist() == [env.step(action[i : i + 1])[1][0] for i, env in enumerate(alone)]
