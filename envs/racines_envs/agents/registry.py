"""Agents by name: entry points of the group `racines.agents`, `module:Class`, or `FILE.onnx`.

All are loaded lazily.
"""

import importlib
from importlib.metadata import entry_points
from pathlib import Path

import torch

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import Agent

GROUP = "racines.agents"
FILES = "racines_envs.agents.onnx_policy:OnnxPolicyAgent"
"""What opens a file."""
MEMBERS = ("name", "Config", "attach", "act", "train", "load")


def _points() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=GROUP)}


def agent_names() -> list[str]:
    """Return the names that installed packages register, sorted."""
    return sorted(_points())


def is_file(spec: str) -> bool:
    """Return whether a spec is the path of a policy in an ONNX file."""
    return Path(spec).suffix.lower() == ".onnx"


def agent_class(spec: str) -> type[Agent]:
    """Return the class of a registered name, of `module:Class`, or of policies in ONNX files.

    Raises:
        RacinesError: unknown name, or a class that is no agent.
    """
    target = FILES if is_file(spec) else _points().get(spec, spec if ":" in spec else None)
    if target is None:
        known = ", ".join(agent_names())
        raise RacinesError(
            f"unknown agent {spec!r}: choose one of {known}, or give module:Class or FILE.onnx"
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
    """Return the agent that a run left in `run_dir`; for `FILE.onnx` the folder is not read.

    Raises:
        RacinesError: unknown name, or no policy in the folder.
    """
    return agent_class(spec).load(Path(spec if is_file(spec) else run_dir), device)
