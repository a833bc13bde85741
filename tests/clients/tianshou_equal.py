"""Run by Tianshou's environment: our rows give what its own of single environments gives.

All rows and some of them, steps and resets, observations as arrays and as dictionaries.
"""

import gymnasium
import numpy as np
from tianshou.env import DummyVectorEnv

from racines_envs.apis.tianshou import TianshouScanEnv

ROWS = 4


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (tuple, list)) or (isinstance(a, np.ndarray) and a.dtype == object):
        return len(a) == len(b) and all(same(*pair) for pair in zip(a, b, strict=True))
    return np.array_equal(a, b)


for observation, steps in (("params", 420), ("multimodal", 6)):
    settings = {"observation": observation, "reward": "oracle"}
    ours = TianshouScanEnv("racines/SC-v0", ROWS, **settings)
    theirs = DummyVectorEnv(
        [lambda: gymnasium.make("racines_envs:racines/SC-v0", **settings)] * ROWS  # noqa: B023
    )
    assert len(ours) == ROWS and ours.action_space == theirs.action_space
    assert ours.observation_space == theirs.observation_space
    for row in range(ROWS):
        for env in (ours, theirs):
            env.reset([row], seed=7 + row)
    assert ours.seed(5) == [[5 + row] for row in range(ROWS)]
    theirs.seed(5)
    assert same(ours.reset(), theirs.reset()) and same(ours.reset(seed=3), theirs.reset(seed=3))
    for env in (ours, theirs):
        env.seed([3, 30, 7, 11])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(steps):
        rows = np.sort(rng.choice(ROWS, rng.integers(1, ROWS + 1), replace=False))
        action = rng.integers(0, 13, len(rows))
        a, b = ours.step(action, rows), theirs.step(action, rows)
        assert same(list(a), list(b))
        done = rows[a[2] | a[3]]
        ends += len(done)
        if len(done):
            assert same(ours.reset(done), theirs.reset(done))
    assert ends >= (4 if observation == "params" else 0)


print("equal")
