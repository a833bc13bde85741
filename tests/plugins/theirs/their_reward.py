"""A reward: a point for every step, and the distance that it gained."""

from racines_envs.task.rewards import Reward

MINE = Reward("mine", "1 + d - d'", lambda a, b, ended, _: 1 + a.distance - b.distance,
              needs_distance=True)  # fmt: skip
