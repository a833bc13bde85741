"""Traces: the actions that an agent took from every start, and an agent that takes them again.

    {"schema": "racines.trace/1", "agent": NAME, "observation": "params",
     "backend": "phantom", "reward": "oracle", "task": {...}, "phantom": {...} or null,
     "start_set": {"seeds": [0, 1, 2], "starts": 100},
     "episodes": [{"set": 0, "index": 0, "actions": [3, 0, 12, ...]}, ...]}

On patients the start set is as scores name it, and an episode says `patient` in place of `set`.
The environment is deterministic: the same actions from the same starts give the same figures. A
trace says what was done, not why: it does not show what the agent looked at.
"""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from racines_data.digest import canonical_json
from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.patients.splits import SPLITS, seeds_of
from racines_data.randomness import derive
from racines_envs.agents.protocol import DISCRETE, Agent, Untrained, acts
from racines_envs.agents.rollout import Episodes
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.core import OBSERVATIONS, ScanCore
from racines_envs.task.names import GOALS, HEART_TIER, TIERS, task_name
from racines_envs.task.starts import evaluation_seeds, patient_seeds
from racines_envs.worlds.making import phantom_recipe
from racines_models.provenance import sha256_bytes

SCHEMA = "racines.trace/1"
MAX_BYTES = 20 * 2**20
MAX_EPISODES = MAX_STEPS = 10_000
KEYS = {
    "schema": str, "agent": str, "observation": str, "backend": str, "reward": str, "task": dict,
    "phantom": (dict, type(None)), "start_set": dict, "episodes": list,
}  # fmt: skip
PATIENTS_KEYS = {"split", "patients", "starts", "seeds", "digest"}
"""Of a start set on patients."""
SHOWN = 80
TOLD = {"view": "", "tier": HEART_TIER}
"""What a task's definition says of its name; those of the one heart say no tier."""


@dataclass(frozen=True)
class Trace:
    """A trace as it was read."""

    told: dict[str, Any]
    """All but the episodes."""
    seeds: Tensor
    """(E,) int64 episode seeds, as `ScanCore.state.seed` has them."""
    actions: Tensor
    """(E, T) int64, idle behind the end."""
    lengths: Tensor
    """(E,) int64."""
    starts: "Starts"

    def place(self, episode: int) -> str:
        """Return how errors name an episode."""
        return ", ".join(f"{key} {value}" for key, value in self.starts.row(episode).items())


@dataclass(frozen=True)
class Starts:
    """From where the episodes of a trace start: of each set, or on each patient, as many."""

    unit: str
    """`set` or `patient`."""
    units: Sequence[int]
    each: int
    seed: int = 0
    """Of the starts on patients."""

    def row(self, episode: int) -> dict[str, int]:
        """Return where an episode stands."""
        return {self.unit: self.units[episode // self.each], "index": episode % self.each}

    def seeds(self) -> Tensor:
        """Return the (E,) int64 seeds of the episodes."""
        if self.unit == "patient":
            return patient_seeds(self.units, self.each, self.seed)
        return torch.cat([evaluation_seeds(self.each, seed) for seed in self.units])


def circumstances(core: ScanCore, backend: str) -> dict[str, Any]:
    """Return what decides where the same actions lead, as JSON gives it back."""
    if core.robot.joints:
        raise RacinesError(f"a trace is of a free probe, and a {core.robot.name} carries this one")
    told = {"backend": backend, "reward": core.reward.name, "task": core.task.definition}
    return json.loads(json.dumps(told | {"phantom": phantom_recipe(core.phantom)}))


def check_traceable(agent: Agent) -> None:
    """Refuse an agent that takes other than the numbered steps, before it acts."""
    if (action := acts(agent)) != DISCRETE:
        raise RacinesError(
            f"{agent.name} acts by {action}: a trace holds the {len(ACTIONS)} discrete steps alone"
        )


def refuse_trace(agent: Agent) -> None:
    """Refuse a trace where it matters what an agent looks at."""
    if isinstance(agent, TraceAgent):
        raise RacinesError(
            f"{agent.path}: a trace looks at nothing: name the agent, or a policy as ONNX"
        )


def write_trace(path: Path, told: dict[str, Any], parts: Iterable[Episodes]) -> tuple[int, int]:
    """Write the actions of all episodes, in the order of their starts; return episodes and steps.

    `told` is agent, observation, start_set and what `circumstances` says.
    """
    starts, lines, total = _start_set(told["start_set"], path), list[str](), 0
    for episodes in parts:
        steps = episodes.final["steps"].tolist()
        for actions, count in zip(torch.stack(episodes.actions, 1).tolist(), steps, strict=True):
            row = starts.row(len(lines)) | {"actions": actions[:count]}
            lines.append(json.dumps(row, separators=(",", ":")))
        total += sum(steps)
    head = json.dumps({"schema": SCHEMA} | told, indent=1)[:-2]
    rows = ",\n  ".join(lines)
    write_atomic(path, f'{head},\n "episodes": [\n  {rows}\n ]\n}}\n')
    return len(lines), total


def read_trace(path: Path) -> Trace:
    """Read a trace as what a stranger sent.

    Raises:
        RacinesError: absent or too large, no such JSON, unknown keys, episodes that are not those
            of its start set, or actions that are none.
    """
    told = _read(path)
    if set(told) != set(KEYS):
        other = sorted(set(told) ^ set(KEYS))
        raise RacinesError(f"{path}: keys unknown or missing: {', '.join(other)[:SHOWN]}")
    for key, kind in KEYS.items():
        if not isinstance(told[key], kind):
            raise RacinesError(f"{path}: {key}: a {type(told[key]).__name__} is refused")
    if told["schema"] != SCHEMA or told["observation"] not in OBSERVATIONS:
        raise RacinesError(f"{path}: schema is not {SCHEMA}, or observation is unknown")
    _task_of(told["task"], path)
    starts = _start_set(told["start_set"], path)
    rows = told.pop("episodes")
    if len(rows) != len(starts.units) * starts.each:
        wanted = f"{len(starts.units)} x {starts.each}"
        raise RacinesError(f"{path}: {len(rows)} episodes: its start set has {wanted}")
    actions = [_actions(row, starts.row(i), path) for i, row in enumerate(rows)]
    lengths = torch.tensor([len(row) for row in actions])
    rows = [torch.tensor(row) for row in actions]
    table = pad_sequence(rows, batch_first=True, padding_value=IDLE)
    seeds = starts.seeds()
    return Trace(told, derive(seeds, torch.zeros_like(seeds)), table, lengths, starts)


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise RacinesError(f"{path}: no such file")
    if path.stat().st_size > MAX_BYTES:
        raise RacinesError(f"{path}: {path.stat().st_size:,} bytes: at most {MAX_BYTES:,} are read")
    try:
        told = json.loads(
            path.read_text(encoding="utf-8"), parse_constant=_finite, parse_float=_finite
        )
    except (OSError, ValueError, RecursionError) as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(told, dict):
        raise RacinesError(f"{path}: a {type(told).__name__} is no trace")
    return told


def _task_of(told: dict[str, Any], path: Path) -> str:
    """Return the name of the task that a trace was recorded at; on patients it is a known one."""
    view, tier = (told.get(key, usual) for key, usual in TOLD.items())
    if not isinstance(view, str) or not 0 < len(view) <= SHOWN or not view.isprintable():
        raise RacinesError(f"{path}: task.view: {_short(view)}: give the name of a view")
    if tier not in TIERS or (tier != HEART_TIER and view not in GOALS):
        goals = f"with {' or '.join(TIERS[1:])} one of {', '.join(GOALS)}"
        raise RacinesError(
            f"{path}: task: view {view}, tier {_short(tier)}: choose {', '.join(TIERS)}, {goals}"
        )
    return task_name(view, tier=tier)


def _start_set(told: dict[str, Any], path: Path) -> Starts:
    sets, starts = told.get("seeds", []), told.get("starts", 0)
    whole = isinstance(sets, list) and all(type(s) is int and 0 <= s < 2**31 for s in sets)
    whole = whole and type(starts) is int and starts > 0
    if "split" in told:
        return _on_patients(told, sets if whole and len(sets) == 1 else [], starts, path)
    fits = whole and set(told) == {"seeds", "starts"}
    if not fits or not sets or len(set(sets)) != len(sets) or len(sets) * starts > MAX_EPISODES:
        raise RacinesError(
            f"{path}: start_set: give different seeds, and starts; {MAX_EPISODES:,} episodes in all"
        )
    return Starts("set", sets, starts)


def _on_patients(told: dict[str, Any], seeds: list[int], starts: int, path: Path) -> Starts:
    """Return the starts on a split's first patients; `seeds` is empty where they are at fault."""
    split, count = told["split"], told.get("patients")
    if not isinstance(split, str) or split not in SPLITS:
        raise RacinesError(f"{path}: start_set.split: {_short(split)}: choose {', '.join(SPLITS)}")
    known = seeds_of(split)
    count = count if type(count) is int else 0
    fits = len(seeds) == 1 and set(told) == PATIENTS_KEYS
    if not fits or not 0 < count <= len(known) or count * starts > MAX_EPISODES:
        raise RacinesError(
            f"{path}: start_set: give {', '.join(sorted(PATIENTS_KEYS))}: one seed, the first 1 to "
            f"{len(known):,} patients of the split; {MAX_EPISODES:,} episodes in all"
        )
    return Starts("patient", known[:count], starts, seeds[0])


def _actions(row: Any, place: dict[str, int], path: Path) -> list[int]:
    """Return the actions of an episode that is the one at its place."""
    if not isinstance(row, dict) or set(row) != {*place, "actions"}:
        raise RacinesError(f"{path}: episode {place}: give {', '.join(place)} and actions")
    actions = row["actions"]
    if any(type(row[key]) is not int or row[key] != value for key, value in place.items()):
        found = ", ".join(f"{key} {row[key]}"[:SHOWN] for key in place)
        raise RacinesError(f"{path}: {found}: expected {place}")
    whole = isinstance(actions, list) and 0 < len(actions) <= MAX_STEPS
    if not whole or not all(type(a) is int and 0 <= a < len(ACTIONS) for a in actions):
        raise RacinesError(
            f"{path}: episode {place}: actions: give 1 to {MAX_STEPS:,} of 0 to {len(ACTIONS) - 1}"
        )
    return actions


def _short(value: Any) -> str:
    text = canonical_json(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(f"holds {text[:SHOWN]}, no finite number")
    return float(text)


class TraceAgent(Untrained):
    """Takes the actions of one file, each from the start that it was recorded at.

    Raises:
        RacinesError: the file is refused.
    """

    name: ClassVar[str] = "trace"
    origin: ClassVar[str] = "record one: racines export trace AGENT --out FILE"
    trained: bool = True
    """Who acted is not known."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.trace = read_trace(self.path)
        self.sha256 = sha256_bytes(self.path.read_bytes())
        """Hash of the file."""
        self.view: str = _task_of(self.trace.told["task"], self.path)
        self.seen: str = self.trace.told["observation"]
        """What the recorded agent looked at, by its own word."""
        self._rows: Tensor | None = None

    def attach(self, core: ScanCore) -> None:
        """Keep the environment, whose steps say what comes next; it has to be the recorded one."""
        told = self.trace.told
        for key, value in circumstances(core, told["backend"]).items():
            if canonical_json(told[key]) != canonical_json(value):
                raise RacinesError(
                    f"{self.path}: {key}: recorded with {_short(told[key])}, this is "
                    f"{_short(value)}: record it anew on the same"
                )
        self._core, self._rows = core, None

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the recorded action of each row, which there must be; idle behind its end."""
        state, trace = self._core.state, self.trace
        if self._rows is None:
            self._rows = self._find(state.seed.cpu())
        steps, done = state.steps.cpu(), state.done.cpu()
        short = ~done & (steps >= trace.lengths[self._rows])
        if bool(short.any()):
            self._refuse(int(short.nonzero()[0]), "ends before its episode does")
        place = steps.clamp_max(trace.actions.shape[1] - 1)
        actions = torch.where(done, IDLE, trace.actions[self._rows, place])
        return actions.to(state.seed.device)

    def check_starts(self, told: dict[str, Any]) -> None:
        """Check that it was recorded from a start set on patients, as scores name it."""
        if self.trace.told["start_set"] != told:
            raise RacinesError(
                f"{self.path}: start_set: recorded from {_short(self.trace.told['start_set'])}, "
                f"this is {_short(told)}: evaluate from the same, or record it anew"
            )

    def check_ended(self, episodes: Episodes) -> None:
        """Check that every episode took all the actions that were recorded of it."""
        assert self._rows is not None
        left = np.flatnonzero(episodes.final["steps"] != self.trace.lengths[self._rows].numpy())
        if len(left):
            self._refuse(int(left[0]), "goes on behind the end of its episode")

    def _find(self, seeds: Tensor) -> Tensor:
        """Return the recorded episode of each row."""
        place = {seed: episode for episode, seed in enumerate(self.trace.seeds.tolist())}
        rows = [place.get(seed, -1) for seed in seeds.tolist()]
        starts = self.trace.starts
        # Patients are judged a few at a time.
        whole = starts.unit == "patient" or len(place) == len(rows)
        if not whole or -1 in rows:
            sets = f"sets {starts.units}" if starts.unit == "set" else "patients of its split"
            told = f"{starts.each} starts of each of the {sets}, not from these {len(seeds)}"
            raise RacinesError(
                f"{self.path}: recorded from {told}: evaluate with the same seeds and starts, or "
                "record it anew"
            )
        return torch.tensor(rows)

    def _refuse(self, row: int, what: str) -> None:
        assert self._rows is not None
        where = self.trace.place(int(self._rows[row]))
        raise RacinesError(
            f"{self.path}: {where}: the trace {what}: it was recorded in another environment; "
            "record it anew"
        )

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Open a file."""
        return cls(Path(run_dir))
