"""What an agent is, and where one is found.

Agents have names: entry points of the group `racines.agents`. `module:Class` names one as well, and
a file: `FILE.onnx` is a policy, `FILE.json` a trace. All are loaded lazily.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.plugins import Plugins
from racines_envs.task.core import ScanCore
from racines_envs.task.motion import DISCRETE

SETTINGS = "config.json"
AGENTS = Plugins(
    "agent",
    "racines.agents",
    ("name", "Config", "attach", "act", "train", "load"),
    "module:Class, FILE.onnx or a trace, FILE.json",
)
FILES = {
    ".onnx": "racines_envs.agents.onnx.policy:OnnxPolicyAgent",
    ".json": "racines_envs.agents.trace:TraceAgent",
}
"""What opens a file, by its ending."""


@runtime_checkable
class Agent(Protocol):
    """Chooses actions for N rows at once, from what they see."""

    name: ClassVar[str]
    Config: ClassVar[type]
    """A dataclass whose defaults are usable, filled from the params section of this name."""
    observation: str
    """What the environment shows it: `image`, `params` or `multimodal`."""
    # `remembers` may be False where a step's actions depend on that step alone: see `rollout`.
    # `tiers` may name the tiers in whose every task it acts, whatever view it is asked for.

    def attach(self, core: ScanCore) -> None:
        """Meet the environment before a rollout. Only an upper bound may keep hold of it."""
        ...

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return (N,) int64 actions 0-12.

        `observation` holds `image` (N, 128, 128) uint8 and/or `params` (N, 9) float32. An agent
        that draws its actions draws them from the (N,) seeds, so that a row's action depends on
        what that row sees and on its seed alone: not on its place, on its neighbours or on the size
        of the batch, on one machine.
        """
        ...

    @classmethod
    def train(cls, config: Any, run_dir: Path, **where: Any) -> Self:
        """Learn, and leave `policy.safetensors`, `config.json` and `metrics.json` in `run_dir`.

        What has nothing to learn leaves the last two.
        """
        ...

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Read what `train` left, which has to be there; what learns nothing reads nothing."""
        ...


def sees(agent: Agent) -> str:
    """Return what an agent goes by: its attribute `sees`, or else all that it is shown.

    Some are shown more than they use, or told more: `grade` for the grader's opinion of the image,
    `truth` for the simulator's state, `nothing`.
    """
    return getattr(agent, "sees", agent.observation)


def acts(agent: Any) -> str:
    """Return how an agent acts: its attribute `action`, `velocity` for twists, else `discrete`."""
    return getattr(agent, "action", DISCRETE)


def encoder_of(agent: Any) -> Any:
    """Return the encoder through which the environment shows an agent its images, or None.

    One that is not called is the agent's own: it looks through it itself.
    """
    encoder = getattr(agent, "encoder", None)
    return encoder if callable(encoder) else None


def learns(agent: Agent | type[Agent]) -> bool:
    """Return whether an agent learned by random draws, so that another training ends elsewhere.

    An attribute `trained` says so; of one that has none it is supposed.
    """
    return bool(getattr(agent, "trained", True))


@dataclass(frozen=True)
class NoConfig:
    """Nothing to set."""


class Untrained:
    """The part of the protocol that agents without weights share."""

    name: ClassVar[str]
    Config: ClassVar[type] = NoConfig
    observation: str = "params"
    origin: ClassVar[str] = ""
    """Where to get one, if not from `train`."""
    trained: bool = False
    """See `learns`."""

    def attach(self, core: ScanCore) -> None:
        """Keep nothing of the environment."""

    @classmethod
    def train(cls, config: Any, run_dir: Path, **where: Any) -> Self:
        """Write the settings down, so that a run has its folder; there is nothing to learn."""
        if cls.origin:
            raise RacinesError(f"agent {cls.name!r} has nothing to learn: {cls.origin}")
        write_json(Path(run_dir) / "metrics.json", {})
        write_json(Path(run_dir) / SETTINGS, {"agent": cls.name, "config": asdict(config)})
        return cls.load(Path(run_dir))

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Return the agent; there is nothing to read."""
        return cls()


def agent_names() -> list[str]:
    """Return the names that installed packages register, sorted."""
    return list(AGENTS.names())


def agent_class(spec: str) -> type[Agent]:
    """Return the class of a registered name, of `module:Class`, or of what opens a file.

    Raises:
        RacinesError: unknown name, or a class that is no agent.
    """
    return AGENTS.load(FILES.get(Path(spec).suffix.lower(), spec))


def load_agent(spec: str, run_dir: Path | str, device: torch.device | str = "cpu") -> Agent:
    """Return the agent that a run left in `run_dir`; for a file the folder is not read.

    Raises:
        RacinesError: unknown name, or no policy in the folder.
    """
    is_file = Path(spec).suffix.lower() in FILES
    return agent_class(spec).load(Path(spec if is_file else run_dir), device)
