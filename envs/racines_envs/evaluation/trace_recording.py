"""Recording a trace: any agent from the starts that it is judged on."""

from pathlib import Path
from typing import Any

from racines_envs.agents.protocol import Agent
from racines_envs.agents.rollout import rollout
from racines_envs.agents.trace import circumstances, read_trace, write_trace
from racines_envs.evaluation.run import EvaluationConfig, prepare
from racines_envs.worlds.making import WorldLike
from racines_models.protocol import Judge


def record_trace(
    name: str,
    run_dir: Path,
    config: EvaluationConfig,
    path: Path,
    phantom: WorldLike = None,
    grader: Judge | None = None,
    agent: Agent | None = None,
) -> dict[str, Any]:
    """Let an agent act from the fixed starts, and write what it did.

    Args:
        name: As of `evaluate`, like all but `path`.
        run_dir: As there.
        config: As there.
        path: The file.
        phantom: As there.
        grader: As there.
        agent: As there.

    Returns:
        Path, episodes, steps.

    Raises:
        RacinesError: as there.
    """
    ready = prepare(name, run_dir, config, phantom, grader, agent)
    episodes = rollout(ready.core, ready.agent, ready.seeds.to(ready.core.device))
    told = {
        "agent": ready.agent.name,
        "observation": getattr(ready.agent, "seen", ready.agent.observation),
        "start_set": {"seeds": list(config.sets), "starts": config.starts},
    }
    told |= circumstances(ready.core, config.backend)
    steps = write_trace(path, told, episodes)
    read_trace(path)
    return {"out": str(path), "episodes": len(ready.seeds), "steps": steps}
