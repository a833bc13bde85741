"""How good an agent is on patients: fixed starts on each of them, a few patients in memory at once.

A start belongs to a patient: its episode's seed is a hash of both, so that the same patient is
found in the same state whatever else is evaluated beside it, and however the rest is cut to chunks.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.engines import Engine
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.own.heart import heart_provenance
from racines_data.patients.memory import check_memory
from racines_data.patients.patient import PATHOLOGIES
from racines_data.patients.population import draw_patient
from racines_envs.agents import learns, load_agent
from racines_envs.agents.protocol import FILES, Agent
from racines_envs.agents.rollout import Episodes, rollout
from racines_envs.agents.trace import (
    MAX_EPISODES,
    TraceAgent,
    check_traceable,
    circumstances,
    read_trace,
    write_trace,
)
from racines_envs.evaluation.agent_specs import check_view, plain_name
from racines_envs.evaluation.measures import (
    Metrics,
    Values,
    measure_patients,
    patient_values,
    values_of,
)
from racines_envs.evaluation.run import SCHEMA, Scored, core_for
from racines_envs.evaluation.told import carried_by, extractors_of, shown_to, told_of_agent
from racines_envs.evaluation.trainings import Training, find_trainings, given_trainings
from racines_envs.robots.arm import FREE
from racines_envs.task.core import ScanCore
from racines_envs.task.names import HEART_TIER
from racines_envs.task.starts import patient_seeds
from racines_envs.task.tasks import Task, get_task
from racines_envs.task.tiers import MIDDLES
from racines_envs.worlds.making import patients_recipe
from racines_envs.worlds.ward import Ward, choose_patients, make_ward
from racines_models.devices import on_device
from racines_models.statistics import Evidence


@dataclass(frozen=True)
class PatientsConfig:
    """On whom, from where and how an agent is judged."""

    view: str = "A4C-patients"
    """A task on patients, by its name."""
    split: str = "validation"
    """Whose patients: `train`, `validation` or `test`."""
    patients: int = 140
    """So many of them, the first."""
    starts: int = 5
    """Episodes on each patient."""
    seed: int = 0
    """Names the start set."""
    chunk: int = 20
    """Patients in memory at once, 20 MB each; no figure depends on it."""
    reward: str = "oracle"
    """Whose return is reported."""
    device: str = "cpu"
    phantom: str = ""
    """Folder or name of a heart of one's own that all of them have; none if empty."""
    robot: str = FREE
    """`free`, or the arm that carries the probe: `ur5e`, another's name, `module:ARM`."""

    @property
    def task(self) -> Task:
        """The task; `RacinesError` if it is none on patients."""
        task = get_task(self.view)
        if task.tier == HEART_TIER:
            raise RacinesError(
                f"task {task.id} has one heart: name one on patients, as {self.view}-patients"
            )
        return task


def row_name(entry: str, view: str) -> str:
    """Return what a run is called on its tier's board, where it has a row for each view."""
    return plain_name(f"{entry}-{get_task(view).view}")


def run_name(row: str, view: str) -> str:
    """Return the run of a row of a tier's board."""
    return row.removesuffix(f"-{plain_name(get_task(view).view)}")


class StartSet(NamedTuple):
    """Fixed starts: of each patient as many, patient after patient."""

    patients: tuple[int, ...]
    starts: int
    seed: int

    @property
    def units(self) -> np.ndarray:
        """(N,) the patient of each start."""
        return np.repeat(np.array(self.patients), self.starts)

    @property
    def seeds(self) -> Tensor:
        """(N,) int64 seeds of the episodes."""
        return patient_seeds(self.patients, self.starts, self.seed)

    def chunks(self, size: int) -> Iterator["StartSet"]:
        """Yield the starts of so many patients at a time."""
        for first in range(0, len(self.patients), size):
            yield self._replace(patients=self.patients[first : first + size])

    def told(self, config: PatientsConfig) -> dict[str, Any]:
        """Return the start set as documents name it, with a digest of all that decides it."""
        told = {"split": config.split, "patients": len(self.patients)}
        told |= {"starts": self.starts, "seeds": [self.seed]}
        rule = {"task": config.task.definition, "middles": MIDDLES, "seeds": self.seeds.tolist()}
        if config.phantom:  # another world: no start set of a board
            rule |= {"phantom": heart_provenance(config.phantom)["digest"]}
        return told | {"digest": recipe_digest(rule | {"patients": list(self.patients)})}


def evaluate_patients(
    name: str, run_dir: Path, config: PatientsConfig, agent: Agent | None = None,
    run: str | None = None, board: str | None = None, published: Path | None = None,
    starts: StartSet | None = None, engine: Engine | None = None, further: Sequence[Agent] = (),
) -> Scored:  # fmt: skip
    """Run an agent on patients and score it; arguments as of `evaluate`.

    `starts` stands for the start set that the settings name, whose split has to be its patients'.
    With an `engine` that is started, each chunk of patients is a task.

    Raises:
        RacinesError: unknown names, missing weights, an agent that was trained for another task,
            an unknown split, more patients than it has, or a chunk larger than memory.
    """
    began = time.perf_counter()
    config = on_device(config)
    starts = starts or start_set(config)
    agents, trainings = open_agents(name, run_dir, config, agent, published)
    agent = agents[0]
    if isinstance(agent, TraceAgent):
        agent.check_starts(starts.told(config))
    if further:
        agents, trainings = [agent, *further], given_trainings(agent, further, Path(run_dir))
        for other in further:
            check_view(other, config.view, name, run_dir)
    acted = act_on_patients(agents, config, starts, engine=engine)
    values = patient_values(acted)
    metrics, evidence = measure_patients(values, starts.units)
    task = {
        "view": config.view, "backend": "phantom", "split": config.split,
        "observation": shown_to(agent), "reward": config.reward, "start_set": starts.told(config),
        "definition": config.task.definition, **carried_by(config.robot),
    }  # fmt: skip
    scores = {"schema": SCHEMA, **told_of_agent(agent, trainings, config.device)}
    scores |= {"task": task, "phantom": world_of(config), "metrics": metrics}
    if not config.phantom:
        scores |= {"by_pathology": _by_pathology(values, starts.units)}
    scores |= {"seeds": [starts.seed]}
    scores |= {"agent": run or agent.name} | ({"board": board} if board else {})
    if guide := extractors_of(agent):
        scores["extractors"] = guide
    return Scored(scores | {"seconds": time.perf_counter() - began}, evidence)


def world_of(config: PatientsConfig) -> dict[str, Any]:
    """Return what scores say of the world that settings name."""
    own = heart_provenance(config.phantom) if config.phantom else None
    return patients_recipe(config.task.tier, own)


def open_agents(
    name: str, run_dir: Path, config: PatientsConfig, agent: Agent | None = None,
    published: Path | None = None,
) -> tuple[list[Agent], list[Training]]:  # fmt: skip
    """Return an agent of each training of a run, for the view of the settings, and the trainings.

    One that is given, and one in a file, stands for a single training.

    Raises:
        RacinesError: as `evaluate_patients`.
    """
    given = agent is not None or Path(name).suffix.lower() in FILES
    agent = agent or load_agent(name, run_dir, config.device)
    check_view(agent, config.view, name, run_dir)
    trainings = [Training(Path(run_dir))]
    if learns(agent) and not given:
        trainings = find_trainings(run_dir, published)
    others = [load_agent(name, each.folder, config.device) for each in trainings[1:]]
    return [agent, *others], trainings


def start_set(config: PatientsConfig) -> StartSet:
    """Return the starts that settings name, if patients and memory allow."""
    if config.starts < 1 or config.chunk < 1:
        raise RacinesError("evaluation on patients: starts and chunk are at least 1")
    patients = choose_patients(config.split, config.patients)
    check_memory(min(config.chunk, len(patients)))
    return StartSet(patients, config.starts, config.seed)


def refuse_arm(config: PatientsConfig, study: str) -> None:
    """Refuse settings with an arm in a study of free probes, whose figures would not say so."""
    if config.robot != FREE:
        raise RacinesError(f"{study}.robot {config.robot}: the study is of a free probe: leave out")


def act_on_patients(
    agents: Sequence[Agent],
    config: PatientsConfig,
    starts: StartSet,
    ward_of: Callable[[StartSet], Ward] | None = None,
    around: Callable[[ScanCore], ScanCore] | None = None,
    engine: Engine | None = None,
) -> list[dict[str, np.ndarray]]:
    """Return the last infos, (N,) each, of every agent's episodes.

    Args:
        agents: who act, one after the other.
        config: on whom, and how.
        starts: from where.
        ward_of: makes the ward of a chunk of the starts, in place of the patients as they are.
        around: makes the environment that is acted in of the usual one.
        engine: runs a task a chunk; None: here, one after the other.
    """
    work, state = _act_on_chunk, (agents, config, ward_of, around)
    chunks = starts.chunks(config.chunk)
    made = list((engine or LocalEngine()).map(work, state, chunks, threads=None))
    names = made[0][0]
    return [
        {name: np.concatenate([of_chunk[k][name] for of_chunk in made]) for name in names}
        for k in range(len(agents))
    ]


_Acting = tuple[
    Sequence[Agent], PatientsConfig, Callable[[StartSet], Ward] | None,
    Callable[[ScanCore], ScanCore] | None,
]  # fmt: skip
"""Who acts, how, and in what: see `act_on_patients`."""


def _act_on_chunk(state: _Acting, chunk: StartSet) -> list[dict[str, np.ndarray]]:
    """Return the last infos of every agent's episodes on a few patients."""
    return [episodes.final for _, episodes in _on_chunk(state, chunk)]


def _on_chunk(state: _Acting, chunk: StartSet) -> Iterator[tuple[ScanCore, Episodes]]:
    """Give every agent's episodes on a few patients, and the environment that they were in."""
    agents, config, ward_of, around = state
    if ward_of is None:
        ward = make_ward(
            config.task.tier, config.split, chunk.patients, config.device, phantom=config.phantom
        )
    else:
        ward = ward_of(chunk)
    seeds, case = chunk.seeds, ward.case_of(chunk.units.tolist())
    for agent in agents:
        core = core_for(
            agent, config.task, len(seeds), reward=config.reward, phantom=ward,
            device=config.device, robot=config.robot,
        )  # fmt: skip
        core = core if around is None else around(core)
        episodes = rollout(core, agent, seeds.to(core.device), case)
        if isinstance(agent, TraceAgent):
            agent.check_ended(episodes)
        yield core, episodes


def record_on_patients(
    name: str, run_dir: Path, config: PatientsConfig, path: Path, agent: Agent | None = None
) -> dict[str, Any]:
    """Let an agent act from the starts that it is judged on, and write what it did to a file.

    All but `path` is as of `evaluate_patients`; what comes back is that path, and counts. Of a run
    of several trainings, the first acts.
    """
    config = on_device(config)
    starts = start_set(config)
    if not 0 <= config.seed < 2**31 or len(starts.patients) * starts.starts > MAX_EPISODES:
        raise RacinesError(
            f"evaluation_patients: seed {config.seed}, {len(starts.patients)} patients, "
            f"{starts.starts} starts on each: a trace takes seeds of 0 to {2**31 - 1} and "
            f"{MAX_EPISODES:,} episodes in all"
        )
    acting = open_agents(name, run_dir, config, agent)[0][0]
    check_traceable(acting)
    told = {"agent": acting.name, "observation": shown_to(acting), "start_set": starts.told(config)}
    parts = []
    for chunk in starts.chunks(config.chunk):
        ((core, episodes),) = _on_chunk(([acting], config, None, None), chunk)
        told |= circumstances(core, "phantom")
        parts.append(episodes)
        del core  # whose patients need not stay while the next are made
    count, steps = write_trace(path, told, parts)
    read_trace(path)
    return {"out": str(path), "episodes": count, "steps": steps}


def by_pathology_of(evidence: Evidence) -> dict[str, Metrics]:
    """Return the metrics of each pathology that follow from the evidence of all episodes.

    Raises:
        ValueError: evidence without the episodes.
    """
    kept = [
        (each.items, each.units)
        for each in evidence.figures.values()
        if each.items is not None and each.units is not None
    ]
    if not kept:
        raise ValueError("no patient of any episode")
    items, units = kept[0]
    if not all(np.array_equal(a, items) and np.array_equal(b, units) for a, b in kept):
        raise ValueError("figures of unlike episodes")
    try:
        return _by_pathology(values_of(evidence), units)
    except (KeyError, RacinesError) as error:
        raise ValueError(f"no {error}") from error


def _by_pathology(values: Values, units: np.ndarray) -> dict[str, Metrics]:
    """Return the metrics of the patients of each pathology; its count of patients is their unit."""
    found: dict[int, str] = {seed: draw_patient(seed).pathology for seed in set(units.tolist())}
    ails = np.array([PATHOLOGIES.index(found[seed]) for seed in units.tolist()])
    return {
        name: measure_patients(
            {key: each[:, ails == index] for key, each in values.items()}, units[ails == index]
        )[0]
        for index, name in enumerate(PATHOLOGIES)
        if (ails == index).any()
    }
