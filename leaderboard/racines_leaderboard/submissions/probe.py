"""The contract, tried on what is handed in before it is taken or scored.

A file's graph runs confined; a merged class runs as it is, from a run of it that lies here. What a
kind of artefact cannot tell is said, not passed over. The poses and starts of the probe follow from
the artefact's own hash, so that no file can be made to behave well on those alone.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import torch
from safetensors.torch import load, save
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.manifest import MANIFEST, read_manifest
from racines_data.randomness import derive
from racines_data.store.frames import FrameStore, open_store
from racines_envs.agents.contract import check_policy, check_same_actions
from racines_envs.agents.policy import PolicyAgent
from racines_envs.agents.protocol import acts, agent_class
from racines_envs.task.motion import VELOCITY
from racines_envs.worlds.making import WorldLike, make_core
from racines_leaderboard.submissions.confined.session import (
    ConfinedGenerator,
    ConfinedPolicyAgent,
    Limits,
)
from racines_leaderboard.submissions.document import MOVING
from racines_models.contract import (
    FEWEST,
    ContractError,
    check_declared,
    check_followed,
    check_generator,
    check_pose,
    check_same,
    check_seed,
    declared,
)
from racines_models.exchange.predictions.file import Predictions
from racines_models.provenance import sha256_bytes
from racines_models.registry import generator_class
from racines_models.sample import draw, take_sample

VIEW = "SC"
"""Whose starts are taken where nothing names a view."""
POSES, STARTS = 11, 64
"""Poses that a generator draws, and starts that a policy acts at."""
FRAMES = 64
"""Frames whose poses are shuffled."""
PLACES = {
    **dict.fromkeys(
        ("generators", "turn-generators"), (Path("models/runs"), Path("models/weights"))
    ),
    "patient-generators": (Path("models/runs/patients"), Path("models/weights/patients")),
    **dict.fromkeys(("agents", "patient-agents"), (Path("envs/runs"), Path("envs/weights"))),
}
"""Where runs of merged classes lie, from the folder that commands run in."""
SECONDS = 600
"""The longest that a new process of a merged class may take."""
WORKER = "from racines_leaderboard.submissions.probe import serve; serve()"
METADATA = "set the metadata racines.{key} to true or false"

Again = Callable[[dict[str, Tensor]], Tensor]
"""From inputs by name to what a new process makes of them."""


@dataclass
class Probed:
    """What a probe found to hold, and what it could not tell."""

    held: set[str] = field(default_factory=set)
    """Clauses."""
    untold: dict[str, str] = field(default_factory=dict)
    """Reasons, by clause or by the artefact's name."""


def matching_store(data: Path | None, document: dict[str, Any]) -> FrameStore | None:
    """Return the dataset in a folder, if it is the one that a submission names."""
    if data is None or not (data / MANIFEST).is_file():
        return None
    manifest = read_manifest(data)
    here = {manifest["digest"], manifest["recipe_digest"]}
    return open_store(data) if document["dataset"].get("digest") in here else None


def probe(
    folder: Path,
    document: dict[str, Any],
    store: FrameStore | None = None,
    limits: Limits | None = None,
    phantom: WorldLike = None,
    view: str = VIEW,
) -> Probed:
    """Try the contract on a submission's artefacts, which lie in a folder and were looked into.

    Without the `store` that it was made for, predictions are not probed, and generators at the
    starts of a task, where no frame tells whether they follow the pose. Agents act on a `phantom`,
    at the starts of their view or else of `view`. Of motions there is no contract but their file's.

    Raises:
        ContractError: a clause that is broken, after the names of submission and artefact.
        RacinesError: what an artefact's reader refuses.
    """
    found = Probed()
    for artefact in document["artefacts"] if document["track"] not in MOVING else ():
        kind, name = artefact["kind"], artefact.get("path") or artefact.get("adapter")
        path = folder / artefact.get("path", "")
        with _named(f"{document['name']}: {name}"):
            if kind == "adapter":
                _adapter(name, document, store, phantom, view, found)
            elif kind == "trace":
                found.untold[name] = "a trace is what was done, not what decides"
            elif kind not in ("generator", "predictions", "policy"):
                continue
            elif not path.is_file():
                found.untold[name] = "it lies at its URL"
            elif kind == "predictions":
                _predictions(Predictions(path, store) if store else None, name, store, found)
            elif kind == "generator":
                again = partial(_draw_confined, path, limits)
                source = ConfinedGenerator(path, limits)
                _generator(source, artefact["sha256"], METADATA, again, store, phantom, found)
            else:
                again = partial(_act_confined, path, limits)
                agent = ConfinedPolicyAgent(path, limits)
                _policy(agent, artefact["sha256"], again, phantom, view, found)
    return found


@contextmanager
def _named(where: str) -> Iterator[None]:
    try:
        yield
    except ContractError as error:
        raise error.at(where) from error


def _draw_confined(path: Path, limits: Limits | None, inputs: dict[str, Tensor]) -> Tensor:
    return ConfinedGenerator(path, limits).generate(inputs["poses"], inputs["seeds"])


def _act_confined(path: Path, limits: Limits | None, inputs: dict[str, Tensor]) -> Tensor:
    seen = {key: value for key, value in inputs.items() if key != "seeds"}
    return ConfinedPolicyAgent(path, limits).act(seen, inputs["seeds"])


def _generator(
    source: Any,
    sha256: str,
    remedy: str,
    again: Again,
    store: FrameStore | None,
    phantom: WorldLike,
    found: Probed,
) -> None:
    told = declared(source)
    check_declared(told, remedy)
    seeds = _seeds(sha256, POSES)
    rows = torch.empty(0) if store is None else store.split_indices("test")
    if store is None or len(rows) < POSES:
        poses = _starts(VIEW, sha256, POSES, "params", phantom)[0]
    else:
        place = torch.randperm(len(rows), generator=torch.Generator().manual_seed(int(seeds[0])))
        poses = store.take(rows[place[:POSES]]).parameters
    images = check_generator(source.generate, poses, seeds, told)
    check_same(images, again({"poses": poses, "seeds": seeds}), "G4")
    found.held |= {"G1", "G2", "G3", "G4", "G5", "G6", "G7"}
    if not told.conditional:
        return
    frames = None if store is None else take_sample(store, "test", FRAMES).frames
    if frames is None or len(frames.index) < FEWEST:
        found.untold["G7, shuffled"] = f"needs the dataset, and {FEWEST} test frames of it"
        return
    check_followed(draw(source, frames, 0), frames.images)


def _predictions(
    source: Predictions | None, name: str, store: FrameStore | None, found: Probed
) -> None:
    """Probe what images can tell of what drew them."""
    if source is None or store is None:
        found.untold[name] = "needs the dataset that it was drawn of"
        return
    told = declared(source)
    check_declared(told, METADATA)
    columns = pq.read_table(source.path, columns=["sample", "seed"])
    seeds = sorted(columns["seed"].unique().to_pylist())
    count = len(columns["sample"].unique())
    sample = take_sample(store, source.metadata["split"], count)
    if sample.digest != source.metadata["sample"] or not seeds:
        found.untold[name] = f"not drawn of {count} frames as the scores take them"
        return
    first, *others = (source.draw_frames(sample.frames, seed) for seed in seeds[:2])
    found.held |= {"G1", "G2"}
    found.untold |= {key: "images are no program" for key in ("G3", "G4", "G5")}
    if others:
        check_seed(first, others[0], bool(told.stochastic))
        found.held.add("G6")
    else:
        found.untold["G6"] = "images of one seed"
    if told.conditional and count >= FEWEST:
        check_followed(first, sample.frames.images)
        found.held.add("G7")
    elif not told.conditional and not told.stochastic:
        check_pose(first, first.roll(1, 0), False)
        found.held.add("G7")
    else:
        found.untold["G7"] = "few images, or other noise in each"


def _policy(
    agent: Any, sha256: str, again: Again, phantom: WorldLike, view: str, found: Probed
) -> None:
    view = getattr(agent, "view", view)
    _, seen, seeds = _starts(view, sha256, STARTS, agent.observation, phantom)
    told = getattr(agent, "interface", None) or agent.config
    temperature = getattr(told, "temperature", 0.0)
    actions = check_policy(
        agent.act, agent.logits, agent.observation, seen, seeds, temperature,
        acts(agent) == VELOCITY,
    )  # fmt: skip
    check_same_actions(actions, again(seen | {"seeds": seeds}), "A3")
    found.held |= {"A1", "A2", "A3", "A4", "A5", "A6"}


def _adapter(
    target: str,
    document: dict[str, Any],
    store: FrameStore | None,
    phantom: WorldLike,
    view: str,
    found: Probed,
) -> None:
    """Probe a merged class by a run of it, if one lies here."""
    track = document["track"]
    try:
        cls: Any = (generator_class if track == "generators" else agent_class)(target)
    except RacinesError as error:
        raise RacinesError(f"{document.get('name', target)}: {error}") from error
    folders = [place / cls.name for place in PLACES[track]]
    folder = next((each for each in folders if (each / "config.json").is_file()), None)
    if folder is None:
        found.untold[target] = f"no run of it in {' or '.join(map(str, folders))}"
        return
    try:
        opened = cls.load(folder)
    except RacinesError as error:  # of this machine, not of the submission
        found.untold[target] = str(error)
        return
    again = partial(_in_new_process, track, target, folder)
    sha256 = sha256_bytes(target.encode())
    if track == "generators":
        _generator(opened, sha256, "give its card {key}", again, store, phantom, found)
    elif isinstance(opened, PolicyAgent):
        _policy(opened, sha256, again, phantom, view, found)
    else:
        found.untold[target] = "it is no network of what it is shown"


def _seeds(sha256: str, count: int) -> Tensor:
    return derive(torch.full((count,), int(sha256[:15], 16)), torch.arange(count))


def _starts(
    view: str, sha256: str, count: int, observation: str, phantom: WorldLike
) -> tuple[Tensor, dict[str, Tensor], Tensor]:
    """Return parameters, what is seen, and seeds, at starts that the hash draws."""
    how: dict[str, Any] = {"observation": observation, "reward": "oracle", "phantom": phantom}
    try:
        core = make_core(view, count, **how)
    except RacinesError:  # a view of another organ: what it is shown has the same form everywhere
        if phantom is not None:
            raise
        core = make_core(VIEW, count, **how)
    seen = core.reset(_seeds(sha256, count))
    return core.parameters, seen, core.decision_seeds()


def _in_new_process(track: str, target: str, folder: Path, inputs: dict[str, Tensor]) -> Tensor:
    """Return what a merged class makes of inputs in a process of its own."""
    words = [sys.executable, "-c", WORKER, track, target, str(folder), str(torch.get_num_threads())]
    seen = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    given = save({key: value.contiguous() for key, value in inputs.items()})
    try:
        done = subprocess.run(words, input=given, capture_output=True, env=seen, timeout=SECONDS)
    except subprocess.TimeoutExpired as error:
        raise RacinesError(f"{target}: took more than {SECONDS} s in a new process") from error
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise RacinesError(f"{target}: fails in a new process: {' '.join(last)[:500]}")
    return load(done.stdout)["made"]


def serve() -> None:
    """Answer one `_in_new_process`: tensors in on stdin, one out on stdout."""
    track, target, folder, threads = sys.argv[1:]
    torch.set_num_threads(int(threads))
    out = os.dup(1)
    os.dup2(2, 1)  # what libraries print is no answer
    inputs = load(sys.stdin.buffer.read())
    seeds = inputs.pop("seeds")
    if track == "generators":
        made = generator_class(target).load(Path(folder)).generate(inputs["poses"], seeds)
    else:
        made = agent_class(target).load(Path(folder)).act(inputs, seeds)
    with os.fdopen(out, "wb") as stream:
        stream.write(save({"made": made.contiguous()}))
