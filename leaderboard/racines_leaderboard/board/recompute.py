"""Scores recomputed from a submission's artefacts, by the code of this checkout."""

import dataclasses
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_data.manifest import added_configs, config_manifest, read_manifest
from racines_data.patients.splits import split_of
from racines_data.store.asked import AskedStore, asked_digest
from racines_data.store.frames import FrameStore, open_store
from racines_envs.agents.trace import TraceAgent
from racines_envs.cli.settings import phantom_config
from racines_envs.evaluation.patients import PatientsConfig, StartSet, evaluate_patients
from racines_envs.evaluation.run import EvaluationConfig, evaluate
from racines_envs.worlds.making import find_task, make_phantom, patients_recipe, phantom_recipe
from racines_leaderboard.board.collect import Record, record_of, write_records
from racines_leaderboard.records.motions import MOVING
from racines_leaderboard.records.schema import check
from racines_leaderboard.records.tracks import (
    HELD_OUT,
    PATIENT_AGENTS,
    PATIENT_GENERATORS,
    TRACK,
    TRACKS,
)
from racines_leaderboard.submissions.confined import session as confined
from racines_leaderboard.submissions.confined.session import Limits
from racines_leaderboard.submissions.document import YAML, files_of, find_submission, rescored
from racines_leaderboard.submissions.intake import check_content
from racines_leaderboard.submissions.probe import probe
from racines_models.exchange.predictions.file import Predictions
from racines_models.judges.grader.model import Grader
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.scores.features import InceptionFeatures
from racines_models.scores.on_patients import Judges, PatientScoresConfig, score_on_patients
from racines_models.scores.scoring import Scores, ScoresConfig, score
from racines_models.statistics import Evidence
from racines_models.trackerless.scoring import MotionScoresConfig, asked, score_motion
from racines_models.trackerless.submission import read_submission as read_motions
from racines_models.trackerless.sweeps import SweepSet


@dataclass(frozen=True)
class Ground:
    """What scores are made on and with: one board's."""

    board: str
    settings: dict[str, Any]
    """Those of its params file."""
    data: Path = Path("data/racines")
    grader: Path | None = Path("models/runs/grader")
    """None: leave out what needs a grader."""
    pose: Path | None = None
    """Of a pose regressor; None: leave out what needs one."""
    cache: Path | None = None
    """Keeps what is computed of the reference alone."""
    limits: Limits = field(default_factory=Limits)
    kept: list[Evidence] | None = None
    """Takes what the scores rest on, where it is wanted."""

    def keep(self, made: Any) -> None:
        """Keep the evidence of scores that were made, if they have any."""
        evidence = getattr(made, "evidence", None)
        if self.kept is not None and evidence is not None:
            self.kept.append(evidence)


def find(submissions: Path, name: str) -> Path:
    """Return the folder of a submission by NAME, if one track alone has it, or TRACK/NAME."""
    names = {track.name: name.removeprefix(f"{track.name}/") for track in TRACKS}
    folders = [submissions / track / bare for track, bare in names.items() if "/" not in bare]
    found = [folder for folder in folders if (folder / YAML).is_file()]
    if len(found) != 1:
        where = f"on several tracks in {submissions}: give TRACK/NAME"
        raise RacinesError(f"{name!r}: {where if found else f'no submission in {submissions}'}")
    return found[0]


def recompute(folder: Path, ground: Ground, results: Path, force: bool = False) -> Record:
    """Score the artefact in `<submissions>/<track>/<name>`; write a record of tier `recomputed`.

    Graphs run in a confined child; no code of the submitter's runs. The contract is tried first.
    Timings are left out: they would be those of the confinement.

    Raises:
        RacinesError: a submission at fault or without an artefact that can be scored, one made for
            other data, a file that breaks the contract or a limit, metrics that do not belong on
            the board, or, without `force`, a record of another result in its place.
    """
    kept: list[Evidence] = []
    document, scores = recompute_scores(folder, dataclasses.replace(ground, kept=kept), True)
    track, board = TRACK[document["track"]], ground.board
    path = results / board / track.name / f"{document['name']}.json"
    try:
        # As it will be read: with lists where there are tuples.
        scores = json.loads(json.dumps(scores, allow_nan=False))
    except ValueError as error:
        raise RacinesError(f"{path}: a figure is not finite: {error}") from error
    tables = {}
    for evidence in kept:
        scores["evidence"], tables[path] = _written(evidence, document["name"])
    record = record_of(board, track, document["name"], "recomputed", document, scores)
    check(record, "record", str(path))
    check(record["scores"], track.schema, f"{path}: scores")
    write_records({path: record}, results, folder.parents[1], board, force, tables)
    return record


def _written(evidence: Evidence, name: str) -> tuple[dict[str, Any], bytes]:
    """Return what scores say of their evidence, and the content of its file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.parquet")
        return evidence.write(path), path.read_bytes()


def recompute_scores(
    folder: Path, ground: Ground, probing: bool = False
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a submission's document, and the scores of its artefact; nothing is written.

    With `probing` the contract is tried on it first; an audit holds the numbers alone to account.
    """
    document, artefacts = rescorable(folder, ground)
    if probing:
        _try_contract(folder, document, ground)
    paths = [folder / artefact["path"] for artefact in artefacts]
    makers = dict.fromkeys(HELD_OUT, _generator_scores) | {
        PATIENT_GENERATORS.name: _scores_of_adapting,
        **dict.fromkeys(MOVING, _motion_scores),
    }
    make = makers.get(document["track"], agent_scores)
    scores = make(document, artefacts[0]["kind"], paths, ground)
    return document, scores | {"weights": {each["path"]: each["sha256"] for each in artefacts}}


def rescorable(folder: Path, ground: Ground) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return a submission's document and the artefacts that scores are made of, looked into.

    Raises:
        RacinesError: no submission, one at fault, or nothing there that can be scored again.
    """
    document = find_submission(folder.parents[1], folder.parent.name, folder.name)
    if document is None:
        raise RacinesError(f"{folder}: no submission there")
    artefacts = rescored(document)
    if not artefacts:
        raise RacinesError(f"{folder}: no artefact that can be scored again: see docs/submit.md")
    for artefact in files_of(document):
        path = folder / artefact["path"]
        if path.exists():
            check_content(path, artefact["kind"], document["track"], ground.limits)
        elif artefact in artefacts:
            raise RacinesError(f"{path}: lies at its URL: take it in with racines submit --fetch")
    return document, artefacts


def _try_contract(folder: Path, document: dict[str, Any], ground: Ground) -> None:
    """Try the contract on a board's own data, or at the starts of its own view."""
    if document["track"] in HELD_OUT:
        store = open_store(ground.data)
        _check_data(document, store.manifest, str(ground.data))
        probe(folder, document, store, ground.limits)
        return
    if document["track"] == PATIENT_GENERATORS.name:
        asked = _asked(document, ground)
        probe(folder, document, asked, ground.limits)
        return
    if document["track"] in MOVING:
        return  # its file was looked into
    if document["track"] == PATIENT_AGENTS.name:
        probe(folder, document, limits=ground.limits, view=on_patients(ground).view)
        return
    view = fill(EvaluationConfig, section(ground.settings, "evaluation"), "evaluation").view
    phantom = phantom_config(ground.settings)
    world = make_phantom(phantom, "cpu", find_task(view, phantom).anatomy)
    probe(folder, document, limits=ground.limits, phantom=world, view=view)


def on_patients(ground: Ground) -> PatientsConfig:
    """Return how a ground evaluates agents on patients."""
    settings = section(ground.settings, "evaluation_patients")
    return fill(PatientsConfig, settings, "evaluation_patients")


def _check_data(document: dict[str, Any], here: dict[str, Any], where: str) -> None:
    """Check that a submission was made for the data that it is to be scored on."""
    named = document["dataset"]
    digests = {here.get("digest"), here.get("recipe_digest")}
    if named["digest"] not in digests:
        shown = " or ".join(sorted(str(digest) for digest in digests if digest))
        raise RacinesError(
            f"{document['name']}: dataset.digest: {named['digest']}; {where} has {shown}: score it "
            "on the data that it names"
        )


def _generator_scores(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground
) -> dict[str, Any]:
    store = open_store(ground.data)
    if store.turns is not None:
        # Of turns nothing is labelled, and where the heart lies is not known.
        ground = dataclasses.replace(ground, grader=None, pose=None)
    config = fill(ScoresConfig, section(ground.settings, "scores"), "scores")
    opened = open_sources(document, kind, paths, ground, store, config.split)
    scores = score_on(ground, store, config, opened, document["name"])
    scores["dataset"]["board"] = ground.board
    return scores


def _asked(document: dict[str, Any], ground: Ground) -> AskedStore:
    """Return what a ground asks of patients, for which a submission has to be made."""
    config = _on_scouts(ground)
    recipe = asked_digest(config.split, config.patients, config.seed)
    told = {"digest": recipe, "recipe_digest": recipe}
    _check_data(document, told, f"what board {ground.board} asks of patients")
    return AskedStore(config.split, config.patients, config.seed, ground.cache)


def _on_scouts(ground: Ground) -> PatientScoresConfig:
    settings = section(ground.settings, "patient_scores")
    return fill(PatientScoresConfig, settings, "patient_scores")


def _scores_of_adapting(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground
) -> dict[str, Any]:
    """Return the scores of images that were drawn of patients, one file a training."""
    config, asked = _on_scouts(ground), _asked(document, ground)
    sources = [Predictions(path, asked, config.split) for path in paths]
    judges = Judges(
        PoseRegressor.load(config.pose, "cpu"),
        SegmentationJudge.load(config.segmentation, "cpu"),
        InceptionFeatures("cpu"),
    )
    made = score_on_patients(sources, asked, config, document["name"], judges)
    ground.keep(made)
    made.content["dataset"]["board"] = ground.board
    return made.content


def _motion_scores(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground
) -> dict[str, Any]:
    """Return the scores of motions in files, one a training, on a ground's sweeps."""
    sweeps = SweepSet(_named_config(document, ground.data))
    config = fill(MotionScoresConfig, section(ground.settings, "motion_scores"), "motion_scores")
    found, motions = asked(sweeps, config), []
    # Another machine may have drawn a few pixels otherwise; the sweeps and their poses are these.
    by_recipe = document["dataset"]["digest"] == sweeps.card["recipe_digest"]
    for path in paths:
        given = read_motions(path)
        given.check(path, found, given.dataset if by_recipe else sweeps.store.digest, config.split)
        motions.append(dict(given.motions))
    # A file does not say that nothing was learned, so a place takes the trainings of any method.
    made = score_motion(document["name"], motions, sweeps, config, {"trained": True})
    ground.keep(made)
    return made.content


def _named_config(document: dict[str, Any], data: Path) -> FrameStore:
    """Return the config of a dataset whose content or recipe digest a submission names."""
    manifest = read_manifest(data)
    for config in ("frames", *added_configs(manifest)):
        own = config_manifest(manifest, config)
        if document["dataset"]["digest"] in (own["digest"], own["recipe_digest"]):
            return open_store(data, config)
    raise RacinesError(
        f"{document['name']}: dataset.digest: {document['dataset']['digest']}; no config of {data} "
        "has it: score it on the data that it names"
    )


def open_sources(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground, store: FrameStore,
    split: str,
) -> list[Any]:  # fmt: skip
    """Return what draws a submission's images, one for each of its trainings, confined.

    Raises:
        RacinesError: it was made for other data, or a judge that is asked for is not here.
    """
    _check_data(document, store.manifest, str(ground.data))
    if ground.grader is not None and not ground.grader.is_dir():
        raise RacinesError(
            f"{ground.grader}: no grader; run: racines train grader, or name one in the settings "
            "(scores.grader; models/weights/grader is the published one)"
        )
    return [
        Predictions(path, store, split)
        if kind == "predictions"
        else confined.ConfinedGenerator(path, ground.limits)
        for path in paths
    ]


def score_on(
    ground: Ground, store: FrameStore, config: ScoresConfig, sources: Sequence[Any], name: str,
    seeds: Sequence[int] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the scores of generators by a ground's judges, without their speed.

    They draw with `seeds`, or else with those of the config.
    """
    return scored_on(ground, store, config, sources, name, seeds).content


def scored_on(
    ground: Ground, store: FrameStore, config: ScoresConfig, sources: Sequence[Any], name: str,
    seeds: Sequence[int] | None = None,
) -> Scores:  # fmt: skip
    """Return the same with what the scores rest on."""
    made = score(
        sources,
        store,
        dataclasses.replace(config, speed=False),
        name,
        grader=None if ground.grader is None else Grader.load(ground.grader, "cpu"),
        pose=None if ground.pose is None else PoseRegressor.load(ground.pose, "cpu"),
        seeds=seeds,
        cache=ground.cache,
    )
    ground.keep(made)
    return made


def agent_scores(
    document: dict[str, Any], kind: str, paths: Sequence[Path], ground: Ground,
    sets: tuple[int, ...] | StartSet | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the scores of a submission's policy or trace from a ground's start sets, or others.

    Others are named by their seeds or, on patients, whole.

    Raises:
        RacinesError: it was made for another phantom, or a trace for other starts.
    """
    path = paths[0]
    opened = [TraceAgent(path)] if kind == "trace" else _policies(paths, ground)
    if document["track"] == PATIENT_AGENTS.name:
        assert sets is None or isinstance(sets, StartSet)
        return _scores_on_patients(document, opened, paths[0], ground, sets)
    assert not isinstance(sets, StartSet)
    agent, *further = opened
    config = fill(EvaluationConfig, section(ground.settings, "evaluation"), "evaluation")
    judge = str(ground.grader) if ground.grader is not None and config.grader else ""
    view = getattr(agent, "view", config.view)
    config = dataclasses.replace(config, view=view, grader=judge, latency=0, device="cpu")
    if sets is not None:
        config = dataclasses.replace(config, seed=None, seeds=sets)
    phantom = phantom_config(ground.settings)
    phantom = make_phantom(phantom, "cpu", find_task(view, phantom).anatomy)
    _check_data(document, phantom_recipe(phantom) or {}, f"the phantom of board {ground.board}")
    made = evaluate("", path.parent, config, phantom, agent=agent, further=further)
    ground.keep(made)
    return made.scores | _named(document)


def _scores_on_patients(
    document: dict[str, Any], opened: list[Any], path: Path, ground: Ground,
    starts: StartSet | None,
) -> dict[str, Any]:  # fmt: skip
    """Return the scores of who acts, from the starts of its task on patients or from others."""
    agent, *further = opened
    config = dataclasses.replace(on_patients(ground), device="cpu")
    config = dataclasses.replace(config, view=getattr(agent, "view", config.view))
    if config.task.tier != ground.board:
        raise RacinesError(
            f"{path}: is for {config.view}, and board {ground.board} for tasks of that tier: "
            f"--board {config.task.tier}"
        )
    if starts is not None:
        config = dataclasses.replace(config, split=split_of(starts.patients[0]))
    _check_data(document, patients_recipe(config.task.tier), f"the world of board {ground.board}")
    given: dict[str, Any] = {"agent": agent, "board": ground.board, "starts": starts}
    given["further"] = further
    made = evaluate_patients("", path.parent, config, **given)
    ground.keep(made)
    return made.scores | _named(document)


def _policies(paths: Sequence[Path], ground: Ground) -> list[Any]:
    """Return the policies of a submission, the trainings of one method, each confined."""
    return [confined.ConfinedPolicyAgent(path, ground.limits) for path in paths]


def _named(document: dict[str, Any]) -> dict[str, Any]:
    """Return what scores of an agent take from its submission: its name, and several's seeds."""
    seeds = [{"seed": each, "published": False} for each in document["seeds"]]
    several = sum(each["kind"] == "policy" for each in document["artefacts"])
    told = {"trainings": seeds} if len(seeds) == several > 1 else {}
    return {"agent": document["name"]} | told
