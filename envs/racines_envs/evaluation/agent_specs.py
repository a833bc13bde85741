"""Agents as commands name them: `[LABEL=]NAME`, the folder that a training left, or an entry.

The section `agents` of a params file holds an entry a run, under a name of its own:

    agents:
      ppo: {frames: 200000}         # the run `ppo` of the agent `ppo`
      ppo-image-pl:                 # another run of that agent
        agent: ppo
        view: PL
        observation: image
        encoder: models/runs/encoder
        repeats: 3                  # trained with three seeds: the first, and the two that follow

The run's name is that of its folder, of its scores and of its row on a board. Runs that scan
patients stand in the section `patient_agents`, in the same way; a name is in one of the two.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch

from racines_data.config import section
from racines_data.errors import RacinesError
from racines_envs.agents import Agent, agent_class, agent_names, learns, load_agent
from racines_envs.agents.protocol import FILES
from racines_envs.task.names import HEART_TIER
from racines_envs.task.tasks import get_task
from racines_models.published.places import POLICIES, own_or_published

RUNS = Path("envs/runs")
SECTIONS = ("agents", "patient_agents")
"""Sections of a params file that hold runs: on one heart, and on patients."""


@dataclass(frozen=True)
class Run:
    """One agent, and where its weights lie."""

    label: str
    """What tables and pictures call it."""
    agent: str
    """Registered name, or what `load_agent` takes."""
    folder: Path
    """The run folder; not read for agents without weights."""
    config: dict[str, Any] = field(default_factory=dict)
    """The training's settings; empty for agents without weights, as is its seed."""
    seed: int | None = None

    def load(self, view: str, device: torch.device | str = "cpu") -> Agent:
        """Return the agent, if it was not trained for another view."""
        agent = load_agent(self.agent, self.folder, device)
        check_view(agent, view, self.agent, self.folder)
        return agent


def check_view(agent: Agent, view: str, name: str, run_dir: Path) -> None:
    """Check that an agent that was trained for a view is asked for that one."""
    trained = getattr(agent, "view", view)
    if trained != view and not _goes_for(agent, trained, view):
        told = f", or set racines.view of the file to {view}" if name.endswith(".onnx") else ""
        own = "" if Path(name).exists() else f"`racines train agent {name} --view {view}`, or "
        remedy = f"{'train one with ' * bool(own)}{own}evaluate --view {trained}{told}"
        raise RacinesError(
            f"{run_dir if own else name}: this policy was trained for {trained} and observes "
            f"{agent.observation}; it is not for {view}: {remedy}"
        )


def _goes_for(agent: Agent, trained: str, view: str) -> bool:
    """Return whether who was trained to find any view of patients is asked for one of theirs."""
    patients = HEART_TIER not in (get_task(trained).tier, get_task(view).tier)
    return getattr(agent, "any_view", False) and patients


def split_label(spec: str) -> tuple[str | None, str]:
    """Split `LABEL=RUN`; without a label the first is None."""
    label, equals, rest = spec.partition("=")
    return (label, rest) if equals and label else (None, spec)


def find_run(spec: str) -> Run:
    """Return what `[LABEL=]NAME` or `[LABEL=]FOLDER` names.

    A name's folder is envs/runs/NAME, or else the published envs/weights/NAME.
    """
    label, where = split_label(spec)
    given = Path(where).is_dir()
    folder = Path(where) if given else trained_folder(where)
    described = folder / "config.json"
    if not described.is_file():
        if given:
            raise RacinesError(f"{described}: no such file: {where} is not an agent's run folder")
        return Run(label or Path(where).stem, where, folder)
    told = read_json(described)
    if "agent" not in told:
        raise RacinesError(f"{described}: names no agent: {where} is not an agent's run folder")
    name = label or folder.resolve().name
    return Run(name, told["agent"], folder, told.get("config", {}), told.get("seed"))


def trained_folder(name: str) -> Path:
    """Return the folder of a run by its name: one made here, or the published one, said once."""
    return own_or_published(RUNS / name, POLICIES / name, "config.json")


def find_runs(specs: Sequence[str]) -> list[Run]:
    """Return several agents, one at least, each under a label of its own."""
    runs = [find_run(spec) for spec in specs]
    if not runs:
        raise RacinesError("no agent given: name agents or run folders")
    labels = [run.label for run in runs]
    for label in labels:
        if labels.count(label) > 1:
            raise RacinesError(f"two agents are called {label!r}: name them, LABEL=RUN")
    return runs


def common_view(runs: Sequence[Run], view: str = "") -> str:
    """Return the one view that all were trained for; `view`, or SC, for agents without weights."""
    trained = {run.label: run.config["view"] for run in runs if "view" in run.config}
    wanted = view or next(iter(trained.values()), "SC")
    for label, its in trained.items():
        if its != wanted:
            raise RacinesError(
                f"{label}: trained for {its}, not {wanted}: compare agents of a view"
            )
    return wanted


def read_json(path: Path) -> Any:
    """Read a JSON file; one that is missing or damaged is named in the error."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}") from error


@dataclass(frozen=True)
class Entry:
    """One run of an agent, as a params file has it."""

    name: str
    agent: str
    """Registered name, `module:Class` or `FILE.onnx`."""
    settings: dict[str, Any]
    """For the agent's `Config`."""
    view: str | None
    """The target view, where the entry names one."""
    repeats: int = 1
    """With how many seeds it is trained."""
    section: str = SECTIONS[0]
    """Where it stands in the params file."""
    found: Path | None = None
    """The folder that says what it is, where no params file does."""

    @property
    def where(self) -> str:
        """The entry's place in the params file."""
        return f"{self.section}.{self.name}"

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return RUNS / self.name

    @property
    def trained(self) -> Path:
        """The run's folder, or the published one of its name where none was trained here."""
        return self.found or (
            self.folder if Path(self.agent).suffix.lower() in FILES else trained_folder(self.name)
        )

    @property
    def scores(self) -> Path:
        """The run's scores."""
        return RUNS / "scores" / f"{self.name}.json"


def find_entry(settings: dict[str, Any], spec: str, name: str | None = None) -> Entry:
    """Return the run that a spec names, in all sections' settings; called `name`, if given.

    A spec is the name of an entry, a mapping, of one of `SECTIONS`; or a registered agent,
    `module:Class` or `FILE.onnx`, whose entry is the one of its own name, if there is one. A file's
    run is called as the file.
    """
    listed = {each: section(settings, each) for each in SECTIONS}
    known_here = any(spec in entries for entries in listed.values())
    own = spec if known_here else agent_class(spec).name
    held = [each for each in SECTIONS if own in listed[each]]
    if len(held) > 1:
        raise RacinesError(
            f"{own}: stands in {' and in '.join(held)}, which would share a folder: rename one"
        )
    place = held[0] if held else SECTIONS[0]
    values = section(settings, (place, own))
    agent = values.get("agent", own)
    if not isinstance(agent, str):
        raise RacinesError(f"{place}.{own}.agent: {agent!r}: give the name of an agent")
    if not known_here:  # an entry of that name may be another agent's
        values, agent = values if agent == own else section({}, place), spec
    known = {field.name for field in fields(agent_class(agent).Config)}
    # What learns for a view has it among its settings; for others it is the evaluation's alone.
    apart = {"agent", "repeats"} | (set() if "view" in known else {"view"})
    chosen = values.of(*(values.keys() - apart))
    of_file = Path(agent).suffix.lower() in FILES
    called = plain_name(Path(agent).stem) if of_file and spec == agent else own
    repeats = values.get("repeats", 1)
    if not isinstance(repeats, int) or isinstance(repeats, bool) or repeats < 1:
        raise RacinesError(f"{place}.{own}.repeats: {repeats!r}: give 1 or more")
    if repeats > 1 and not learns(agent_class(agent)):
        raise RacinesError(f"{place}.{own}.repeats: {agent} learns nothing: one run is all it has")
    return Entry(name or called or own, agent, chosen, values.get("view"), repeats, place)


def find_trained(
    settings: dict[str, Any], spec: str, name: str | None = None, run: Path | None = None
) -> Entry:
    """Return the run that a spec names, as `find_entry`, but to be judged and not to be trained.

    One that the settings do not have is what the folder of its name says: trained here, published,
    or `run`, if that is called so.
    """
    listed = any(spec in section(settings, each) for each in SECTIONS)
    if listed or spec in agent_names() or spec != plain_name(spec):
        return find_entry(settings, spec, name)
    own = run is not None and run.resolve().name == spec
    folder = run if run is not None and own else trained_folder(spec)
    if not (folder / "config.json").is_file() or (run is not None and not own):
        return find_entry(settings, spec, name)
    told = read_json(folder / "config.json")
    values = told.get("config", {}) if isinstance(told, dict) else None
    if not isinstance(values, dict) or not isinstance(told.get("agent"), str):
        raise RacinesError(f"{folder / 'config.json'}: names no agent: it is not an agent's run")
    return Entry(name or spec, told["agent"], values, values.get("view"), found=folder)


def plain_name(text: str) -> str:
    """Return a text as a name on a board: a-z, 0-9 and single dashes."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def result_name(run: str, config: Any, usual: Any) -> str:
    """Return what a run's result is called: as the run, and by what differs from the usual.

    Results of one agent on another view, backend or start set, or with another arm, have names of
    their own. Both are an `EvaluationConfig`.
    """
    parts = [run]
    if config.view != usual.view:
        parts.append(config.view)
    if (config.backend, config.generator) != (usual.backend, usual.generator):
        parts += [config.backend, *([Path(config.generator).stem] if config.generator else [])]
    if config.sets != usual.sets:
        parts.append("seed-" + "-".join(map(str, config.sets)))
    if config.starts != usual.starts:
        parts.append(f"{config.starts}-starts")
    if config.robot != usual.robot:
        parts.append(config.robot)
    return plain_name("-".join(parts))
