"""Climbing the grader's judgement, without training: a pattern search on what each image scores.

After Hooke and Jeeves, "Direct search" solution of numerical and statistical problems (1961): try
one unit step, keep it and repeat it while the score rises, else step back and try the next. It sees
the image alone; each try is a step of the episode.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.randomness import uniform
from racines_envs.agents.protocol import SETTINGS, Untrained
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import RewardConfig
from racines_envs.worlds.backends import check_grader, make_grader, usual_grader
from racines_models.devices import resolve_device
from racines_models.protocol import Judge

MOVES = len(ACTIONS) - 1
"""All actions but idle; action 2i goes one way and 2i + 1 back."""


@dataclass(frozen=True)
class HillClimberConfig:
    """How it searches."""

    grader: str = ""
    """Run folder of the grader or its student; that of the task's tier if empty."""
    margin: float = 0.2
    """Least rise of the score that counts; two images of one place differ by some noise."""
    ceiling: float = 0.9
    """Above this probability of the target view the grade is climbed as well."""
    reach: int = 2
    """Steps that a direction may go on without a rise before they are undone."""
    patience: int = 12
    """Tries in a row that did not help after which it walks off."""
    walk: int = 4
    """Steps of that walk, all in one drawn direction."""
    device: str = "cpu"


@dataclass
class _Memory:
    """Where the search of N rows stands; every field has N rows."""

    base: Tensor  # score of the place that the search is at
    order: Tensor  # (N, 12) directions in the order of trying
    place: Tensor  # which of the order is tried next
    tried: Tensor  # tries since the last rise
    last: Tensor  # the last action
    probing: Tensor  # whether the last action was a try
    depth: Tensor  # steps from that place, on a try or on the way back
    helped: Tensor  # whether the direction under trial has raised the score before
    walking: Tensor  # steps of a walk still to go

    @classmethod
    def begin(cls, score: Tensor, seeds: Tensor) -> Self:
        """Start where the rows are, with directions drawn from the (N,) seeds."""
        none = torch.zeros_like(seeds)
        no = none > 0
        return cls(score, _order(seeds), none, none, none + IDLE, no, none, no, none)


class HillClimberAgent(Untrained):
    """Repeats a step while the grader likes the images better; undoes it when not."""

    name: ClassVar[str] = "hill-climber"
    Config: ClassVar[type] = HillClimberConfig
    observation: str = "image"
    sees: ClassVar[str] = "grade"

    def __init__(
        self, config: HillClimberConfig | None = None, grader: Judge | None = None
    ) -> None:
        """Take settings, and a grader instead of the folder in them."""
        self.config = config or HillClimberConfig()
        self.guide = grader
        """The grader whose opinion is climbed; None before the agent has met its task."""
        self._memory: _Memory | None = None
        self._target, self._goal = 0, RewardConfig()
        self._ended: Callable[[], Tensor] | None = None

    def attach(self, core: ScanCore) -> None:
        """Learn which view is wanted and what a hit is; forget the episodes before."""
        if self.guide is None:
            folder = Path(self.config.grader or usual_grader(core.task))
            self.guide = make_grader(folder, resolve_device(self.config.device))
        check_grader(self.guide, core.task)
        self._target, self._goal, self._memory = core.task.target, core.rewards, None
        self._ended = lambda: core.state.done

    @torch.no_grad()
    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the next step of each row's search; rows are those of the call before.

        A row whose episode has ended idles, and its image is not judged again.
        """
        if self.guide is None or self._ended is None:
            raise RacinesError("the hill-climber needs its task: call attach(core) first")
        ended = self._ended().to(seeds.device)
        p, g = self._judge(observation["image"], ended)
        score = self.score(p, g)
        if self._memory is None or len(self._memory.base) != len(score):
            self._memory = _Memory.begin(score, seeds)
        action = self._next(self._memory, score, seeds)
        arrived = ended | ((p >= self._goal.probability) & (g >= self._goal.grade))
        # Whatever was under way is over: from a hit the search begins again.
        self._memory.probing &= ~arrived
        self._memory.walking *= ~arrived
        self._memory.depth *= ~arrived
        self._memory.tried *= ~arrived
        self._memory.last = torch.where(arrived, IDLE, action)
        return self._memory.last

    def _judge(self, images: Tensor, ended: Tensor) -> tuple[Tensor, Tensor]:
        """Return (N,) p of the target view and (N,) grades, zeros where the episode has ended."""
        p, g = torch.zeros(2, len(ended), device=ended.device)
        rows = (~ended).nonzero().squeeze(1)
        if len(rows) and self.guide is not None:
            judged, grades = self.guide.probabilities_and_grade(images[rows.to(images.device)])
            p[rows] = judged[:, self._target].float().to(p.device)
            g[rows] = grades.float().to(g.device)
        return p, g

    def score(self, probability: Tensor, grade: Tensor) -> Tensor:
        """Return what is climbed: log-odds of the view up to the ceiling, then the grade too.

        Log-odds still tell 1e-4 from 1e-3, where probabilities are all but flat.
        """
        odds = torch.logit(probability.clamp(1e-30, self.config.ceiling))
        return odds + torch.where(probability >= self.config.ceiling, grade, 0.0)

    def _next(self, memory: _Memory, score: Tensor, seeds: Tensor) -> Tensor:
        """Advance all rows' searches by one look and return their steps."""
        rose = memory.probing & (score > memory.base + self.config.margin)
        failed = memory.probing & ~rose & (memory.depth >= self.config.reach)
        home = ~memory.probing & (memory.depth == 0)
        memory.base = torch.where(rose | home, score, memory.base)
        memory.depth = torch.where(rose, 0, memory.depth)
        memory.tried = torch.where(rose, 0, memory.tried + failed)
        # A direction that failed is done with; so is the way back from one that had helped.
        skip = 1 + (memory.helped & (memory.place % 2 == 0)).long()
        memory.place = torch.where(failed, memory.place + skip, memory.place) % MOVES
        memory.helped = rose | (memory.helped & memory.probing & ~failed)
        walk = self._walk(memory, home, seeds)
        new = memory.order.gather(1, memory.place.unsqueeze(1)).squeeze(1)
        action = torch.where(home, new, torch.where(failed, memory.last ^ 1, memory.last))
        memory.probing = (memory.probing & ~failed) | (home & ~walk)
        memory.depth = memory.depth + torch.where(memory.probing, 1, -1) * ~walk
        return action

    def _walk(self, memory: _Memory, home: Tensor, seeds: Tensor) -> Tensor:
        """Return which rows take a step of a walk, where trying has long been of no use."""
        lost = home & (memory.walking == 0) & (memory.tried >= self.config.patience)
        memory.order = torch.where(lost[:, None], _order(seeds), memory.order)
        memory.place = torch.where(lost, 0, memory.place)
        memory.tried = torch.where(lost, 0, memory.tried)
        memory.walking = torch.where(lost, self.config.walk, memory.walking)
        walk = memory.walking > 0
        memory.walking = memory.walking - walk.long()
        return walk

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Return the agent with its settings that `train` wrote there, or else the defaults."""
        path, config = Path(run_dir) / SETTINGS, HillClimberConfig()
        if path.is_file():
            content = json.loads(path.read_text(encoding="utf-8"))
            if content.get("agent") != cls.name:
                raise RacinesError(f"{path}: settings of {content.get('agent')!r}, not {cls.name}")
            config = fill(HillClimberConfig, content["config"], str(path))
        return cls(replace(config, device=str(device)))


def _order(seeds: Tensor) -> Tensor:
    """Return (N, 12) directions: the six axes shuffled, both ways of one after another."""
    drawn = uniform(seeds, MOVES)
    axes = drawn[:, : MOVES // 2].argsort(1)
    first = (drawn[:, MOVES // 2 :] < 0.5).long()
    return torch.stack([2 * axes + first, 2 * axes + 1 - first], -1).flatten(1)
