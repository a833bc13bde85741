"""An agent that takes recorded actions again, and the recording of any agent's."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import Agent
from racines_envs.agents.rollout import Episodes
from racines_envs.agents.trace_file import check_same, read_trace
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_models.provenance import sha256_bytes

IDLE = ACTIONS.index("idle")


@dataclass(frozen=True)
class TraceConfig:
    """Nothing to set: the file says it all."""


class TraceAgent:
    """Takes the actions of one file, each from the start that it was recorded at.

    Raises:
        RacinesError: the file is refused.
    """

    name: ClassVar[str] = "trace"
    Config: ClassVar[type] = TraceConfig
    observation: str = "params"
    """What it needs: nothing, so no image is drawn for it."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.trace = read_trace(self.path)
        self.sha256 = sha256_bytes(self.path.read_bytes())
        """Hash of the file."""
        self.view: str = str(self.trace.told["task"].get("view"))
        self.seen: str = self.trace.told["observation"]
        """What the recorded agent looked at, by its own word."""
        self._rows: Tensor | None = None

    def attach(self, core: ScanCore) -> None:
        """Keep the environment, whose seeds and steps say which action comes next.

        Raises:
            RacinesError: recorded on another task, reward or phantom.
        """
        check_same(self.trace, core, self.path)
        self._core, self._rows = core, None

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the recorded action of each row; idle where its episode has ended.

        Raises:
            RacinesError: recorded from other starts, or it ends before its episode does.
        """
        state, trace = self._core.state, self.trace
        if self._rows is None:
            self._rows = self._find(state.seed.cpu())
        steps, done = state.steps.cpu(), state.done.cpu()
        short = ~done & (steps >= trace.lengths[self._rows])
        if bool(short.any()):
            self._refuse(int(short.nonzero()[0]), "ends before its episode does")
        place = steps.clamp_max(trace.actions.shape[1] - 1)
        actions = torch.where(done, IDLE, trace.actions[self._rows, place])
        return actions.to(state.seed.device)

    def check_ended(self, episodes: Episodes) -> None:
        """Check that every episode took all the actions that were recorded of it.

        Raises:
            RacinesError: one ended earlier than when it was recorded.
        """
        assert self._rows is not None
        left = np.flatnonzero(episodes.final["steps"] != self.trace.lengths[self._rows].numpy())
        if len(left):
            self._refuse(int(left[0]), "goes on behind the end of its episode")

    def _find(self, seeds: Tensor) -> Tensor:
        """Return the recorded episode of each row."""
        order = torch.argsort(self.trace.seeds)
        known = self.trace.seeds[order]
        at = torch.searchsorted(known, seeds).clamp_max(len(known) - 1)
        if len(known) != len(seeds) or not torch.equal(known[at], seeds):
            told = self.trace.told["start_set"]
            raise RacinesError(
                f"{self.path}: recorded from {told['starts']} starts of each of the sets "
                f"{told['seeds']}, not from these {len(seeds)}: evaluate with the same seeds and "
                "starts, or record it anew"
            )
        return order[at]

    def _refuse(self, row: int, what: str) -> None:
        assert self._rows is not None
        told, i = self.trace.told["start_set"], int(self._rows[row])
        raise RacinesError(
            f"{self.path}: set {told['seeds'][i // told['starts']]}, index {i % told['starts']}: "
            f"the trace {what}: it was recorded in another environment; record it anew"
        )

    @classmethod
    def train(cls, config: Any, run_dir: Path, **where: Any) -> Self:
        """Refuse: a trace is recorded."""
        raise RacinesError(
            "agent 'trace' has nothing to learn: record one: racines export trace AGENT --out FILE"
        )

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Open a file."""
        return cls(Path(run_dir))


class ActionRecorder:
    """An agent whose actions are written down as it takes them."""

    name: ClassVar[str] = "recorded"

    def __init__(self, agent: Agent) -> None:
        self.agent = agent
        self.observation = agent.observation
        self.taken: list[Tensor] = []
        """(N,) actions of each step."""

    def attach(self, core: ScanCore) -> None:
        """Let the agent meet the environment."""
        self.agent.attach(core)
        self.taken = []

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the agent's actions."""
        action = self.agent.act(observation, seeds)
        self.taken.append(action.cpu())
        return action

    def episodes(self, steps: np.ndarray) -> list[list[int]]:
        """Return the actions of each row, as many as its episode had steps."""
        table = torch.stack(self.taken, 1)
        return [row[:n].tolist() for row, n in zip(table, steps.tolist(), strict=True)]
