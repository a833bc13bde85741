"""How the numbers of a record are made again: from which files, by which code."""

import dataclasses
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_data.patients.splits import split_of
from racines_envs.agents import agent_class, load_agent
from racines_envs.cli.settings import phantom_config
from racines_envs.evaluation.agent_specs import find_entry
from racines_envs.evaluation.patients import StartSet, evaluate_patients
from racines_envs.evaluation.run import evaluate
from racines_envs.evaluation.trainings import find_trainings, published_run
from racines_envs.worlds.backends import make_grader
from racines_leaderboard.audit import adapting, moving
from racines_leaderboard.audit import weights as files
from racines_leaderboard.audit.bench import KINDS, Bench
from racines_leaderboard.audit.numbers import HALF
from racines_leaderboard.board.collect import Record
from racines_leaderboard.board.recompute import Ground, recompute_scores, scored_on
from racines_leaderboard.records.motions import MOVING
from racines_leaderboard.records.tracks import (
    HELD_OUT,
    PATIENT_AGENTS,
    PATIENT_GENERATORS,
    TRACK,
)
from racines_models.protocol import Run
from racines_models.provenance import weights_sha256
from racines_models.registry import (
    generator_class,
    generator_names,
    open_generator,
    open_runs,
    weights_of,
)
from racines_models.scores.scoring import ScoresConfig
from racines_models.statistics import Evidence
from racines_models.trackerless.protocol import estimator_class
from racines_models.training.checkpoint import PREFIX
from racines_models.training.published import published_seeds
from racines_models.training.sets import train_seeds

FIRST = "first training"


@dataclass(frozen=True)
class Made:
    """What came out when a record's numbers were made again."""

    scores: dict[str, Any]
    """As JSON gives them back."""
    evidence: Evidence | None = None
    """The figures of each item, where the scorer hands them on."""

    @classmethod
    def of(cls, found: Any) -> "Made":
        """Return what a scorer found: scores, alone or as `content` or `scores` of something."""
        if isinstance(found, cls):
            return found
        content = getattr(found, "content", None) or getattr(found, "scores", None) or found
        return cls(json.loads(json.dumps(content)), getattr(found, "evidence", None))

    def naming(self, weights: dict[str, str]) -> "Made":
        """Return the same with the weights that were scored."""
        return dataclasses.replace(self, scores=self.scores | {"weights": weights})


@dataclass(frozen=True)
class Road:
    """How the numbers of a record are recomputed: from which files, and how near they must come.

    artefacts       the submitted files, confined as by `racines leaderboard --recompute`
    run             the weights that the record names, in the folder of their run
    first training  likewise, of a record of several trainings of which the first alone is here
    fitted          a method that does not train: fitted again on the data
    half precision  the published copy of the weights that the record names
    no weights      an agent that learns nothing
    """

    name: str
    source: str
    """From what, in words."""
    score: Callable[[], Any]
    """Scores, or what holds them as `Made.of` takes it."""
    trainings: int | None = None
    """How many of the record's trainings are made again, the first ones; None: all."""


def find_road(record: Record, bench: Bench) -> Road | str:
    """Return the best way to recompute a record's numbers, or why there is none."""
    if lacking := bench.lacks_for(record):
        return lacking
    if files.submitted(record):
        on, folder = _ground(record, bench), files.submission_of(record, bench)
        source = f"the artefacts in {folder}"
        return Road("artefacts", source, partial(_of_artefacts, folder, on))
    if record["track"] == PATIENT_GENERATORS.name:
        return _adapting(record, bench)
    if record["track"] in MOVING:
        return _moving(record, bench)
    return (_generator if record["track"] in HELD_OUT else _agent)(record, bench)


def _of_artefacts(folder: Path, ground: Ground) -> Made:
    kept: list[Evidence] = []
    _, scores = recompute_scores(folder, dataclasses.replace(ground, kept=kept))
    return Made(json.loads(json.dumps(scores)), kept[0] if kept else None)


def _ground(record: Record, bench: Bench) -> Ground:
    """Return the board's ground with the judges that a record names, where they are here."""
    places, on_patients = bench.places, record["track"] == PATIENT_GENERATORS.name
    return Ground(
        bench.board,
        bench.settings or {},
        bench.data,
        grader=_judge(record, bench, "grader"),
        pose=_judge(record, bench, "pose"),
        # What a former run has kept of patients is not looked at: they are scanned anew.
        cache=None if on_patients else places.runs / "scores" / "reference",
        limits=places.limits,
    )


def _judge(record: Record, bench: Bench, extractor: str) -> Path | None:
    card = record["scores"].get("extractors", {}).get(extractor, {})
    sha256 = card.get("sha256") if isinstance(card, dict) else None
    return bench.judge(KINDS[extractor], sha256)


def _generator(record: Record, bench: Bench) -> Road | str:
    name, folder = called(record), files.run_of(record, bench)
    try:
        cls = generator_class(name)
    except RacinesError:
        return f"{name} is no registered generator, and has no artefact that can be scored again"
    claimed = files.named(record)
    fitted = "training" not in {each.name for each in dataclasses.fields(cls.Config)}
    # That it comes out again when it is made anew is told by making it anew.
    anew = fitted and "reproduced" in record
    further = published_seeds(bench.board, folder, bench.places.weights)
    if folder.is_dir() and weights_of(name, folder, further) == claimed and not anew:
        source = " and ".join(f"the weights in {each}" for each in (folder, *further))
        return Road("run", source, lambda: score_run(record, bench, folder, further))
    if fitted:
        source = "it does not train: fitted again on the data"
        return Road("fitted", source, lambda: score_fitted(record, bench))
    first = files.first_training(claimed)
    if first != claimed and folder.is_dir() and weights_sha256(folder) == first:
        source = f"the weights of the first training, in {folder}"
        return Road(FIRST, source, lambda: score_first(record, bench, folder), 1)
    copies, copy = files.published(record, bench) or {}, bench.places.weights / record["name"]
    if claimed and set(copies) == set(claimed):
        source = f"the half-precision copy of the weights, {copy}"
        return Road(HALF, source, lambda: score_run(record, bench, copy))
    if first and set(first) <= set(copies):
        source = f"the half-precision copy of the first training's weights, {copy}"
        return Road(HALF, source, lambda: score_first(record, bench, copy), 1)
    return f"no weights of it here: neither {folder} nor a published copy; --retrain trains anew"


def called(record: Record) -> str:
    """Return what opens a record's generator: its name or, of a bound, the class in its module."""
    name = record["name"]
    if name in generator_names() or name not in TRACK[record["track"]].bounds:
        return name
    return f"racines_models.generators.{name.replace('-', '_')}:Generator"


def _adapting(record: Record, bench: Bench) -> Road | str:
    """Return how a generator that meets patients is scored again: from its weights, if any."""
    for kind in adapting.JUDGES:
        if adapting.judge_of(kind, record, bench) is None:
            return f"the {kind} judge that it names is not here"
    folder, claimed = files.run_of(record, bench), files.named(record)
    further = published_seeds(bench.board, folder, bench.places.weights)
    again = partial(adapting.score_run, record, bench, folder, further)
    if not claimed:
        return Road("no weights", "it learns nothing", again)
    if folder.is_dir() and weights_of(record["name"], folder, further) == claimed:
        source = " and ".join(f"the weights in {each}" for each in (folder, *further))
        return Road("run", source, again)
    config = generator_class(record["name"]).Config
    if "training" not in {each.name for each in dataclasses.fields(config)}:
        source = "it does not train: fitted again on the scouts of train patients"
        return Road("fitted", source, lambda: _fitted_adapting(record, bench))
    return f"no weights of it in {folder}; --retrain trains anew"


def _fitted_adapting(record: Record, bench: Bench) -> Made:
    with tempfile.TemporaryDirectory() as aside:
        return Made.of(adapting.score_trained(record, bench, Path(aside) / record["name"]))


def _moving(record: Record, bench: Bench) -> Road | str:
    """Return how who estimates motion is scored again: from weights, if it has any."""
    name, folder = record["name"], files.run_of(record, bench)
    try:
        trained = estimator_class(name).trained
    except RacinesError:
        return f"{name} is no registered motion estimator, and handed in no file of its motions"
    claimed = files.named(record)
    again = partial(moving.score_run, record, bench, folder)
    if not trained:
        return Road("no weights", "it learns nothing", again)
    if not claimed:
        if lacking := moving.lacks_to_learn(record, bench):
            return lacking
        source = "it does not train: fitted again on the data"
        return Road("fitted", source, lambda: _fitted_motion(record, bench))
    for called, wanted, trainings in (
        ("run", claimed, None),
        (FIRST, files.first_training(claimed), 1),
    ):
        if files.has_weights(folder, wanted):
            source = f"the weights in {folder}"
            return Road(called, source, partial(again, first=trainings is not None), trainings)
    return f"no weights of it in {folder}; --retrain trains anew"


def _fitted_motion(record: Record, bench: Bench) -> Made:
    with tempfile.TemporaryDirectory() as aside:
        return Made.of(moving.score_trained(record, bench, Path(aside) / record["name"]))


def score_fitted(record: Record, bench: Bench, folder: Path | None = None) -> Made:
    """Fit a merged generator by the board's settings and return its scores.

    The run is kept in `folder` and, if it was cut short, goes on there; None keeps nothing.
    """
    assert bench.settings is not None and bench.store is not None
    store, name, cls = bench.store, record["name"], generator_class(called(record))
    settings = section(bench.settings, "generators").get(name) or {}
    config: Any = fill(cls.Config, settings, f"generators.{name}")
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    with tempfile.TemporaryDirectory() as aside:
        place = Path(aside) / name if folder is None else folder
        run = Run(place, bench.settings.get("seed", 0), "cpu", progress=False)
        train_seeds(lambda one: cls(config).fit(store, one), run, repeats)
        further = published_seeds(bench.board, place, bench.places.weights)
        return score_run(record, bench, place, further)


def score_run(record: Record, bench: Bench, folder: Path, further: Sequence[Path] = ()) -> Made:
    """Return the scores of the generator in a run's folder, by the judges that a record names.

    With its further seeds: the run's own, and those in other folders.
    """
    name = called(record)
    scores = _scored(record, bench, open_runs(name, folder, further, device="cpu"), bench.scores)
    return scores.naming(weights_of(name, folder, further))


def score_first(record: Record, bench: Bench, folder: Path) -> Made:
    """Return the scores of the first training alone, with the seeds that it drew with."""
    name, scores = called(record), record["scores"]
    seeds = tuple(scores["seeds"][:: scores.get("runs", 1)])
    config = dataclasses.replace(bench.scores, seeds=seeds)
    first = open_generator(name, folder, device="cpu")
    return _scored(record, bench, [first], config).naming(weights_sha256(folder))


def _scored(record: Record, bench: Bench, opened: Sequence[Any], config: ScoresConfig) -> Made:
    assert bench.store is not None
    ground = _ground(record, bench)
    return Made.of(scored_on(ground, bench.store, config, opened, record["name"]))


def _agent(record: Record, bench: Bench) -> Road | str:
    folder, claimed = files.run_of(record, bench), files.named(record)
    if "guide" in record["scores"].get("extractors", {}) and not _judge(record, bench, "guide"):
        return "the grader that it goes by is not here"
    if not claimed:
        return Road("no weights", "it learns nothing", lambda: score_agent(record, bench, folder))
    here = all_weights(folder, _published(record, bench)) if folder.is_dir() else {}
    alone = files.first_training(claimed)
    for name, wanted, trainings in (("run", claimed, None), (FIRST, alone, 1)):
        if here == wanted or (trainings and files.first_training(here) == wanted):
            source = f"the policy in {folder}"
            first = trainings is not None
            again = partial(score_agent, record, bench, folder, first=first)
            return Road(name, source, again, trainings)
    return f"no policy of it in {folder}; --retrain trains anew"


def all_weights(folder: Path, published: Path | None = None) -> dict[str, str]:
    """Return the sha256 of a run's weights by file name, its further trainings' by subfolder."""
    first, *further = find_trainings(folder, published)
    hashes = first.files
    for each in further:
        hashes |= {f"{PREFIX}{each.seed}/{name}": sha256 for name, sha256 in each.files.items()}
    return hashes


def _published(record: Record, bench: Bench) -> Path | None:
    if record["track"] == PATIENT_AGENTS.name:
        return None  # all trainings of such a run lie in its own folder
    return published_run(bench.board, record["name"])


def score_agent(
    record: Record, bench: Bench, folder: Path, train: bool = False, first: bool = False,
    starts: StartSet | None = None,
) -> Made:  # fmt: skip
    """Return the scores of a merged agent, its policy in a folder, by the board's settings.

    With `train`, what learns is trained there first; a run that was killed goes on. With `first`,
    the first of its trainings alone acts. The graders that had a say are those that the record
    names. On patients it acts from the board's starts, or from `starts`.
    """
    assert bench.settings is not None
    view = record["scores"]["task"]["view"]
    entry = find_entry(bench.settings, files.run_called(record))
    phantom = phantom_config(bench.settings)
    if train and files.named(record):
        cls, seed = agent_class(entry.agent), bench.settings.get("seed", 0)
        known = {each.name for each in dataclasses.fields(cls.Config)}
        # On patients an entry may be trained for each view and kind of heart.
        aim = {"view": view} if "view" in known else {}
        own: Any = fill(cls.Config, entry.settings | aim, entry.where)
        data = bench.data
        cls.train(own, folder, seed=seed, phantom=phantom, data=data, progress=False)
    judge, guide = (_judge(record, bench, kind) for kind in ("grader", "guide"))
    agent: Any = None
    if guide is not None or first:
        agent = load_agent(entry.agent, folder, "cpu")
    if guide is not None:
        agent.guide = make_grader(guide, "cpu")
    if record["track"] == PATIENT_AGENTS.name:
        on, name = dataclasses.replace(bench.on_patients(view), device="cpu"), record["name"]
        if starts is not None:
            on = dataclasses.replace(on, split=split_of(starts.patients[0]))
        return Made.of(
            evaluate_patients(entry.agent, folder, on, agent, name, bench.board, starts=starts)
        )
    settings = {"view": view, "grader": str(judge or ""), "latency": 0, "device": "cpu"}
    config = dataclasses.replace(bench.evaluation, **settings)
    published = _published(record, bench)
    return Made.of(
        evaluate(
            entry.agent, folder, config, phantom, agent=agent, run=entry.name, published=published
        )
    )
