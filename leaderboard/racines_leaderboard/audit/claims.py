"""Claims on what scores rest on: seal, code and machine; data, judges, task, seeds; weights."""

import json
import subprocess
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from racines_data.digest import recipe_digest as digest_of
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.agents.trace import read_trace
from racines_envs.cli.settings import phantom_config
from racines_envs.worlds.making import find_task, phantom_recipe
from racines_leaderboard.audit.bench import JUDGES, KINDS, Bench
from racines_leaderboard.audit.verdicts import UNKNOWN, Verdict, equal, fails, holds, tell, unknown
from racines_leaderboard.board.collect import Record, basis_of
from racines_leaderboard.records.schema import KEY, seal_of
from racines_leaderboard.submissions.document import files_of, find_submission, rescored
from racines_models.exchange.predictions.file import Predictions
from racines_models.provenance import environment
from racines_models.scores.scoring import take_turns

MACHINE = ("torch", "cpu", "threads", "device")
"""What floating point depends on, of an environment."""


def check_claims(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check the seal, the submission, the version and commit of the code, and the machine."""
    code = record["scores"]["code"]
    if KEY in record:
        reason = "the sha256 of the record as it was written; another one means that it was edited"
        yield equal("seal", record[KEY], seal_of(record), reason)
    else:
        yield unknown("seal", "the record has no seal: racines audit --seal gives one")
    yield _submission(record, bench)
    yield equal("code.version", code["version"], version("racines"), "the package here")
    if commit := code.get("commit"):
        yield _commit(commit)
    if others := differing(record["scores"]["environment"], environment()):
        reason = f"made elsewhere ({', '.join(others)} differ): numbers are held within tolerance"
        yield unknown("environment", reason)
    else:
        yield holds("environment", f"as here: {', '.join(MACHINE)}")
    folder = bench.places.runs if record["track"] == "generators" else bench.places.agents
    path = folder / "scores" / f"{record['name']}.json"
    if record["tier"] == "self-reported" and path.is_file():
        yield from _scores_file(record, path, bench)


def _submission(record: Record, bench: Bench) -> Verdict:
    """Hold the submission in a record against the YAML and the artefacts that lie here."""
    held = record["submission"]
    name = held["name"] if held else record["scores"].get("submission", record["name"])
    try:
        here = find_submission(bench.places.submissions, record["track"], name)
    except RacinesError as error:
        return fails("submission", str(error))
    if held is None and here is None:
        return unknown("submission", f"nobody submitted {name}: it has scores alone")
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


def _commit(commit: str) -> Verdict:
    """Say whether a commit is part of this checkout's past."""
    words = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
    try:
        done = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return unknown("code.commit", "no git here", commit)
    if done.returncode == 0:
        return holds("code.commit", "this checkout's own, or one before it", commit)
    other = done.returncode == 1
    reason = "a commit of another branch" if other else "no such commit in this checkout"
    return unknown("code.commit", reason, commit)


def differing(claimed: dict[str, Any], here: dict[str, Any]) -> list[str]:
    """Return in which of what floating point depends on two environments differ."""
    versions = [machine["python"].split(".")[:2] for machine in (claimed, here)]
    versions_differ = [] if versions[0] == versions[1] else ["python"]
    return versions_differ + [key for key in MACHINE if claimed.get(key) != here.get(key)]


def _scores_file(record: Record, path: Path, bench: Bench) -> Iterator[Verdict]:
    """Hold a record to the scores file of its run: whoever edits one has to edit both."""
    try:
        here = json.loads(path.read_text())
        board = here.get("board") or (here.get("dataset") or {}).get("board")
    except (ValueError, AttributeError) as error:
        yield fails("scores", f"{path}: not readable as JSON: {error}")
        return
    if board in (None, bench.board):
        reason = f"digest of the scores in the record, and of {path}"
        yield equal("scores", digest_of(record["scores"]), digest_of(here), reason)


def dataset(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check source, version, digests and sample of the dataset that a generator was scored on."""
    claimed = record["scores"]["dataset"]
    recipe = claimed["recipe_digest"]
    if bench.recipe is None:
        reason = f"no settings of board {bench.board} here that name a recipe: give --params"
        yield unknown("dataset.recipe_digest", reason, recipe)
    else:
        reason = "the recipe that the board's settings build"
        yield equal("dataset.recipe_digest", recipe, bench.recipe, reason)
    yield equal("dataset.split", claimed["split"], bench.scores.split, "scores.split")
    store = bench.data_for(record)
    if store is None:
        reason = f"no dataset of that recipe in {bench.places.data}"
        keys = [key for key in ("source", "version", "digest", "sample") if key in claimed]
        yield from (unknown(f"dataset.{key}", reason, claimed[key]) for key in keys)
        return
    here, reason = store.manifest, f"the manifest of {bench.places.data}"
    for key in ("source", "version"):
        yield equal(f"dataset.{key}", claimed[key], here[key], reason)
    built = "the same recipe, built elsewhere: a few pixels differ"
    say, reason = (holds, reason) if claimed["digest"] == here["digest"] else (unknown, built)
    yield say("dataset.digest", reason, claimed["digest"], here["digest"])
    if "sample" in claimed:
        reason = f"digest of the rows of {bench.scores.samples:,} frames at most"
        yield equal("dataset.sample", claimed["sample"], bench.sample.digest, reason)


def judges(record: Record, bench: Bench, peers: list[Record]) -> Iterator[Verdict]:
    """Check that the extractors are the benchmark's own; where they are not here, the board's."""
    for kind, claimed in record["scores"].get("extractors", {}).items():
        if kind == "inception":
            reason = "weights, layer, resizer and range here"
            yield equal(f"extractors.{kind}", claimed, bench.inception, reason)
            continue
        verdict = _judge(kind, claimed.get("sha256"), record, bench)
        others = [peer["scores"].get("extractors", {}).get(kind) for peer in peers]
        told = [other for other in others if other is not None]
        strangers = [other for other in told if other != claimed]
        if verdict.verdict == UNKNOWN and len(told) >= 2 and 2 * len(strangers) > len(told):
            reason, theirs = "most rows of the board were judged by another", strangers[0]
            verdict = fails(verdict.subject, reason, verdict.claimed, theirs.get("sha256"))
        yield verdict


def _judge(kind: str, sha256: str | None, record: Record, bench: Bench) -> Verdict:
    subject = f"extractors.{kind}"
    if kind not in KINDS:
        return unknown(subject, "an extractor unknown to this code", sha256)
    judge = KINDS[kind]
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
    scores, claimed, config = record["scores"], record["scores"]["task"], bench.evaluation
    phantom = phantom_config(bench.settings)
    here = phantom_recipe(phantom) or {}
    for key, value in (scores.get("phantom") or {}).items():
        yield equal(f"phantom.{key}", value, here.get(key), "the phantom of the board's settings")
    try:
        defined = json.loads(json.dumps(asdict(find_task(claimed["view"], phantom))))
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


def named(record: Record) -> dict[str, str]:
    """Return the sha256 of each file of weights that a record names."""
    weights = record["scores"]["weights"] or {}
    return dict(weights.get("files", weights))


def submitted(record: Record) -> bool:
    """Return whether a record's scores are made of artefacts that lie in its submission."""
    document = record["submission"] or {}
    return document.get("schema") == "racines.submission/2" and bool(rescored(document))


def submission_of(record: Record, bench: Bench) -> Path:
    """Return the folder of a record's submission."""
    return bench.places.submissions / record["track"] / record["name"]


def run_of(record: Record, bench: Bench) -> Path:
    """Return a merged system's run, or of an agent the published one where it alone holds."""
    if record["track"] == "generators":
        return bench.places.runs / record["name"]
    run, kept = (place / record["name"] for place in (bench.places.agents, bench.places.policies))
    claimed = named(record)
    return kept if claimed and not _holds(run, claimed) and _holds(kept, claimed) else run


def _holds(folder: Path, claimed: dict[str, str]) -> bool:
    files = [(folder / name, sha256) for name, sha256 in claimed.items()]
    return all(path.is_file() and sha256_file(path) == sha256 for path, sha256 in files)


def check_weights(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check every file that a record names: an artefact, or weights of merged code."""
    claimed = named(record)
    if not claimed:
        yield holds("weights", "it names none: it learns nothing")
    check = _artefact if submitted(record) else _file
    for name, sha256 in claimed.items():
        yield from check(record, name, sha256, bench)


def _artefact(record: Record, name: str, sha256: str, bench: Bench) -> Iterator[Verdict]:
    subject, path = f"weights.{name}", submission_of(record, bench) / name
    handed_in = {file["path"]: file["sha256"] for file in files_of(record["submission"])}
    if handed_in.get(name) != sha256:
        reason = "another than the submission in the record says"
        yield fails(subject, reason, sha256, handed_in.get(name))
    elif path.is_symlink() or not path.is_file():
        yield unknown(subject, f"{path} is not here", sha256)
    else:
        yield equal(subject, sha256, sha256_file(path), f"the file {path}")


def _file(record: Record, name: str, sha256: str, bench: Bench) -> Iterator[Verdict]:
    subject, path = f"weights.{name}", run_of(record, bench) / name
    if path.is_file():
        here = sha256_file(path)
        same = here == sha256
        if same or data_of(path.parent) in (None, basis_of(record)):
            trained = "" if same else ", trained on these data"
            yield tell(same, subject, f"the file {path}{trained}", sha256, here)
            return
    copied = published(record, bench)
    if copied is None or name not in copied:
        yield unknown(subject, f"no {path} with these weights", sha256)
        return
    copy, made_of = bench.places.weights / record["name"] / name, copied[name].get("made_of")
    half, stated = f"{subject}.half_precision", copied[name]["sha256"]
    if not copy.is_file():
        yield fails(half, f"{copy} is missing", stated)
        return
    yield equal(half, stated, sha256_file(copy), f"the file {copy}")
    if made_of != sha256 and made_of is not None:
        yield fails(subject, f"{copy} was made of other weights", sha256, made_of)
    else:
        reason = f"only their half-precision copy is here, {copy}; its scores are held to theirs"
        yield unknown(subject, reason, sha256, made_of)


def published(record: Record, bench: Bench) -> dict[str, Any] | None:
    """Return what is said of the half-precision files of a record's weights, if they lie here."""
    described = bench.places.weights / record["name"] / "config.json"
    there = described.is_file() and record["track"] == "generators"
    if not there or data_of(described.parent) != basis_of(record):
        return None
    return json.loads(described.read_text()).get("weights_files", {}).get("files")


def data_of(folder: Path) -> str | None:
    """Return the recipe digest of what the weights in a folder were trained on, if it is told."""
    try:
        content = json.loads((folder / "config.json").read_text())
    except (OSError, ValueError):
        return None
    data = content.get("data") or content.get("dataset") or content.get("environment") or {}
    return (data.get("phantom") or data).get("recipe_digest")


def check_content(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check what an artefact says that it was made for: data and frames, or starts and task."""
    if not submitted(record):
        return
    for artefact in rescored(record["submission"]):
        path = submission_of(record, bench) / artefact["path"]
        check = {"predictions": _predictions, "trace": _trace}.get(artefact["kind"])
        try:
            if check is not None:
                yield from check(f"artefacts.{artefact['path']}", path, record, bench)
        except RacinesError as error:
            yield fails(f"artefacts.{artefact['path']}", str(error))


def _predictions(subject: str, path: Path, record: Record, bench: Bench) -> Iterator[Verdict]:
    dataset, store = record["scores"]["dataset"], bench.data_for(record)
    if store is None:
        yield unknown(f"{subject}.dataset", bench.no_data)
        return
    metadata = Predictions(path, store, dataset["split"]).metadata
    reason = "drawn of the frames that the record names"
    yield equal(f"{subject}.sample", dataset.get("sample"), metadata["sample"], reason)


def _trace(subject: str, path: Path, record: Record, bench: Bench) -> Iterator[Verdict]:
    recorded, task = read_trace(path).told, record["scores"]["task"]
    reason = "recorded on what the record names"
    for key in ("start_set", "backend", "reward"):
        yield equal(f"{subject}.{key}", task[key], recorded[key], reason)
