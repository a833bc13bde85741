"""Traces: the actions that an agent took from every start, to be taken again elsewhere.

    {"schema": "racines.trace/1", "agent": NAME, "observation": "params",
     "backend": "phantom", "reward": "oracle", "task": {...}, "phantom": {...} or null,
     "start_set": {"seeds": [0, 1, 2], "starts": 100},
     "episodes": [{"set": 0, "index": 0, "actions": [3, 0, 12, ...]}, ...]}

The environment is deterministic: the same actions from the same starts give the same figures. A
trace says what was done, not why: it does not show what the agent looked at.
"""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn

import torch
from torch import Tensor

from racines_data.digest import canonical_json
from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.randomness import derive
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import OBSERVATIONS, ScanCore
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import phantom_recipe

SCHEMA = "racines.trace/1"
MAX_BYTES = 20 * 2**20
MAX_EPISODES = 10_000
MAX_STEPS = 10_000
KEYS = {
    "schema": str, "agent": str, "observation": str, "backend": str, "reward": str, "task": dict,
    "phantom": (dict, type(None)), "start_set": dict, "episodes": list,
}  # fmt: skip
SHOWN = 80


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


def circumstances(core: ScanCore, backend: str) -> dict[str, Any]:
    """Return what decides where the same actions lead, as JSON gives it back."""
    told = {
        "backend": backend,
        "reward": core.reward.name,
        "task": asdict(core.task),
        "phantom": phantom_recipe(core.phantom),
    }
    return json.loads(json.dumps(told))


def start_seeds(start_set: dict[str, Any]) -> Tensor:
    """Return (E,) episode seeds of start sets, as a core begins them."""
    starts = [evaluation_seeds(start_set["starts"], seed) for seed in start_set["seeds"]]
    seeds = torch.cat(starts)
    return derive(seeds, torch.zeros_like(seeds))


def write_trace(path: Path, told: dict[str, Any], actions: list[list[int]]) -> int:
    """Write the actions of all episodes, set after set; return the number of steps.

    Args:
        path: The file.
        told: Agent, observation, start_set and what `circumstances` says.
        actions: Of each episode.
    """
    starts = told["start_set"]["starts"]
    episodes = [
        {"set": told["start_set"]["seeds"][i // starts], "index": i % starts, "actions": row}
        for i, row in enumerate(actions)
    ]
    head = json.dumps({"schema": SCHEMA} | told, indent=1)[:-2]
    rows = ",\n  ".join(json.dumps(row, separators=(",", ":")) for row in episodes)
    write_atomic(path, f'{head},\n "episodes": [\n  {rows}\n ]\n}}\n')
    return sum(map(len, actions))


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
    sets, starts = _start_set(told["start_set"], path)
    rows = told.pop("episodes")
    if len(rows) != len(sets) * starts:
        raise RacinesError(
            f"{path}: {len(rows)} episodes: its start set has {len(sets)} x {starts}"
        )
    actions = [_actions(row, sets[i // starts], i % starts, path) for i, row in enumerate(rows)]
    lengths = torch.tensor([len(row) for row in actions])
    table = torch.full((len(actions), int(lengths.max())), ACTIONS.index("idle"))
    for i, row in enumerate(actions):
        table[i, : len(row)] = torch.tensor(row, dtype=torch.int64)
    return Trace(told, start_seeds(told["start_set"]), table, lengths)


def check_same(trace: Trace, core: ScanCore, path: Path) -> None:
    """Check that a trace was recorded in the environment that it is to be replayed in.

    Raises:
        RacinesError: another task, reward or phantom.
    """
    here = circumstances(core, trace.told["backend"])
    for key, value in here.items():
        if canonical_json(trace.told[key]) != canonical_json(value):
            raise RacinesError(
                f"{path}: {key}: recorded with {_short(trace.told[key])}, this is "
                f"{_short(value)}: record it anew on the same"
            )


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise RacinesError(f"{path}: no such file")
    if path.stat().st_size > MAX_BYTES:
        raise RacinesError(f"{path}: {path.stat().st_size:,} bytes: at most {MAX_BYTES:,} are read")
    try:
        told = json.loads(path.read_text(), parse_constant=_refused, parse_float=_finite)
    except (OSError, ValueError, RecursionError) as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(told, dict):
        raise RacinesError(f"{path}: a {type(told).__name__} is no trace")
    return told


def _start_set(told: dict[str, Any], path: Path) -> tuple[list[int], int]:
    sets, starts = told.get("seeds", []), told.get("starts", 0)
    whole = isinstance(sets, list) and all(type(s) is int and 0 <= s < 2**31 for s in sets)
    fits = whole and type(starts) is int and set(told) == {"seeds", "starts"} and starts > 0
    if not fits or not sets or len(set(sets)) != len(sets) or len(sets) * starts > MAX_EPISODES:
        raise RacinesError(
            f"{path}: start_set: give different seeds, and starts; {MAX_EPISODES:,} episodes in all"
        )
    return sets, starts


def _actions(row: Any, seed: int, index: int, path: Path) -> list[int]:
    """Return the actions of an episode that is the one at its place."""
    place = {"set": seed, "index": index}
    if not isinstance(row, dict) or set(row) != {*place, "actions"}:
        raise RacinesError(f"{path}: episode {place}: give set, index and actions")
    actions = row["actions"]
    if any(type(row[key]) is not int or row[key] != value for key, value in place.items()):
        raise RacinesError(f"{path}: set {row['set']}, index {row['index']}: expected {place}")
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
    value = float(text)
    return value if math.isfinite(value) else _refused(text)


def _refused(text: str) -> NoReturn:
    raise ValueError(f"holds {text[:SHOWN]}, no finite number")
