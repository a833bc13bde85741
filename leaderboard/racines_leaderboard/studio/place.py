"""Where the Studio finds what it shows."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Place:
    """Folders and settings of one Studio; a folder that is missing empties its tab alone."""

    data: Path | None = Path("data/racines")
    """The dataset."""
    results: Path = Path("leaderboard/results")
    """The boards."""
    submissions: Path = Path("leaderboard/submissions")
    weights: Path = Path("models/weights")
    """Published weights."""
    runs: Path = Path("models/runs")
    """Trained generators and graders."""
    agents: Path = Path("envs/runs")
    """Trained agents."""
    kits: Path | None = Path("study")
    """A folder of expert kits; ratings of `KIT` go to `KIT-ratings` beside it."""
    seed: int = 0
    device: str = "cpu"
    max_sessions: int = 200
    """Visitors whose state is kept; the one who was idle longest is forgotten first."""
    policies: Path = Path("envs/weights")
    """Published agents."""
