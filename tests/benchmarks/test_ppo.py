"""Speed of PPO from end to end, beside Stable-Baselines3 and a plain loop, on `racines/SC-v0`.

All learn from the probe's pose, 64 environments, the same networks, batch and settings, rates that
fall to zero among them, on one thread each, which is quickest for networks this small. How
observations are standardised, rewards scaled and values judged is each one's own. Trainings cannot
be equal, since each draws its numbers in its own order: held is that each of the three, before any
is timed, finds the view from more of the validation starts than an untrained policy does after
`LEARNED` frames. There the peers learn on our batched environments, which equal their own
vector environments of single ones row by row (tests/envs) and are quicker.
"""

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import pytest
import torch
from gymnasium.vector import SyncVectorEnv
from torch import Tensor, nn

from racines_data.phantom import shared_phantom
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.rollout import rollout
from racines_envs.task.starts import validation_seeds
from racines_envs.worlds.making import make_core
from tests.benchmarks.lines import line_of
from tests.benchmarks.peers.loop import Loop
from tests.benchmarks.turns import Times

TASK = "racines_envs:racines/SC-v0"
SETTINGS: dict[str, Any] = {"observation": "params", "reward": "shaped"}
FRAMES, LEARNED, ROUNDS = 8_192, 65_536, 3
CONFIG = PPOConfig(frames=FRAMES, validate_every=1 << 30, validation_starts=1)
EQUAL = "networks, batch, settings; each learns"
SB3, PLAIN = "Stable-Baselines3, its DummyVecEnv", "CleanRL-style loop, SyncVectorEnv"
BATCHED = "CleanRL-style loop on our batched environment"


@pytest.mark.timeout(600)
@pytest.mark.slow
def test_ppo_end_to_end(benchmark, line, tmp_path: Path) -> None:
    shared_phantom()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    sides: dict[str, Callable[[int], float]] = {
        "ours": lambda turn: train_ours(tmp_path / str(turn), turn, FRAMES)[1],
        BATCHED: lambda turn: train_loop(turn, FRAMES, batched=True)[1],
        PLAIN: lambda turn: train_loop(turn, FRAMES, batched=False)[1],
        SB3: lambda turn: train_sb3(turn, FRAMES, batched=False)[1],
    }
    try:
        assert_each_learns(tmp_path / "learned")
        times: Times = {name: [] for name in sides}
        for turn in range(ROUNDS):
            for name, train in sides.items():
                times[name].append(train(turn))
        benchmark.pedantic(lambda: sides["ours"](ROUNDS), rounds=1)
    finally:
        torch.set_num_threads(threads)
    work = "PPO, 64 environments, pose"
    for peer, aim in ((SB3, 1.5), (PLAIN, None), (BATCHED, None)):
        line(line_of(work, "frames/s", FRAMES, times, peer, EQUAL, aim))


def assert_each_learns(folder: Path) -> None:
    """Check that all, after equally many frames, find the view far oftener than at the start."""
    untrained = success(make_actor(CONFIG).eval())
    found = {
        "ours": success(train_ours(folder, 0, LEARNED)[0].actor),
        "loop": success(train_loop(0, LEARNED, batched=True)[0].actor),
        "SB3": success(train_sb3(0, LEARNED, batched=True)[0]),
    }
    print(f"success after {LEARNED:,} frames: {found}; untrained {untrained}")
    assert min(found.values()) > untrained + 0.1, (found, untrained)


def train_ours(folder: Path, seed: int, frames: int) -> tuple[Any, float]:
    """Train as `racines train agent ppo` does; return the agent and the seconds of its loop."""
    config = PPOConfig(frames=frames, validate_every=1 << 30, validation_starts=1)
    agent = PPOAgent.train(config, folder, seed=seed, progress=False)
    return agent, json.loads((folder / "metrics.json").read_text())["seconds"]


def train_loop(seed: int, frames: int, batched: bool) -> tuple[Loop, float]:
    """Train the plain loop on our vector environment, or on one that steps 64 single ones."""
    single = partial(gymnasium.make, TASK, **SETTINGS)
    envs = (
        gymnasium.make_vec(TASK, num_envs=CONFIG.envs, **SETTINGS)
        if batched
        else SyncVectorEnv([single] * CONFIG.envs)
    )
    loop = Loop(CONFIG, seed)
    try:
        return loop, loop.train(envs, frames, seed)
    finally:
        envs.close()


class Actor(nn.Module):
    """The logits of a policy of Stable-Baselines3, behind the normalisation it learned with."""

    keys = ("params",)

    def __init__(self, policy: Any, envs: Any) -> None:
        """Take a policy and the `VecNormalize` of its training."""
        super().__init__()
        self.policy, self.envs = policy, envs

    def forward(self, seen: Tensor) -> Tensor:
        """Map (N, 9) poses to (N, 13) logits."""
        scaled = torch.from_numpy(self.envs.normalize_obs(seen.numpy())).float()
        return self.policy.get_distribution(scaled).distribution.logits


def train_sb3(seed: int, frames: int, batched: bool) -> tuple[Actor, float]:
    """Train Stable-Baselines3's PPO as its users do; return its actor and the seconds of `learn`.

    On our batched environments, or on its own vector environment of 64 single ones.
    """
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from racines_envs.apis.sb3 import SB3ScanEnv

    single = partial(gymnasium.make, TASK, **SETTINGS)
    rows = (
        SB3ScanEnv(TASK, CONFIG.envs, **SETTINGS)
        if batched
        else DummyVecEnv([single] * CONFIG.envs)
    )
    envs = VecNormalize(rows, norm_reward=False)
    hidden = [*CONFIG.hidden]
    model = PPO(
        "MlpPolicy", envs, n_steps=CONFIG.update_every // CONFIG.envs, seed=seed, device="cpu",
        batch_size=CONFIG.minibatch, n_epochs=CONFIG.epochs,
        learning_rate=lambda left: CONFIG.actor_lr * left, gamma=CONFIG.gamma,
        gae_lambda=CONFIG.gae_lambda, clip_range=CONFIG.clip, ent_coef=CONFIG.entropy,
        max_grad_norm=CONFIG.max_gradient,
        policy_kwargs={"net_arch": {"pi": hidden, "vf": hidden}, "activation_fn": nn.Tanh},
    )  # fmt: skip
    start = time.perf_counter()
    model.learn(frames)
    seconds = time.perf_counter() - start
    envs.close()
    return Actor(model.policy.eval(), envs), seconds


def success(actor: Any) -> float:
    """Return how often a network, acting greedily, finds the view from the validation starts."""
    agent = PPOAgent(CONFIG, actor, None)
    core = make_core("SC", 100, **SETTINGS)
    return float(rollout(core, agent, validation_seeds(100)).final["success"].mean())
