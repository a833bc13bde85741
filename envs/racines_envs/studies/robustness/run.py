"""Robustness: the same agent from the same starts on the same patients, with something wrong.

    nothing, then each disturbance at three strengths, then all of them at three strengths

What is reported is the share found and declared, and by how much less that is than with nothing
wrong, paired by patient; and who was found, episode by episode, so that whoever is handed a report
can make its figures again. Conditions are written as they are done; a run that was killed goes on.
"""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.own.pool import make_pool
from racines_data.patients.population import draw_patient
from racines_envs.agents.protocol import Agent
from racines_envs.agents.trace import refuse_trace
from racines_envs.evaluation.measures import Values, measure_patients, patient_values
from racines_envs.evaluation.patients import (
    PatientsConfig,
    StartSet,
    act_on_patients,
    open_agents,
    refuse_arm,
    start_set,
    world_of,
)
from racines_envs.evaluation.told import told_of_agent
from racines_envs.studies.kept import read_kept
from racines_envs.studies.robustness.core import DisturbedCore
from racines_envs.studies.robustness.disturbances import (
    DISTURBANCES,
    STRENGTHS,
    Applied,
    disturbed,
    told,
)
from racines_envs.task.core import ScanCore
from racines_envs.task.names import BEATING
from racines_envs.worlds.ward import Ward
from racines_models.devices import on_device
from racines_models.statistics import Evidence

SCHEMA = "racines.robustness/2"
NOTHING, ALL = "nothing", "all"
RANKED = "success_declared"
SHOWN = (RANKED, "reached", "false_declarations", "seconds", "position_error_median",
         "rotation_error_median", "final_grade")  # fmt: skip
"""Metrics that a condition keeps."""


@dataclass(frozen=True)
class RobustnessConfig(PatientsConfig):
    """On whom, from where, and what is wrong."""

    patients: int = 40
    starts: int = 1
    disturbances: tuple[str, ...] = ()
    """Their names; all that mean anything in the task's tier if empty."""
    chunk: int = 40


class Condition(NamedTuple):
    """What is wrong in one part of the study."""

    name: str
    """`nothing`, a disturbance, or `all`."""
    strength: str
    """One of `STRENGTHS`; empty with nothing wrong."""
    applied: Applied

    @property
    def title(self) -> str:
        """Name and strength."""
        return f"{self.name}, {self.strength}" if self.strength else self.name


def conditions(config: RobustnessConfig) -> list[Condition]:
    """Return the conditions in their order.

    Raises:
        RacinesError: an unknown disturbance, or one that means nothing in the task's tier.
    """
    tier = config.task.tier
    names = config.disturbances or tuple(
        name for name, each in DISTURBANCES.items() if tier in each.tiers
    )
    for name in names:
        if name not in DISTURBANCES:
            known = ", ".join(DISTURBANCES)
            raise RacinesError(f"robustness.disturbances: no {name!r}; choose of {known}")
        if tier not in DISTURBANCES[name].tiers:
            raise RacinesError(f"robustness.disturbances: {name} means nothing on tier {tier}")
    chosen = [DISTURBANCES[name] for name in names]
    found = [Condition(NOTHING, "", {})]
    for each in chosen:
        found += [
            Condition(each.name, strength, {each: amount})
            for strength, amount in zip(STRENGTHS, each.amounts, strict=True)
        ]
    if len(chosen) > 1:
        found += [
            Condition(ALL, strength, {each: each.amounts[level] for each in chosen})
            for level, strength in enumerate(STRENGTHS)
        ]
    return found


def evaluate_robustness(
    name: str,
    run_dir: Path,
    config: RobustnessConfig,
    out: Path,
    run: str | None = None,
    advance: Callable[[str], None] | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Let an agent act under each condition; write `out` as it goes, and return what it holds.

    Args:
        name: as of `evaluate_patients`.
        run_dir: likewise.
        config: all settings.
        out: the JSON file; one of the same study goes on from what it holds.
        run: what the agent is called.
        advance: told the title of each condition that is done.
        force: take the place of another study, once the first condition is done.

    Raises:
        RacinesError: as `evaluate_patients`; or, without `force`, a file of another study, which is
            left as it is. Other code makes another study.
    """
    config, began = on_device(config), time.perf_counter()
    refuse_arm(config, "robustness")
    starts, wanted = start_set(config), conditions(config)
    agents, trainings = open_agents(name, run_dir, config)
    refuse_trace(agents[0])
    about = told_of_agent(agents[0], trainings, config.device)
    document: dict[str, Any] = {
        "schema": SCHEMA, **about, "agent": run or about["agent"],
        "task": {"view": config.view, "start_set": starts.told(config)},
        "phantom": world_of(config),
        "disturbances": {each: described(each) for each in DISTURBANCES},
        "patients": starts.units.tolist(),
    }  # fmt: skip
    study = _identity(document, config)
    document |= {"study": study, "conditions": {}, "seconds": 0.0}
    kept = read_kept(out, study, force)
    spent = kept.get("seconds", 0.0)
    document["conditions"] = {
        each.title: kept["conditions"][each.title]
        for each in wanted
        if each.title in kept.get("conditions", {})
    }
    base: np.ndarray | None = None
    for condition in wanted:
        done = condition.title in document["conditions"]
        if done and (condition.name != NOTHING or len(document["conditions"]) == len(wanted)):
            continue
        values = _under(condition, agents, config, starts)
        metrics, _ = measure_patients(values, starts.units)
        base = values[RANKED] if condition.name == NOTHING else base
        assert base is not None  # nothing wrong comes first, and again where a run goes on
        row: dict[str, Any] = {"name": condition.name, "strength": condition.strength}
        row |= {"amounts": told(condition.applied)}
        row |= {"metrics": {each: metrics[each] for each in SHOWN}}
        row["found"] = values[RANKED].astype(int).tolist()
        if condition.name != NOTHING:
            row["change"] = _change(values[RANKED] - base, starts.units)
        document["conditions"][condition.title] = row
        document["seconds"] = spent + time.perf_counter() - began
        write_json(out, document)
        if advance is not None:
            advance(condition.title)
    return document


def described(name: str) -> dict[str, Any]:
    """Return what a report says of a disturbance."""
    each = DISTURBANCES[name]
    return {"what": each.what, "unit": each.unit, "amounts": list(each.amounts)}


def _under(
    condition: Condition, agents: list[Agent], config: RobustnessConfig, starts: StartSet
) -> Values:
    """Return the figures of each episode under a condition."""
    applied = condition.applied

    def ward_of(chunk: StartSet) -> Ward:
        patients = [disturbed(draw_patient(seed), applied) for seed in chunk.patients]
        beating = config.task.tier == BEATING
        return Ward(make_pool(patients, config.device, beating, phantom=config.phantom))

    def around(core: ScanCore) -> ScanCore:
        return DisturbedCore(core, applied)

    acted = act_on_patients(agents, config, starts, ward_of, around)
    return patient_values(acted)


def _change(apart: np.ndarray, units: np.ndarray) -> dict[str, Any]:
    """Return the mean of (R, N) differences, paired by training and by start."""
    figures = Evidence().add("change", "mean", apart[:, None], np.arange(len(units)), units)
    return figures.interval(-1.0, 1.0).to_json()


def _identity(document: dict[str, Any], config: RobustnessConfig) -> str:
    """Return a digest of all that decides the figures."""
    aside = ("chunk", "device", "disturbances", "robot")
    settings = {key: value for key, value in asdict(config).items() if key not in aside}
    keys = ("schema", "agent", "weights", "task", "phantom", "disturbances")
    parts = {key: document[key] for key in keys}
    code = document["code"]
    return recipe_digest(json.loads(json.dumps(parts | {"settings": settings, "code": code})))


def changes(document: dict[str, Any]) -> Iterator[tuple[str, list[dict[str, Any] | None]]]:
    """Yield each disturbance's name and its changes by strength, the costliest first."""
    rows = document["conditions"].values()
    names = dict.fromkeys(row["name"] for row in rows if row["name"] != NOTHING)
    found = {
        name: [
            next((row["change"] for row in rows
                  if (row["name"], row["strength"]) == (name, strength)), None)
            for strength in STRENGTHS
        ]
        for name in names
    }  # fmt: skip

    def cost(name: str) -> float:
        return sum(each["value"] for each in found[name] if each is not None)

    yield from ((name, found[name]) for name in sorted(found, key=cost))
