"""The weights that a record names against the files here, byte for byte."""

import json
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, unknown
from racines_leaderboard.board.collect import Record, basis_of
from racines_leaderboard.submissions.artefacts import files_of, rescored


def named(record: Record) -> dict[str, str]:
    """Return the sha256 of each file of weights that a record names."""
    weights = record["scores"]["weights"] or {}
    return dict(weights.get("files", weights))


def submitted(record: Record) -> bool:
    """Return whether a record's scores are made of artefacts that lie in its submission."""
    document = record["submission"] or {}
    return document.get("schema") == "racines.submission/2" and bool(rescored(document))


def run_of(record: Record, bench: Bench) -> Path:
    """Return the folder of a merged system's weights: its run's, or of an agent the published one.

    The published one counts where it alone holds the files that the record names.
    """
    if record["track"] == "generators":
        return bench.places.runs / record["name"]
    run, kept = (place / record["name"] for place in (bench.places.agents, bench.places.policies))
    claimed = named(record)
    return kept if claimed and not _holds(run, claimed) and _holds(kept, claimed) else run


def _holds(folder: Path, claimed: dict[str, str]) -> bool:
    files = [(folder / name, sha256) for name, sha256 in claimed.items()]
    return all(path.is_file() and sha256_file(path) == sha256 for path, sha256 in files)


def check_weights(record: Record, bench: Bench) -> list[Verdict]:
    """Check every file that a record names: an artefact, or weights of merged code."""
    claimed = named(record)
    if not claimed:
        return [holds("weights", "it names none: it learns nothing")]
    if submitted(record):
        return _artefacts(record, claimed, bench)
    return [
        verdict
        for name, sha256 in claimed.items()
        for verdict in _file(record, name, sha256, bench)
    ]


def _artefacts(record: Record, claimed: dict[str, str], bench: Bench) -> list[Verdict]:
    folder = bench.places.submissions / record["track"] / record["name"]
    handed_in = {file["path"]: file["sha256"] for file in files_of(record["submission"])}
    verdicts = []
    for name, sha256 in claimed.items():
        subject, path = f"weights.{name}", folder / name
        if handed_in.get(name) != sha256:
            reason = "another than the submission in the record says"
            verdicts.append(fails(subject, reason, sha256, handed_in.get(name)))
        elif path.is_symlink() or not path.is_file():
            verdicts.append(unknown(subject, f"{path} is not here", sha256))
        else:
            verdicts.append(equal(subject, sha256, sha256_file(path), f"the file {path}"))
    return verdicts


def _file(record: Record, name: str, sha256: str, bench: Bench) -> list[Verdict]:
    subject = f"weights.{name}"
    path = run_of(record, bench) / name
    if path.is_file():
        here = sha256_file(path)
        if here == sha256:
            return [holds(subject, f"the file {path}", sha256, here)]
        if _data_of(path.parent) in (None, basis_of(record)):
            return [fails(subject, f"the file {path}, trained on these data", sha256, here)]
    copied = published(record, bench)
    if copied is None or name not in copied:
        return [unknown(subject, f"no {path} with these weights", sha256)]
    return _published(subject, sha256, copied[name], bench.places.weights / record["name"] / name)


def published(record: Record, bench: Bench) -> dict[str, Any] | None:
    """Return what is said of the half-precision files of a record's weights, if they lie here."""
    described = bench.places.weights / record["name"] / "config.json"
    if not described.is_file() or record["track"] != "generators":
        return None
    content = json.loads(described.read_text())
    data = content.get("data") or content.get("dataset") or {}
    if data.get("recipe_digest") != basis_of(record):
        return None
    return content.get("weights_files", {}).get("files")


def _published(subject: str, sha256: str, copied: dict[str, Any], path: Path) -> list[Verdict]:
    copy = f"{subject}.half_precision"
    if not path.is_file():
        return [fails(copy, f"{path} is missing", copied["sha256"])]
    verdicts = [equal(copy, copied["sha256"], sha256_file(path), f"the file {path}")]
    made_of = copied.get("made_of")
    if made_of != sha256 and made_of is not None:
        return [*verdicts, fails(subject, f"{path} was made of other weights", sha256, made_of)]
    reason = f"only their half-precision copy is here, {path}; its scores are held to theirs"
    return [*verdicts, unknown(subject, reason, sha256, made_of)]


def _data_of(folder: Path) -> str | None:
    try:
        content = json.loads((folder / "config.json").read_text())
    except (OSError, ValueError):
        return None
    data = content.get("data") or content.get("dataset") or content.get("environment") or {}
    return (data.get("phantom") or data).get("recipe_digest")


def check_content(record: Record, bench: Bench) -> list[Verdict]:
    """Check what an artefact says that it was made for: data and frames, or starts and task."""
    if not submitted(record):
        return []
    folder, verdicts = bench.places.submissions / record["track"] / record["name"], []
    for artefact in rescored(record["submission"]):
        path, subject = folder / artefact["path"], f"artefacts.{artefact['path']}"
        try:
            if artefact["kind"] == "predictions":
                verdicts += _predictions(subject, path, record, bench)
            elif artefact["kind"] == "trace":
                verdicts += _trace(subject, path, record)
        except RacinesError as error:
            verdicts.append(fails(subject, str(error)))
    return verdicts


def _predictions(subject: str, path: Path, record: Record, bench: Bench) -> list[Verdict]:
    from racines_models.exchange.predictions.reader import Predictions

    dataset = record["scores"]["dataset"]
    store = bench.data_for(dataset["recipe_digest"])
    if store is None:
        return [unknown(f"{subject}.dataset", f"no dataset of its recipe in {bench.places.data}")]
    metadata = Predictions(path, store, dataset["split"]).metadata
    reason = "drawn of the frames that the record names"
    return [equal(f"{subject}.sample", dataset.get("sample"), metadata["sample"], reason)]


def _trace(subject: str, path: Path, record: Record) -> list[Verdict]:
    from racines_envs.agents.trace import read_trace

    recorded, task = read_trace(path).told, record["scores"]["task"]
    reason = "recorded on what the record names"
    return [
        equal(f"{subject}.{key}", task[key], recorded[key], reason)
        for key in ("start_set", "backend", "reward")
    ]
