"""What scores say of an agent, of what it looked at, and of who carried its probe."""

from collections.abc import Sequence
from typing import Any

import torch

from racines_envs.agents import learns, sees
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.agents.protocol import Agent, Untrained
from racines_envs.agents.trace import TraceAgent
from racines_envs.evaluation.trainings import Training
from racines_envs.robots.arm import FREE
from racines_models.protocol import Judge
from racines_models.provenance import code_version, environment
from racines_models.training.checkpoint import PREFIX


def carried_by(robot: str) -> dict[str, str]:
    """Return what a task says of the arm in it; nothing of a free probe, as before there were arms.

    Hence the scores of free probes are, to the last letter, those of all published records.
    """
    return {} if robot == FREE else {"robot": robot}


def extractors_of(agent: Agent, grader: Judge | None = None) -> dict[str, dict[str, Any]]:
    """Return the settings, with hashes, of what judged the last images and of the agent's guide."""
    graders = {"grader": grader, "guide": getattr(agent, "guide", None)}
    told = {kind: each.settings for kind, each in graders.items() if each is not None}
    return {kind: settings for kind, settings in told.items() if settings is not None}


def shown_to(agent: Agent) -> str:
    """Return what an agent looks at, or what the one whose actions it repeats looked at."""
    return getattr(agent, "seen", agent.observation)


def told_of_agent(
    agent: Agent, trainings: Sequence[Training], device: torch.device | str
) -> dict[str, Any]:
    """Return what scores say of an agent and of where it acted, whatever its task."""
    several = [{"seed": each.seed, "published": each.published} for each in trainings]
    return {
        "agent": agent.name,
        "submission": agent.name,
        "sees": sees(agent),
        "runs": len(trainings),
        "trained": learns(agent),
        **({"trainings": several} if len(several) > 1 else {}),
        "weights": _weights(agent, trainings),
        "code": code_version(),
        "environment": environment(str(device)),
    }


def _weights(agent: Agent, trainings: Sequence[Training]) -> dict[str, Any] | None:
    """Return the hashes of all trainings' files, and that of the first one's policy."""
    files = {} if isinstance(agent, Untrained) else trainings[0].files
    if isinstance(agent, (OnnxPolicyAgent, TraceAgent)):
        files = {agent.path.name: agent.sha256}
    if not files:
        return None
    only = next(iter(files.values())) if len(files) == 1 else None
    further = {
        f"{PREFIX}{each.seed}/{name}": sha256
        for each in trainings[1:]
        for name, sha256 in each.files.items()
    }
    return {"sha256": files.get("policy.safetensors", only), "files": files | further}
