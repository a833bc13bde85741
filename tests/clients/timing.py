"""Run by a client's environment: time our rows and the client's own, and print both as JSON.

python timing.py CLIENT

64 rows of SC from the pose, paid by `shaped`, random actions, one thread. Both sides take rounds in
turns; a figure is the median of its rounds, the first left out, and so is the ratio.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
import torch

import racines_envs

ROWS, ROUNDS, STEPS = 64, 5, 16
TASK = "racines_envs:racines/SC-v0"
SETTINGS = {"observation": "params", "reward": "shaped"}
Play = Callable[[int], None]
"""Takes so many steps of every row."""


def single() -> Any:
    import gymnasium

    return gymnasium.make(TASK, **SETTINGS)


def actions() -> np.ndarray:
    return np.random.default_rng(0).integers(13, size=ROWS)


def stepping(env: Any) -> Play:
    """Return a player of what has Gymnasium's or Stable-Baselines3's `step`."""

    def play(steps: int) -> None:
        for _ in range(steps):
            env.step(actions())

    env.reset()
    return play


def gymnasium() -> tuple[Play, Play, str]:
    import gymnasium
    from gymnasium.vector import SyncVectorEnv

    ours = gymnasium.make_vec(TASK, num_envs=ROWS, **SETTINGS)
    return stepping(ours), stepping(SyncVectorEnv([single] * ROWS)), "SyncVectorEnv"


def sb3() -> tuple[Play, Play, str]:
    from stable_baselines3.common.vec_env import DummyVecEnv

    from racines_envs.apis.sb3 import SB3ScanEnv

    ours = SB3ScanEnv(TASK, ROWS, **SETTINGS)
    return stepping(ours), stepping(DummyVecEnv([single] * ROWS)), "DummyVecEnv"


def rllib() -> tuple[Play, Play, str]:
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    def runner(mode: str) -> Play:
        config = PPOConfig().environment(TASK, env_config=SETTINGS)
        config.env_runners(num_envs_per_env_runner=ROWS, gym_env_vectorize_mode=mode)
        made = SingleAgentEnvRunner(config=config)

        def play(steps: int) -> None:
            made.sample(num_timesteps=steps * ROWS, random_actions=True)

        return play

    return runner("vector_entry_point"), runner("sync"), "gym_env_vectorize_mode sync"


def tianshou() -> tuple[Play, Play, str]:
    from tianshou.env import DummyVectorEnv

    from racines_envs.apis.tianshou import TianshouScanEnv

    def player(env: Any) -> Play:
        def play(steps: int) -> None:
            for _ in range(steps):  # as its collectors do
                _, _, ended, cut, _ = env.step(actions())
                if (ended | cut).any():
                    env.reset((ended | cut).nonzero()[0])

        env.reset()
        return play

    theirs = DummyVectorEnv([single] * ROWS)
    return player(TianshouScanEnv(TASK, ROWS, **SETTINGS)), player(theirs), "DummyVectorEnv"


def torchrl() -> tuple[Play, Play, str]:
    from torchrl.envs import GymEnv, SerialEnv

    def player(env: Any) -> Play:
        def play(steps: int) -> None:
            env.rollout(steps, break_when_any_done=False)

        return play

    theirs = SerialEnv(ROWS, lambda: GymEnv(TASK, **SETTINGS))
    return player(racines_envs.ScanEnv("SC", ROWS, **SETTINGS)), player(theirs), "SerialEnv"


CLIENTS: dict[str, tuple[Callable[[], tuple[Play, Play, str]], str]] = {
    "gymnasium": (gymnasium, "gymnasium"),
    "sb3": (sb3, "stable_baselines3"),
    "rllib": (rllib, "ray"),
    "tianshou": (tianshou, "tianshou"),
    "cleanrl": (gymnasium, "gymnasium"),
    "torchrl": (torchrl, "torchrl"),
}


def timed(play: Play) -> float:
    start = time.perf_counter()
    play(STEPS)
    return time.perf_counter() - start


def measure(client: str) -> dict[str, Any]:
    """Return steps a second of both sides, their ratio, and the versions."""
    make, package = CLIENTS[client]
    ours, theirs, name = make()
    rounds = [(timed(ours), timed(theirs)) for _ in range(ROUNDS + 1)][1:]
    mine, peers = zip(*rounds, strict=True)
    return {
        "version": version(package),
        "gymnasium": version("gymnasium"),
        "torch": version("torch").split("+")[0],
        "theirs_is": name,
        "ours": round(ROWS * STEPS / statistics.median(mine)),
        "theirs": round(ROWS * STEPS / statistics.median(peers)),
        "ratio": round(statistics.median(b / a for a, b in rounds), 1),
    }


if __name__ == "__main__":
    torch.set_num_threads(1)
    print(json.dumps(measure(sys.argv[1])))
