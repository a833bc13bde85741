"""Claims on what was scored: artefacts, weights of runs, published copies; what they are of."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.agents.trace import read_trace
from racines_envs.evaluation.patients import run_name
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, tell, told, unknown
from racines_leaderboard.board.collect import Record, basis_of
from racines_leaderboard.board.trained import read_told, training_of
from racines_leaderboard.records.motions import MOTION, MOVING
from racines_leaderboard.records.tracks import HELD_OUT, PATIENT_AGENTS, PATIENT_GENERATORS
from racines_leaderboard.submissions.document import files_of, rescored
from racines_models.exchange.predictions.file import Predictions, metadata_of
from racines_models.provenance import weights_sha256
from racines_models.registry import PATIENTS
from racines_models.training.checkpoint import PREFIX

OF_SEED = re.compile(rf"{PREFIX}\d+/")
"""Of the name of a file of a further training."""


def named(record: Record) -> dict[str, str]:
    """Return the sha256 of each file of weights that a record names."""
    weights = record["scores"]["weights"] or {}
    return dict(weights.get("files", weights))


def first_training(weights: dict[str, str]) -> dict[str, str]:
    """Return of the weights of several trainings those of the first, which has no folder."""
    return {name: sha256 for name, sha256 in weights.items() if "/" not in name}


def submitted(record: Record) -> bool:
    """Return whether a record's scores are made of artefacts that lie in its submission."""
    document = record["submission"] or {}
    return document.get("schema") == "racines.submission/2" and bool(rescored(document))


def submission_of(record: Record, bench: Bench) -> Path:
    """Return the folder of a record's submission."""
    return bench.places.submissions / record["track"] / record["name"]


def run_called(record: Record) -> str:
    """Return the name of a merged system's run: the record's own, or, on patients, a part of it."""
    return _run_names(record)[-1]


def _run_names(record: Record) -> list[str]:
    """Return what a merged system's run may be called: an agent may learn each view apart."""
    name = record["name"]
    if record["track"] != PATIENT_AGENTS.name:
        return [name]
    return [name, run_name(name, record["scores"]["task"]["view"])]


def run_of(record: Record, bench: Bench) -> Path:
    """Return the folder of a merged system's run: here, or published, whichever has its weights.

    Published are the trainings of a board, `weights/<board>/<name>`, and those of the reference
    board, `weights/<name>`. Where no folder has all, one that has the first training will do.
    """
    places, name = bench.places, record["name"]
    if record["track"] == PATIENT_GENERATORS.name:  # of one heart too, which ignore the patient
        folders = [each / PATIENTS / name for each in (places.runs, places.weights)]
        folders += [places.weights / name]
    elif record["track"] in MOVING:
        folders = [each / MOTION.name / name for each in (places.runs, places.weights)]
    elif record["track"] in HELD_OUT:
        kept = places.weights
        folders = [places.runs / name, kept / bench.board / name, kept / name]
    else:
        kept = (places.agents, places.policies / bench.board, places.policies)
        folders = [folder / name for name in _run_names(record) for folder in kept]
    claimed = named(record)
    for wanted in (claimed, first_training(claimed)):
        if found := next((each for each in folders if wanted and has_weights(each, wanted)), None):
            return found
    return folders[0].with_name(run_called(record))


def hours_of(record: Record, bench: Bench) -> float | None:
    """Return the hours of a training: by its submission, or else what the first one here took."""
    stated = ((record["submission"] or {}).get("training") or {}).get("hours")
    if stated is not None:
        return stated
    return training_of(run_of(record, bench)).get("hours")


def has_weights(folder: Path, claimed: dict[str, str]) -> bool:
    """Return whether a folder has all files of some names, each of its sha256."""
    files = [(folder / name, sha256) for name, sha256 in claimed.items()]
    return all(path.is_file() and sha256_file(path) == sha256 for path, sha256 in files)


def check_weights(record: Record, bench: Bench) -> Iterator[Verdict]:
    """Check every file that a record names: an artefact, or weights of merged code."""
    claimed = named(record)
    if not claimed:
        run = run_of(record, bench)
        here = weights_sha256(run) if run.is_dir() else {}
        if here:
            yield fails("weights", f"it names none, and {run} has some", None, sorted(here))
        else:
            yield holds("weights", "it names none: it learns nothing")
    if "files" in (stated := record["scores"]["weights"] or {}):
        first = first_training(claimed)
        only = next(iter(first.values())) if len(first) == 1 else None
        stands = first.get("policy.safetensors", only)
        yield equal("weights.sha256", stated.get("sha256"), stands, "the file that stands for all")
    if submitted(record):
        files = sorted(each["path"] for each in rescored(record["submission"]))
        yield equal("weights", sorted(claimed), files, "the artefacts that were scored")
    elif claimed and (runs := record["scores"].get("runs", 1)) > 1:
        trainings = {m[0] if (m := OF_SEED.match(name)) else "" for name in claimed}
        yield equal("weights.trainings", len(trainings), runs, "the trainings that were scored")
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
        (entry,) = (each for each in files_of(record["submission"]) if each["path"] == name)
        place = f"submission.artefacts.{name}.size"
        yield equal(place, entry["size"], path.stat().st_size, f"the file {path}")


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
        # Of further trainings it is told elsewhere whether they can be made again.
        say = told if "/" in name else unknown
        yield say(subject, f"no {path} with these weights", sha256)
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
        # A copy that does not say what it was made of could be of any weights.
        yield (unknown if made_of is None else holds)(subject, reason, sha256, made_of)


def published(record: Record, bench: Bench) -> dict[str, Any] | None:
    """Return what is said of the half-precision files of a record's weights, if they lie here."""
    described = bench.places.weights / record["name"] / "config.json"
    there = described.is_file() and record["track"] in HELD_OUT
    if not there or data_of(described.parent) != basis_of(record):
        return None
    return json.loads(described.read_text(encoding="utf-8")).get("weights_files", {}).get("files")


def data_of(folder: Path) -> str | None:
    """Return the recipe digest of what the weights in a folder were trained on, if it is told."""
    content = read_told(folder / "config.json")
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
    dataset = record["scores"]["dataset"]
    if record["track"] == PATIENT_GENERATORS.name:
        metadata, reason = metadata_of(path), "drawn of the patients that the record names"
        for key, told in (("dataset", "digest"), ("split", "split"), ("sample", "sample")):
            yield equal(f"{subject}.{key}", dataset.get(told), metadata[key], reason)
        return
    store = bench.data_for(record)
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
