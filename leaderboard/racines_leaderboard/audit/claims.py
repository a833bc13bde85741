"""Claims on what scores rest on: seal, names, code, machine; data, judges, task, seeds."""

import functools
import importlib
import json
import re
import subprocess
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from packaging.version import InvalidVersion, Version

from racines_data.digest import recipe_digest as digest_of
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.agents import agent_class
from racines_envs.cli.settings import phantom_config
from racines_envs.evaluation.patients import start_set
from racines_envs.worlds.making import find_task, patients_recipe, phantom_recipe
from racines_leaderboard.audit.bench import JUDGES, KINDS, Bench
from racines_leaderboard.audit.verdicts import (
    UNKNOWN,
    Verdict,
    equal,
    fails,
    holds,
    tell,
    told,
    unknown,
)
from racines_leaderboard.audit.weights import data_of, submitted
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.motions import MOVING
from racines_leaderboard.records.schema import KEY, seal_of
from racines_leaderboard.records.tracks import PATIENT_AGENTS, SCOUTS, TRACK
from racines_leaderboard.submissions.document import find_submission
from racines_models.provenance import environment
from racines_models.registry import generator_class
from racines_models.scores.scoring import take_turns
from racines_models.trackerless.protocol import estimator_class

Peers = Callable[[], list[Record]]
"""Gives the other records of a track; asked only where they have a say."""
MACHINE = ("torch", "cpu", "threads", "device")
"""What floating point depends on, of an environment."""
CEILING, LIKENESS = "noise-ceiling", {"ssim": 1.0, "psnr": 100.0}
"""The truth drawn again, and what is measured frame by frame against the truth, with its most."""
JUDGED = {
    "inception": re.compile(r"fid|kid|precision|recall|density|coverage"),
    "grader": re.compile(r"(fid|kid|precision|recall|density|coverage|success)_grader"
                         r"|(view|grade)_agreement(_truth)?|grade_error(_all)?(_truth)?"),
    "pose": re.compile(r"pose_error_.+"),
    "segmentation": re.compile(r"dice(_.+)?"),
}  # fmt: skip
"""The metrics that rest on each judge."""


def check_claims(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the seal, the submission, the version and commit of the code, and the machine."""
    code = record["scores"]["code"]
    if KEY in record:
        reason = "the sha256 of the record as it was written; another one means that it was edited"
        yield equal("seal", record[KEY], seal_of(record), reason)
    else:
        yield told("seal", "the record has no seal: racines audit --seal gives one")
    yield from _names(record)
    yield _submission(record, bench)
    yield _version(code["version"], version("racines"))
    if (commit := code.get("commit")) is not None:
        yield _commit(str(commit))
    if others := differing(record["scores"]["environment"], environment()):
        reason = f"made elsewhere ({', '.join(others)} differ): numbers are held within tolerance"
        yield told("environment", reason)
    else:
        yield holds("environment", f"as here: {', '.join(MACHINE)}")
    folder = bench.places.agents if TRACK[record["track"]].steers else bench.places.runs
    kept = "motion-scores" if record["track"] in MOVING else "scores"
    path = folder / kept / f"{record['name']}.json"
    if record["tier"] == "self-reported" and path.is_file():
        yield from _scores_file(record, path, bench)


def _version(claimed: Any, here: str) -> Verdict:
    """Hold the version of the package that made a record against the one that is here.

    An earlier one is no fault: whether its numbers hold is seen where they are made again.
    """
    try:
        earlier = Version(claimed) < Version(here)
    except (InvalidVersion, TypeError):
        return fails("code.version", "it names no version", claimed, here)
    if earlier:
        reason = "an earlier version made it: the numbers are made again by the code that is here"
        return told("code.version", reason, claimed, here)
    return equal("code.version", claimed, here, "the package here")


def _names(record: Record) -> Iterator[Verdict]:
    """Check that scores say they are of this record's system and board."""
    scores, subject = record["scores"], TRACK[record["track"]].subject
    yield equal(f"scores.{subject}", scores[subject], record["name"], "the record's name")
    data, generator = scores.get("dataset") or {}, not TRACK[record["track"]].steers
    # Motion is scored by the recipe of the sweeps, whatever board they are of.
    generator = generator and record["track"] not in MOVING
    merged = TRACK[record["track"]].steers and not submitted(record)
    merged = merged or record["track"] == PATIENT_AGENTS.name
    for place, part, must in (("board", scores, merged), ("dataset.board", data, generator)):
        if must or "board" in part:
            stated = part.get("board")
            yield equal(f"scores.{place}", stated, record["board"], "the record's board")
    for name, made_for in ((document := record["submission"]) or {}).get("dataset", {}).items():
        data = scores.get("dataset") or {"source": "phantom"} | (scores.get("phantom") or {})
        ours = [data.get(name)] + [data.get("recipe_digest")] * (name == "digest")
        # Scouts are drawn of the phantom's patients: a submission may name either.
        ours += ["phantom"] * (name == "source" and data.get("source") == SCOUTS)
        place = f"submission.dataset.{name}"
        yield tell(made_for in ours, place, "what it was scored on", made_for, data.get(name))
    for artefact in (document or {}).get("artefacts", []):
        if "adapter" in artefact:
            yield _adapter(record, artefact["adapter"])


def _adapter(record: Record, adapter: str) -> Verdict:
    """Check that the class which a submission names is the one that is scored here."""
    agents = TRACK[record["track"]].steers
    name = record["scores"].get("submission", record["name"])
    find = estimator_class if record["track"] in MOVING else generator_class
    try:
        one, other = (agent_class if agents else find)(name), _loaded(adapter)
    except RacinesError as error:
        return unknown("submission.adapter", f"not here: {error}", adapter)
    except (ImportError, AttributeError) as error:
        return fails("submission.adapter", f"there is no such class: {error}", adapter)
    here = f"{one.__module__}:{one.__qualname__}"
    return tell(one is other, "submission.adapter", "the class of that name here", adapter, here)


def _loaded(adapter: str) -> Any:
    module, _, name = adapter.partition(":")
    if module.split(".")[0] not in {"racines_models", "racines_envs"}:
        raise RacinesError(f"{adapter}: code of another package is not imported")
    return getattr(importlib.import_module(module), name)


def _submission(record: Record, bench: Bench) -> Verdict:
    """Hold the submission in a record against the YAML and the artefacts that lie here."""
    held = record["submission"]
    name = held["name"] if held else record["scores"].get("submission", record["name"])
    try:
        here = find_submission(bench.places.submissions, record["track"], name)
    except RacinesError as error:
        return fails("submission", str(error))
    if held is None and here is None:
        return told("submission", f"nobody submitted {name}: it has scores alone")
    if held is None or here is None:
        where = "the record holds none" if held is None else f"none in {bench.places.submissions}"
        return fails("submission", f"of {name}: {where}: collect its scores again")
    reason = "digest of the submission.yaml held in the record, and of the one here"
    if held.get("schema") != here["schema"]:
        # Earlier records hold fewer fields; those that both have must agree.
        shared = sorted(set(held) & set(here))
        held, here = ({key: document[key] for key in shared} for document in (held, here))
        reason = f"an earlier format; the fields of both agree by digest: {', '.join(shared)}"
    return equal("submission", digest_of(held), digest_of(here), reason)


@functools.cache
def _commit(commit: str) -> Verdict:
    """Say whether a commit is part of this checkout's past."""
    if not re.fullmatch(r"[0-9a-f]{7,64}", commit):
        return fails("code.commit", "it names no commit", commit)
    words = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
    try:
        done = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return told("code.commit", "no git here", commit)
    if done.returncode == 0:
        return holds("code.commit", "this checkout's own, or one before it", commit)
    other = done.returncode == 1
    reason = "a commit of another branch" if other else "no such commit in this checkout"
    return told("code.commit", reason, commit)


def differing(claimed: dict[str, Any], here: dict[str, Any]) -> list[str]:
    """Return in which of what floating point depends on two environments differ."""
    versions = [machine["python"].split(".")[:2] for machine in (claimed, here)]
    versions_differ = [] if versions[0] == versions[1] else ["python"]
    return versions_differ + [key for key in MACHINE if claimed.get(key) != here.get(key)]


def _scores_file(record: Record, path: Path, bench: Bench) -> Iterator[Verdict]:
    """Hold a record to the scores file of its run: whoever edits one has to edit both."""
    try:
        here = json.loads(path.read_text(encoding="utf-8"))
        board = here.get("board") or (here.get("dataset") or {}).get("board")
    except (ValueError, AttributeError) as error:
        yield fails("scores", f"{path}: not readable as JSON: {error}")
        return
    if board not in (None, bench.board):
        return
    if here.get("weights") != record["scores"]["weights"]:
        # As of a training here, where the record is of its half-precision copy.
        yield told("scores", f"{path} is of other weights than the record")
    else:
        reason = f"digest of the scores in the record, and of {path}"
        yield equal("scores", digest_of(record["scores"]), digest_of(here), reason)


def dataset(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check source, version, digests and sample of the dataset that a generator was scored on."""
    claimed = record["scores"]["dataset"]
    recipe = claimed["recipe_digest"]
    wanted, reason = bench.recipe_for(record)
    if wanted is None:
        reason = f"no settings of board {bench.board} here that name a recipe, nor is it pinned"
        yield unknown("dataset.recipe_digest", f"{reason}: give --params", recipe)
    else:
        yield equal("dataset.recipe_digest", recipe, wanted, reason)
    if bench.settings is None:
        yield unknown("dataset.split", bench.no_settings, claimed["split"])
    else:
        yield equal("dataset.split", claimed["split"], bench.scores.split, "scores.split")
    store = bench.data_for(record)
    if store is None:
        reason = f"no dataset of that recipe in {bench.data}"
        keys = [key for key in ("source", "version", "digest", "sample") if key in claimed]
        yield from (unknown(f"dataset.{key}", reason, claimed[key]) for key in keys)
        return
    here, reason = store.manifest, f"the manifest of {bench.data}"
    for key in ("source", "version"):
        yield equal(f"dataset.{key}", claimed[key], here[key], reason)
    built = "the same recipe, built elsewhere: a few pixels differ"
    say, reason = (holds, reason) if claimed["digest"] == here["digest"] else (told, built)
    yield say("dataset.digest", reason, claimed["digest"], here["digest"])
    if "sample" in claimed and bench.settings is None:
        yield unknown("dataset.sample", bench.no_settings, claimed["sample"])
    elif "sample" in claimed:
        reason = f"digest of the rows of {bench.scores.samples:,} frames at most"
        yield equal("dataset.sample", claimed["sample"], bench.sample.digest, reason)


def judge_of(metric: str) -> str | None:
    """Return the extractor that a metric rests on; None if it needs none, or is a plug-in's."""
    return next((one for one, keys in JUDGED.items() if keys.fullmatch(metric)), None)


def judges(record: Record, bench: Bench, peers: Peers) -> Iterator[Verdict]:
    """Check that the extractors are the benchmark's own; where they are not here, the board's."""
    named = record["scores"].get("extractors", {})
    for key, metric in record["scores"]["metrics"].items():
        judge = judge_of(key)
        if judge is not None and judge not in named and metric["value"] is not None:
            yield fails(f"extractors.{judge}", f"{key} rests on it, and the record names none")
    for kind, claimed in named.items():
        if not isinstance(claimed, dict):
            yield fails(f"extractors.{kind}", "it says nothing of itself", claimed)
            continue
        if kind == "inception":
            reason = "weights, layer, resizer and range here"
            yield equal(f"extractors.{kind}", claimed, bench.inception, reason)
            continue
        verdict = _judge(kind, claimed.get("sha256"), record, bench)
        if verdict.verdict == UNKNOWN:
            others = [peer["scores"].get("extractors", {}).get(kind) for peer in peers()]
            told = [other for other in others if other is not None]
            strangers = [other for other in told if other != claimed]
            if len(told) >= 2 and 2 * len(strangers) > len(told):
                reason, theirs = "most rows of the board were judged by another", strangers[0]
                verdict = fails(verdict.subject, reason, verdict.claimed, theirs.get("sha256"))
        yield verdict


def beyond_truth(record: Record, peers: Peers) -> Iterator[Verdict]:
    """Say of images nearer to the truth than the truth drawn again that scores alone cannot tell.

    A simulator draws the same pose twice with other noise; nobody who has not seen the frames comes
    nearer to them than that.
    """
    metrics, name = record["scores"]["metrics"], record["name"]
    if TRACK[record["track"]].steers or name == CEILING:
        return
    drawn_again = next((peer for peer in peers() if peer["name"] == CEILING), None)
    for key, most in LIKENESS.items():
        if key not in metrics:
            continue
        value, low = metrics[key]["value"], metrics[key]["low"]
        ceiling = drawn_again["scores"]["metrics"][key]["high"] if drawn_again else None
        above = None not in (ceiling, value) and (value if low is None else low) > ceiling
        if value == most or above:
            least = most if ceiling is None else ceiling
            reason = "nearer to the truth than the truth drawn again: fresh draws would tell"
            yield unknown(f"truth.{key}", reason, value, least)


def _judge(kind: str, sha256: str | None, record: Record, bench: Bench) -> Verdict:
    subject = f"extractors.{kind}"
    if kind not in KINDS:
        return fails(subject, "an extractor unknown to this code", sha256)
    judge = KINDS[kind]
    pinned = bench.pinned(record["track"], judge)
    if pinned is not None and pinned != sha256:
        return fails(subject, "the board is pinned to another", sha256, pinned)
    if folder := bench.judge(judge, sha256):
        return holds(subject, f"the weights in {folder}", sha256, sha256)
    own = (record["scores"].get("dataset") or {}).get("recipe_digest")
    for folder in bench.judge_folders(judge):
        if own is not None and data_of(folder) == own:
            here = sha256_file(folder / JUDGES[judge])
            return fails(subject, f"{folder}, trained on these data, is another", sha256, here)
    return unknown(subject, f"no {judge} with these weights here", sha256)


def drawing_seeds(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the seeds that images were drawn with against the board's settings."""
    if bench.settings is None:
        yield unknown("seeds", bench.no_settings)
        return
    claimed, runs = record["scores"]["seeds"], record["scores"].get("runs", 1)
    allowed = []
    for stochastic in (True, False):  # what draws the same whatever the seed draws once a run
        stand_in: Any = SimpleNamespace(card=SimpleNamespace(stochastic=stochastic))
        allowed.append([seed for _, seed in take_turns([stand_in] * runs, bench.scores.seeds)])
    reason = "scores.seeds of the board's settings; without noise the first alone"
    yield tell(claimed in allowed, "seeds", reason, claimed, allowed[0])


def task(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check phantom, task, reward, backend and starts of an agent's scores."""
    if bench.settings is None:
        yield unknown("task", bench.no_settings)
        return
    scores, claimed = record["scores"], record["scores"]["task"]
    if record["track"] == PATIENT_AGENTS.name:
        yield from _task_on_patients(record, bench)
        return
    config = bench.evaluation
    phantom = phantom_config(bench.settings)
    here = phantom_recipe(phantom) or {}
    for key, value in (scores.get("phantom") or {}).items():
        yield equal(f"phantom.{key}", value, here.get(key), "the phantom of the board's settings")
    try:
        defined = json.loads(json.dumps(find_task(claimed["view"], phantom).definition))
    except RacinesError as error:
        yield fails("task.view", str(error), claimed["view"])
        return
    if "definition" in claimed:
        reason = "the task as it is here"
        yield equal("task.definition", claimed["definition"], defined, reason)
    for key in ("backend", "reward"):
        reason = f"evaluation.{key} of the board's settings"
        yield equal(f"task.{key}", claimed[key], getattr(config, key), reason)
    starts = {"seeds": list(config.sets), "starts": config.starts}
    reason = "the start sets of the board's settings"
    yield equal("task.start_set", claimed["start_set"], starts, reason)
    yield equal("seeds", scores["seeds"], starts["seeds"], reason)


def _task_on_patients(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check world, task, split, reward and starts of an agent's scores on patients."""
    scores, claimed = record["scores"], record["scores"]["task"]
    config = bench.on_patients(claimed["view"])
    try:
        defined = config.task
    except RacinesError as error:
        yield fails("task.view", str(error), claimed["view"])
        return
    here = patients_recipe(defined.tier)
    for key, value in (scores.get("phantom") or {}).items():
        yield equal(f"phantom.{key}", value, here.get(key), "the world of patients here")
    reason = "the task as it is here"
    definition = json.loads(json.dumps(defined.definition))
    yield equal("task.definition", claimed.get("definition"), definition, reason)
    yield equal("task.backend", claimed["backend"], "phantom", "what draws patients")
    for key in ("split", "reward"):
        reason = f"evaluation_patients.{key} of the board's settings"
        yield equal(f"task.{key}", claimed.get(key), getattr(config, key), reason)
    starts = start_set(config).told(config)
    reason = "the start set of the board's settings, and a digest of all that decides it"
    yield equal("task.start_set", claimed["start_set"], starts, reason)
    yield equal("seeds", scores["seeds"], starts["seeds"], reason)
