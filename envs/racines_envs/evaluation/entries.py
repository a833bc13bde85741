"""The section `agents` of a params file: an entry a run, under a name of its own.

    agents:
      ppo: {frames: 200000}         # the run `ppo` of the agent `ppo`
      ppo-image-pl:                 # another run of that agent
        agent: ppo
        view: PL
        observation: image
        encoder: models/runs/encoder

The run's name is that of its folder, of its scores and of its row on a board.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from racines_data.config import section
from racines_data.errors import RacinesError
from racines_envs.agents import agent_class
from racines_envs.evaluation.agent_specs import RUNS


@dataclass(frozen=True)
class Entry:
    """One run of an agent."""

    name: str
    agent: str
    """Registered name, `module:Class` or `FILE.onnx`."""
    settings: dict[str, Any]
    """For the agent's `Config`."""
    view: str | None
    """The target view, where the entry names one."""

    @property
    def where(self) -> str:
        """The entry's place in the params file."""
        return f"agents.{self.name}"

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return RUNS / self.name

    @property
    def scores(self) -> Path:
        """The run's scores."""
        return RUNS / "scores" / f"{self.name}.json"


def find_entry(settings: dict[str, Any], spec: str, name: str | None = None) -> Entry:
    """Return the run that a spec names: an entry of the section `agents`, or else an agent.

    Args:
        settings: All sections.
        spec: An entry's name; or a registered agent, `module:Class` or `FILE.onnx`, whose entry is
            the one of its own name, if there is one.
        name: What to call the run, instead.

    Raises:
        RacinesError: no such entry or agent, or an entry that is no mapping.
    """
    entries = section(settings, "agents")
    own = spec if spec in entries else agent_class(spec).name
    values = section(settings, ("agents", own))
    agent = values.get("agent", own)
    if not isinstance(agent, str):
        raise RacinesError(f"agents.{own}.agent: {agent!r}: give the name of an agent")
    if spec not in entries:  # an entry of that name may be another agent's
        values, agent = values if agent == own else section({}, "agents"), spec
    known = {field.name for field in fields(agent_class(agent).Config)}
    # What learns for a view has it among its settings; for others it is the evaluation's alone.
    apart = {"agent"} if "view" in known else {"agent", "view"}
    chosen = values.of(*(values.keys() - apart))
    return Entry(name or own, agent, chosen, values.get("view"))
