"""Experience gathered by groups of environments."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from typer.testing import CliRunner

from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_envs.agents import gathering
from racines_envs.agents.dqn import DQNAgent, DQNConfig
from racines_envs.agents.gathering import gathered
from racines_envs.agents.ppo import PPOAgent, PPOConfig, PPOTraining
from racines_envs.agents.sac import SACAgent, SACConfig
from racines_leaderboard.cli.command import app
from tests.envs.fakes import FakePhantom

SMALL: dict[str, Any] = {
    "frames": 512,
    "update_every": 256,
    "envs": 8,
    "epochs": 1,
    "validation_starts": 4,
}


def run_of(folder: Path, **settings: Any) -> PPOTraining:
    config = PPOConfig(**SMALL | settings)
    run = PPOTraining(PPOAgent, config, folder, 3, FakePhantom(), None, False)
    with torch.random.fork_rng():
        torch.manual_seed(3)
        run._build()
    return run


def test_groups_have_episodes_of_their_own_and_go_on_with_them(tmp_path: Path):
    run = run_of(tmp_path, collectors=2)
    turns = gathered(run, None)
    one, other = next(turns), next(turns)
    assert one.shape == other.shape == (8, 32)
    # Rows start as those of one group do.
    run.env.set_seed(run.starts)
    torch.testing.assert_close(one["params"][:, 0], run.env.reset()["params"])
    ended = one["next", "done"][:, -1, 0]
    steps = one["next", "info", "steps"][:, -1, 0], other["next", "info", "steps"][:, 0, 0]
    assert torch.equal(steps[1], torch.where(ended, 1, steps[0] + 1))
    assert torch.equal(other["params"][~ended, 0], one["next", "params"][~ended, -1])
    actions = one["action"].view(2, 4, 32)
    assert not torch.equal(actions[0], actions[1]), "random numbers of their own"


def test_what_a_process_holds_changes_nothing(tmp_path: Path):
    ends = []
    for place in ("cold", "warm", "cold again"):
        if place != "warm":
            gathering._made.clear()
        config = PPOConfig(**SMALL, collectors=2)
        PPOAgent.train(config, tmp_path / place, seed=3, phantom=FakePhantom(), progress=False)
        ends.append((tmp_path / place / "policy.safetensors").read_bytes())
        assert json.loads((tmp_path / place / "metrics.json").read_text())["frames"] == 512
    assert ends[0] == ends[1] == ends[2]


@pytest.mark.parametrize(
    ("agent", "settings"),
    [(DQNAgent, DQNConfig), pytest.param(SACAgent, SACConfig, marks=pytest.mark.thorough)],
)
def test_what_keeps_experience_gathers_it_so_too(agent: Any, settings: Any, tmp_path: Path):
    for place in ("one", "other"):
        config = settings(
            frames=512, update_every=256, envs=8, warmup=256, validation_starts=4, collectors=2
        )
        agent.train(config, tmp_path / place, seed=1, phantom=FakePhantom(), progress=False)
    files = [tmp_path / place / "policy.safetensors" for place in ("one", "other")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_group_acts_by_the_weights_of_its_turn(tmp_path: Path):
    run = run_of(tmp_path, collectors=4)
    turns = gathered(run, None)
    next(turns)
    with torch.no_grad():
        for weight in run.actor.parameters():
            weight.zero_()
        [*run.actor.parameters()][-1][5] = 50.0  # the bias of an action's logit
    assert (next(turns)["action"] == 5).all()


class Noting(LocalEngine):
    """Tells what it was given to do."""

    done: ClassVar[list[tuple[Any, int]]] = []

    def map(self, work: Any, state: Any, tasks: Any, *told: Any, **more: Any) -> Iterator[Any]:
        tasks = list(tasks)
        self.done.append((work, len(tasks)))
        return super().map(work, state, tasks, *told, **more)


def test_the_command_gives_turns_and_not_seeds_to_its_engine(tmp_path: Path, monkeypatch: Any):
    monkeypatch.chdir(tmp_path)
    Noting.done.clear()
    settings = ["--set", "collectors=2", "--set", "update_every=256", "--set", "envs=8"]
    settings += ["--frames", "512", "--reward", "oracle", "--set", "validation_starts=4"]
    called = ["train", "agent", "ppo", *settings, "--engine", f"{__name__}:Noting", "--json"]
    told = CliRunner().invoke(app, called)
    assert told.exit_code == 0, told.output
    assert Noting.done == [(gathering.gather, 2)] * 2
    assert (
        json.loads(Path("envs/runs/ppo/metrics.json").read_text(encoding="utf-8"))["frames"] == 512
    )


def test_groups_are_of_one_size(tmp_path: Path):
    with pytest.raises(RacinesError, match=r"ppo.collectors is 3: give a divisor of envs \(8\)"):
        run_of(tmp_path, collectors=3)
