"""How the numbers of a record are recomputed: from which files, and how near they must come.

artefacts       the submitted files, through the confined roads of `racines leaderboard --recompute`
run             the weights that the record names, in the folder of their run
fitted          a method that does not train: fitted again on the data
half precision  the published copy of the weights that the record names
no weights      an agent that learns nothing
"""

import dataclasses
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_envs.agents import agent_class, load_agent
from racines_envs.cli.settings import phantom_config
from racines_envs.evaluation.agent_specs import find_entry
from racines_envs.evaluation.run import evaluate
from racines_envs.worlds.backends import make_grader
from racines_leaderboard.audit.bench import KINDS, Bench
from racines_leaderboard.audit.weights import named, published, run_of, submission_of, submitted
from racines_leaderboard.board.collect import Record
from racines_leaderboard.board.recompute import Ground, recompute_scores, score_on
from racines_models.protocol import Run
from racines_models.provenance import weights_sha256
from racines_models.registry import generator_class, open_runs, weights_of
from racines_models.training.checkpoint import train_seeds

HALF = "half precision"


@dataclass(frozen=True)
class Road:
    """A way to the numbers."""

    name: str
    source: str
    """From what, in words."""
    score: Callable[[], dict[str, Any]]


def find_road(record: Record, bench: Bench) -> Road | str:
    """Return the best way to recompute a record's numbers, or why there is none."""
    if lacking := bench.lacks_for(record):
        return lacking
    if submitted(record):
        on, folder = _ground(record, bench), submission_of(record, bench)
        source = f"the artefacts in {folder}"
        return Road("artefacts", source, lambda: recompute_scores(folder, on)[1])
    return (_generator if record["track"] == "generators" else _agent)(record, bench)


def _ground(record: Record, bench: Bench) -> Ground:
    """Return the board's ground with the judges that a record names, where they are here."""
    places = bench.places
    return Ground(
        bench.board,
        bench.settings or {},
        places.data,
        grader=_judge(record, bench, "grader"),
        pose=_judge(record, bench, "pose"),
        cache=places.runs / "scores" / "reference",
        limits=places.limits,
    )


def _judge(record: Record, bench: Bench, extractor: str) -> Path | None:
    card = record["scores"].get("extractors", {}).get(extractor, {})
    return bench.judge(KINDS[extractor], card.get("sha256"))


def _generator(record: Record, bench: Bench) -> Road | str:
    name, folder = record["name"], run_of(record, bench)
    try:
        cls = generator_class(name)
    except RacinesError:
        return f"{name} is no registered generator, and has no artefact that can be scored again"
    if folder.is_dir() and weights_of(name, folder) == named(record):
        return Road("run", f"the weights in {folder}", lambda: score_run(record, bench, folder))
    if "training" not in {each.name for each in dataclasses.fields(cls.Config)}:
        source = "it does not train: fitted again on the data"
        return Road("fitted", source, lambda: score_fitted(record, bench))
    copies = published(record, bench)
    if copies is not None and set(copies) == set(named(record)):
        copy = bench.places.weights / name
        source = f"the half-precision copy of the weights, {copy}"
        return Road(HALF, source, lambda: score_run(record, bench, copy))
    return f"no weights of it here: neither {folder} nor a published copy; --retrain trains anew"


def score_fitted(record: Record, bench: Bench, folder: Path | None = None) -> dict[str, Any]:
    """Fit a merged generator by the board's settings and return its scores.

    The run is kept in `folder` and, if it was cut short, goes on there; None keeps nothing.
    """
    assert bench.settings is not None and bench.store is not None
    store, name, cls = bench.store, record["name"], generator_class(record["name"])
    settings = section(bench.settings, "generators").get(name) or {}
    config: Any = fill(cls.Config, settings, f"generators.{name}")
    repeats = getattr(getattr(config, "training", None), "repeats", 1)
    with tempfile.TemporaryDirectory() as aside:
        place = Path(aside) / name if folder is None else folder
        run = Run(place, bench.settings.get("seed", 0), "cpu", progress=False)
        train_seeds(lambda one: cls(config).fit(store, one), run, repeats)
        return score_run(record, bench, place)


def score_run(record: Record, bench: Bench, folder: Path) -> dict[str, Any]:
    """Return the scores of the generator in a run's folder, by the judges that a record names."""
    assert bench.store is not None
    name = record["name"]
    opened = open_runs(name, folder, device="cpu")
    scores = score_on(_ground(record, bench), bench.store, bench.scores, opened, name)
    return scores | {"weights": weights_of(name, folder)}


def _agent(record: Record, bench: Bench) -> Road | str:
    folder, claimed = run_of(record, bench), named(record)
    if "guide" in record["scores"].get("extractors", {}) and not _judge(record, bench, "guide"):
        return "the grader that it goes by is not here"
    if not claimed:
        return Road("no weights", "it learns nothing", lambda: score_agent(record, bench, folder))
    if folder.is_dir() and weights_sha256(folder) == claimed:
        return Road("run", f"the policy in {folder}", lambda: score_agent(record, bench, folder))
    return f"no policy of it in {folder}; --retrain trains anew"


def score_agent(record: Record, bench: Bench, folder: Path, train: bool = False) -> dict[str, Any]:
    """Return the scores of a merged agent, its policy in a folder, by the board's settings.

    With `train`, what learns is trained there first; a run that was killed goes on. The graders
    that had a say are those that the record names.
    """
    assert bench.settings is not None
    entry, view = find_entry(bench.settings, record["name"]), record["scores"]["task"]["view"]
    phantom = phantom_config(bench.settings)
    if train and named(record):
        cls, seed = agent_class(entry.agent), bench.settings.get("seed", 0)
        own: Any = fill(cls.Config, entry.settings, entry.where)
        data = bench.places.data
        cls.train(own, folder, seed=seed, phantom=phantom, data=data, progress=False)
    judge, guide = (_judge(record, bench, kind) for kind in ("grader", "guide"))
    settings = {"view": view, "grader": str(judge or ""), "latency": 0, "device": "cpu"}
    config = dataclasses.replace(bench.evaluation, **settings)
    agent: Any = load_agent(entry.agent, folder, config.device)
    if guide is not None:
        agent.guide = make_grader(guide, config.device)
    return evaluate(entry.agent, folder, config, phantom, agent=agent, run=entry.name).scores
