"""Speed of PPO from end to end, beside Stable-Baselines3 and a plain loop, on `racines/SC-v0`.

All learn from the probe's pose, 64 environments, the same networks, batch and settings, on one
thread each, which is quickest for networks this small. Trainings cannot be equal, since each
draws its numbers in its own order: held is that each, after the frames that it was timed on and as
many again on the batched environment, finds the view from more of the validation starts than an
untrained policy does.
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
FRAMES, MORE, ROUNDS = 8_192, 65_536, 3
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
        SB3: lambda turn: train_sb3(turn, FRAMES),
    }
    try:
        times: Times = {name: [] for name in sides}
        for turn in range(ROUNDS):
            for name, train in sides.items():
                times[name].append(train(turn))
        learned, plain = train_ours(tmp_path / "more", 0, MORE)[0], train_loop(0, MORE, True)[0]
        benchmark.pedantic(lambda: sides["ours"](ROUNDS), rounds=1)
    finally:
        torch.set_num_threads(threads)
    found = {"untrained": success(make_actor(CONFIG).eval()), "ours": success(learned.actor),
             "loop": success(plain.actor)}  # fmt: skip
    print(found)
    assert min(found["ours"], found["loop"]) > found["untrained"] + 0.1, found
    work = "PPO, 64 environments, pose"
    for peer, aim in ((SB3, 1.5), (PLAIN, None), (BATCHED, None)):
        line(line_of(work, "frames/s", FRAMES, times, peer, EQUAL, aim))


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


def train_sb3(seed: int, frames: int) -> float:
    """Train Stable-Baselines3's PPO as its users do; return the seconds of `learn`."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    single = partial(gymnasium.make, TASK, **SETTINGS)
    envs = VecNormalize(DummyVecEnv([single] * CONFIG.envs), norm_reward=False)
    hidden = [CONFIG.hidden[0], *CONFIG.hidden[1:]]
    model = PPO(
        "MlpPolicy", envs, n_steps=CONFIG.update_every // CONFIG.envs, seed=seed, device="cpu",
        batch_size=CONFIG.minibatch, n_epochs=CONFIG.epochs, learning_rate=CONFIG.actor_lr,
        gamma=CONFIG.gamma, gae_lambda=CONFIG.gae_lambda, clip_range=CONFIG.clip,
        ent_coef=CONFIG.entropy, max_grad_norm=CONFIG.max_gradient,
        policy_kwargs={"net_arch": {"pi": hidden, "vf": hidden}, "activation_fn": torch.nn.Tanh},
    )  # fmt: skip
    start = time.perf_counter()
    model.learn(frames)
    seconds = time.perf_counter() - start
    envs.close()
    return seconds


def success(actor: Any) -> float:
    """Return how often a network, acting greedily, finds the view from the validation starts."""
    agent = PPOAgent(CONFIG, actor, None)
    core = make_core("SC", 100, **SETTINGS)
    return float(rollout(core, agent, validation_seeds(100)).final["success"].mean())
