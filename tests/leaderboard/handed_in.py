"""Submissions as somebody hands them in, at a tiny size."""

from pathlib import Path

from racines_envs.agents.planner import PlannerAgent
from racines_leaderboard.submissions.intake import take_in
from racines_models.scores.scoring import ScoresConfig
from tests.leaderboard.conftest import artefact, write_submission

CONFIG = ScoresConfig(samples=16, resamples=20, speed=False)


def submitted(root: Path, kind: str, path: Path, digest: str, **changes) -> Path:
    """Take a submission of one file in; return its folder."""
    track = "agents" if kind in ("policy", "trace") else "generators"
    dataset = {"source": "phantom", "version": "1.0.0", "digest": digest}
    about = {"track": track, "dataset": dataset, "tier": "recomputed"} | changes
    write_submission(path.parent, artefact(kind, path), **about)
    return take_in(path.parent, root / "leaderboard/submissions").folder


def inbox(root: Path, name: str) -> Path:
    (root / name).mkdir()
    return root / name


class Watched(PlannerAgent):
    """The planner, and what it saw and did."""

    def __init__(self):
        super().__init__()
        self.seen, self.done = [], []

    def act(self, observation, seeds):
        action = super().act(observation, seeds)
        self.seen.append(observation["params"].clone())
        self.done.append(action.clone())
        return action
