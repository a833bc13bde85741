"""A submission scored in secret: at fresh poses or from fresh starts, beside public figures."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from racines_data.build.dataset import read_data_section
from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_data.patients.splits import FIRST_SECRET
from racines_data.store.frames import open_store
from racines_envs.evaluation.patients import StartSet, start_set
from racines_envs.evaluation.run import EvaluationConfig
from racines_leaderboard.board.collect import Record, read_record
from racines_leaderboard.board.recompute import (
    Ground,
    agent_scores,
    on_patients,
    open_sources,
    rescorable,
    score_on,
)
from racines_leaderboard.fresh.compare import SCANS, Remembered, Side
from racines_leaderboard.fresh.flags import SCHEMA, flags_in, place, read_secret_scores
from racines_leaderboard.fresh.frames import check_simulated, draw_frames
from racines_leaderboard.fresh.rounds import Secret, round_of
from racines_leaderboard.records.schema import KEY, check, sealed, write_record
from racines_leaderboard.records.tracks import AGENTS, GENERATORS, PATIENT_AGENTS, TRACK
from racines_models.provenance import code_version, environment
from racines_models.sample import take_sample
from racines_models.scores.scoring import ScoresConfig
from racines_models.statistics.intervals import Interval

FALLS = {"success_true": 0.1, "spl": 0.1, "final_grade": 1.0}
FALLS_ON_PATIENTS = {"success_declared": 0.1}
"""Margins of agents: a tenth of what each can be (see `compare.SHARE`)."""
MOST_PATIENTS = 2**31 - FIRST_SECRET
"""Seeds of patients among whom a round draws: evidence keeps units in 32 bits."""
MADE_BEFORE = {
    "predictions": "images are no program that could draw at other poses",
    "trace": "actions are no program that could act from other starts",
}
"""Why an artefact of a kind has no fresh draws."""
ENDS = ("value", "low", "high", "n")
PASSING = ("drawn", "revealed", "flags", "code", "environment", KEY)
"""Of a file: what differs when the same is drawn again."""


def draw_in_secret(
    folder: Path,
    ground: Ground,
    results: Path,
    secret: Secret,
    today: str,
    force: bool = False,
    progress: bool = False,
) -> dict[str, Any]:
    """Score the artefact in `<submissions>/<track>/<name>` on fresh draws; write and return a file.

    It lies beside the board's records (`flags.place`), with public and secret figures, and never
    holds the nonce or a seed. What was drawn before and comes out the same stays as it is.

    Raises:
        RacinesError: a nonce that the board did not commit to, recorded data, an artefact that is
            faulty or whose record is not there, or, without `force`, other figures in its place.
    """
    number = round_of(results, secret)
    if ground.board != secret.board:
        raise RacinesError(f"board {ground.board}: the secret is of board {secret.board}")
    document, artefacts = rescorable(folder, ground)
    kind, paths = artefacts[0]["kind"], [folder / each["path"] for each in artefacts]
    weights = {each["path"]: each["sha256"] for each in artefacts}
    record = _record_of(document, weights, results, ground.board)
    if (draws := DRAWS.get(document["track"])) is None:
        why = MADE_BEFORE.get(kind, "there is no secret world for it")
        raise RacinesError(
            f"{folder}: nothing of track {document['track']} is drawn in secret: {why}: leave out "
            "--secret"
        )
    about = {"track": document["track"], "name": document["name"], "weights": weights}
    about |= {"reason": MADE_BEFORE.get(kind)}
    about |= draws(document, kind, paths, ground, secret, record, progress)
    return write_draws(about, results, secret, number["nonce"] is not None, today, force)


def write_draws(
    about: dict[str, Any], results: Path, secret: Secret, revealed: bool, today: str, force: bool
) -> dict[str, Any]:
    """Write the file of an entry's fresh draws, and return what it holds.

    Args:
        about: track, name, weights and all that was drawn.
        results: Folder of the boards.
        secret: Whose draws they are.
        revealed: Whether its nonce is public.
        today: The date, as 2026-01-31.
        force: Let it take the place of other draws of the round.

    Raises:
        RacinesError: without `force`, other figures in its place.
    """
    content: dict[str, Any] = {
        "schema": SCHEMA, "board": secret.board, "round": secret.round,
        "commitment": secret.commitment, "drawn": today, "revealed": revealed,
    }  # fmt: skip
    content |= about
    content |= {"flags": flags_in(content), "code": code_version(), "environment": environment()}
    content = sealed(json.loads(json.dumps(content, allow_nan=False)))
    path = place(results, secret.board, secret.round, content["track"], content["name"])
    check(content, "secret-scores", str(path))
    with locked(results):
        if path.is_file() and not force:
            before = read_secret_scores(path, results)
            if _lasting(before) == _lasting(content):
                return before
            apart = [
                key for key in content if _lasting(before).get(key) != _lasting(content).get(key)
            ]
            raise RacinesError(
                f"{path}: other draws of this round are there; they differ in "
                f"{', '.join(apart)}: --force to replace them"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        write_record(path, content)
    return content


def _lasting(document: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in document.items() if key not in PASSING}


def _record_of(
    document: dict[str, Any], weights: dict[str, str], results: Path, board: str
) -> Record:
    """Return the record of a submission's own files, recomputed."""
    track = TRACK[document["track"]]
    path = results / board / track.name / f"{document['name']}.json"
    again = f"racines leaderboard --recompute {track.name}/{document['name']}"
    if not path.is_file():
        raise RacinesError(f"{path}: no record to set fresh draws beside: {again}")
    record = read_record(path, board, track)
    if record["tier"] == "self-reported" or record["scores"]["weights"] != weights:
        raise RacinesError(f"{path}: not recomputed from the files of the submission: {again}")
    return record


def _of_generator(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground, secret: Secret,
    record: Record, progress: bool,
) -> dict[str, Any]:  # fmt: skip
    """Return what a file of fresh draws says of a generator."""
    store = open_store(ground.data)
    check_simulated(store)
    config = fill(ScoresConfig, section(ground.settings, "scores"), "scores")
    sources = open_sources(document, kind, paths, ground, store, config.split)
    sample = take_sample(store, config.split, config.samples)
    public = Side.drawn(store, sample, sources, config.seeds)
    scans = range(1, 1 + SCANS)
    told: dict[str, Any] = {"basis": None, "copies": None, "margins": public.margins(scans[0])}
    told["nearer"] = {"public": _ends_of(public.nearer(scans)), "secret": None}
    figures = None
    if kind not in MADE_BEFORE:
        workers = read_data_section(section(ground.settings, "data"))[0].workers
        frames = draw_frames(store, config.split, secret, workers, progress)
        seeds = [secret.seed(f"drawing/{i}") for i in range(len(config.seeds))]
        drawn = [Remembered(source) for source in sources]
        unkept = dataclasses.replace(ground, cache=None)  # what is known of the frames is not kept
        scores = score_on(unkept, frames, config, drawn, document["name"], seeds)
        figures = scores["metrics"]
        fresh = take_sample(frames, config.split, config.samples)
        side = Side.drawn(frames, fresh, drawn, seeds)
        told["nearer"]["secret"] = _ends_of(side.nearer(scans))
        told["copies"] = _ends(side.copies(store, ground.cache))
        told["basis"] = {
            "n": len(fresh.frames.index),
            "units": len(set(fresh.trajectory.tolist())),
            "digest": frames.manifest["digest"],
        }
    return told | {"figures": _beside(GENERATORS.name, record["scores"]["metrics"], figures)}


def _of_agent(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground, secret: Secret,
    record: Record, progress: bool,
) -> dict[str, Any]:  # fmt: skip
    """Return what a file of fresh draws says of an agent."""
    config = fill(EvaluationConfig, section(ground.settings, "evaluation"), "evaluation")
    if config.backend == "replay":
        raise RacinesError(
            "evaluation.backend: replay: recorded data cannot be drawn anew: fresh draws need a "
            "simulator; leave out --secret"
        )
    told: dict[str, Any] = {"basis": None, "copies": None, "margins": FALLS}
    told["nearer"] = {"public": None, "secret": None}
    figures = None
    if kind not in MADE_BEFORE:
        sets = tuple(secret.seed(f"starts/{i}") for i in range(len(config.sets)))
        figures = agent_scores(document, kind, paths, ground, sets)["metrics"]
        count = len(sets) * config.starts
        told["basis"] = {"n": count, "units": count, "digest": None}
    return told | {"figures": _beside(AGENTS.name, record["scores"]["metrics"], figures)}


def _on_patients(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground, secret: Secret,
    record: Record, progress: bool,
) -> dict[str, Any]:  # fmt: skip
    """Return what a file of fresh draws says of an agent on patients: on others, as many."""
    starts, figures = None, None
    if kind not in MADE_BEFORE:
        starts = secret_starts(secret, start_set(on_patients(ground)))
        figures = agent_scores(document, kind, paths, ground, starts)["metrics"]
    return told_of_patients(record, starts, figures)


def told_of_patients(
    record: Record, starts: StartSet | None, figures: dict[str, Any] | None
) -> dict[str, Any]:
    """Return what a file says of figures on fresh patients, beside those of a record."""
    basis = None
    if starts is not None:
        basis = {"n": len(starts.units), "units": len(starts.patients), "digest": None}
    return {
        "basis": basis, "copies": None, "margins": FALLS_ON_PATIENTS,
        "nearer": {"public": None, "secret": None},
        "figures": _beside(PATIENT_AGENTS.name, record["scores"]["metrics"], figures),
    }  # fmt: skip


def secret_starts(secret: Secret, public: StartSet) -> StartSet:
    """Return as many starts on as many patients, of seeds that the nonce alone tells."""
    drawn: dict[int, None] = {}
    while len(drawn) < len(public.patients):
        seed = secret.seed(f"patients/{len(drawn)}") % MOST_PATIENTS
        while FIRST_SECRET + seed in drawn:
            seed = (seed + 1) % MOST_PATIENTS
        drawn[FIRST_SECRET + seed] = None
    return StartSet(tuple(drawn), public.starts, secret.seed("starts/0"))


DRAWS = {
    GENERATORS.name: _of_generator,
    AGENTS.name: _of_agent,
    PATIENT_AGENTS.name: _on_patients,
}


def _beside(
    track: str, public: dict[str, Any], secret: dict[str, Any] | None
) -> dict[str, dict[str, Any]]:
    """Return public and secret figures of a track's columns, by metric."""
    found = {}
    for name in (each.key for each in TRACK[track].columns):
        pair = public.get(name), (secret or {}).get(name)
        if any(pair):
            sides = ({key: each[key] for key in ENDS} if each else None for each in pair)
            found[name] = dict(zip(("public", "secret"), sides, strict=True))
    return found


def _ends_of(intervals: dict[str, Interval]) -> dict[str, Any]:
    return {name: _ends(each) for name, each in intervals.items()}


def _ends(interval: Interval) -> dict[str, Any]:
    return {key: getattr(interval, key) for key in ENDS}
