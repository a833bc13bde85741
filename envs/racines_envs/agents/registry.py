"""Agents by name: entry points of the group `racines.agents`, `module:Class`, or a file.

`FILE.onnx` is a policy, `FILE.json` a trace. All are loaded lazily.
"""

from pathlib import Path

import torch

from racines_data.plugins import Plugins
from racines_envs.agents.protocol import Agent

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
