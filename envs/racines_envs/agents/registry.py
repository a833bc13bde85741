"""Agents by name: entry points of the group `racines.agents`, `module:Class`, or a file.

`FILE.onnx` is a policy, `FILE.json` a trace. All are loaded lazily.
"""

import importlib
from importlib.metadata import entry_points
from pathlib import Path

import torch

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import Agent

GROUP = "racines.agents"
FILES = {
    ".onnx": "racines_envs.agents.onnx.policy:OnnxPolicyAgent",
    ".json": "racines_envs.agents.trace:TraceAgent",
}
"""What opens a file, by its ending."""
MEMBERS = ("name", "Config", "attach", "act", "train", "load")


def _points() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=GROUP)}


def agent_names() -> list[str]:
    """Return the names that installed packages register, sorted."""
    return sorted(_points())


def is_file(spec: str) -> bool:
    """Return whether a spec is the path of a policy or a trace."""
    return Path(spec).suffix.lower() in FILES


def agent_class(spec: str) -> type[Agent]:
    """Return the class of a registered name, of `module:Class`, or of what opens a file.

    Raises:
        RacinesError: unknown name, or a class that is no agent.
    """
    named = _points().get(spec, spec if ":" in spec else None)
    target = FILES[Path(spec).suffix.lower()] if is_file(spec) else named
    if target is None:
        known = ", ".join(agent_names())
        raise RacinesError(
            f"unknown agent {spec!r}: choose one of {known}, or give module:Class, FILE.onnx or "
            "a trace, FILE.json"
        )
    module, _, attribute = target.partition(":")
    try:
        cls = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise RacinesError(f"agent {spec!r}: cannot load {target}: {error}") from error
    missing = [member for member in MEMBERS if not hasattr(cls, member)]
    if missing:
        raise RacinesError(f"{target} is not an agent: it lacks {', '.join(missing)}")
    return cls


def load_agent(spec: str, run_dir: Path | str, device: torch.device | str = "cpu") -> Agent:
    """Return the agent that a run left in `run_dir`; for a file the folder is not read.

    Raises:
        RacinesError: unknown name, or no policy in the folder.
    """
    return agent_class(spec).load(Path(spec if is_file(spec) else run_dir), device)
