"""Which trainings of an agent are scored: those of its run, then published ones like them.

    envs/runs/<run>/                      the first training, of seed s
    envs/runs/<run>/seed-<s + 1>/         the second, and so on: what `repeats` of its entry trained
    envs/weights/<board>/<run>/seed-<n>/  published, laid out as the run's folder is

What `repeats` leaves out may come from published weights, so that a row of a board rests on several
trainings where one is trained. They are a board's, since what is learned depends on its data. They
count where agent, settings, phantom, dataset and encoder are those of the first, and seeds follow
without a gap: a seed that did badly cannot be left out, nor can a copy stand for a training.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_data.files import read_tensors
from racines_data.terminal import say
from racines_envs.agents.protocol import SETTINGS, Agent, agent_class
from racines_envs.evaluation.agent_specs import read_json
from racines_models.provenance import sha256_bytes, weights_sha256
from racines_models.training.checkpoint import PREFIX, repeat_folders

WEIGHTS = Path("envs/weights")
ASIDE = ("device", "threads", "encoder")
"""Settings that do not tell trainings apart; an encoder does, by its hash."""


@dataclass(frozen=True)
class Training:
    """One training of an agent."""

    folder: Path
    seed: int | None = None
    """None where the run does not say."""
    published: bool = False

    @property
    def files(self) -> dict[str, str]:
        """The SHA-256 of each file of weights, by name."""
        return weights_sha256(self.folder) if self.folder.is_dir() else {}


def published_run(board: str | None, run: str, weights: Path = WEIGHTS) -> Path | None:
    """Return where the published trainings of a board's run lie, if some are there."""
    folder = weights / board / run if board else None
    return folder if folder is not None and folder.is_dir() else None


def given_trainings(agent: Agent, further: Sequence[Agent], folder: Path) -> list[Training]:
    """Return the trainings of agents that are open already, seeds 0 and up.

    Raises:
        RacinesError: one observes something else than the first: they are of different methods.
    """
    for place, other in enumerate(further, start=1):
        if other.observation != agent.observation:
            raise RacinesError(
                f"{folder}: training {place} observes {other.observation}, the first "
                f"{agent.observation}: give trainings of one method"
            )
    return [Training(folder, place) for place in range(1 + len(further))]


def find_trainings(run_dir: Path | str, published: Path | None = None) -> list[Training]:
    """Return the trainings in a run's folder, the first first, then published ones that go on.

    Raises:
        RacinesError: further trainings in the run that are not the first one's, or copies.
    """
    first = Path(run_dir)
    own = {_seed(folder): folder for folder in repeat_folders(first)}
    others = {_seed(folder): folder for folder in repeat_folders(published)} if published else {}
    seed = read_json(first / SETTINGS).get("seed") if (first / SETTINGS).is_file() else None
    found = [Training(first, seed)]
    if not own and not others:
        return found
    if not isinstance(seed, int):
        raise RacinesError(f"{first / SETTINGS}: names no seed, and there are further trainings")
    while (seed := seed + 1) in own or seed in others:
        folder = own.get(seed) or others[seed]
        further = Training(folder, seed, folder.parent == published)
        if reason := _differs(first, further):
            if not further.published:
                raise RacinesError(
                    f"{further.folder}: {reason} than {first}: train them anew, in one go"
                )
            say(f"racines: {further.folder}: not counted: {reason} than {first}", err=True)
            break
        found.append(further)
    used = {training.folder for training in found}
    if left := [folder for folder in own.values() if folder not in used]:
        raise RacinesError(
            f"{left[0]}: there is no {PREFIX}{seed}: trainings are those of consecutive seeds, "
            "none left out; train them anew"
        )
    _check_no_copy(found)
    return found


def _seed(folder: Path) -> int:
    return int(folder.name.removeprefix(PREFIX))


def _differs(first: Path, other: Training) -> str:
    """Say in what a training is another method's than the first; nothing if in its seed alone."""
    one, two = (_made_of(folder) for folder in (first, other.folder))
    differing = sorted(key for key in one.keys() | two.keys() if one.get(key) != two.get(key))
    if differing:
        return f"another {', '.join(differing)}"
    told = read_json(other.folder / SETTINGS).get("seed")
    return "" if told == other.seed else f"another seed ({told}) by its settings"


def _made_of(folder: Path) -> dict[str, Any]:
    """Return what a training rests on besides its seed."""
    described, metrics = read_json(folder / SETTINGS), folder / "metrics.json"
    # A copy that `racines export weights` made has the run's metrics in its settings.
    copied = "training" in described and not metrics.is_file()
    learned = described["training"] if copied else read_json(metrics)
    # A setting that a training does not tell had yet to be thought of: it is as by default.
    settings = _defaults(described.get("agent")) | described.get("config", {})
    settings = {k: v for k, v in settings.items() if k not in ASIDE}
    data = learned.get("data") or {}
    return {
        **settings,
        "agent": described.get("agent"),
        "encoder": described.get("encoder_sha256"),
        "phantom": learned.get("phantom"),
        "dataset": data.get("recipe_digest") or data.get("digest"),
    }


def _defaults(agent: Any) -> dict[str, Any]:
    """Return the default settings of an agent, as JSON has them; none of one that is not here."""
    try:
        return json.loads(json.dumps(asdict(agent_class(str(agent)).Config())))
    except RacinesError:
        return {}


def _check_no_copy(found: list[Training]) -> None:
    seen: dict[str, Path] = {}
    for training in found:
        content = _content(training.folder)
        if content in seen:
            raise RacinesError(
                f"{training.folder}: the weights are those of {seen[content]}: a copy is no "
                "training; remove it"
            )
        seen[content] = training.folder


def _content(folder: Path) -> str:
    """Return a hash of all numbers in a folder's weights, whatever else is in their files."""
    parts = []
    for file in sorted(folder.glob("*.safetensors")):
        for name, tensor in sorted(read_tensors(file, remedy="get it again").items()):
            parts += [name.encode(), tensor.flatten().view(torch.uint8).numpy().tobytes()]
    return sha256_bytes(*parts) if parts else str(weights_sha256(folder) or folder)
