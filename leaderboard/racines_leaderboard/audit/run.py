"""The audit of one record: checks without scoring, then its numbers recomputed or trained anew.

Another training ends elsewhere, but for the same machine. So a metric that was trained again holds
if the new one lies within the old one's 95 % interval. Where all metrics that rank hold, the
record's tier becomes `reproduced`, and what came out is kept in it.
"""

import dataclasses
import json
import tempfile
from collections.abc import Callable, Iterator
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
from racines_leaderboard.audit import claims
from racines_leaderboard.audit.bench import KINDS, Bench
from racines_leaderboard.audit.numbers import HALF, agreement, check_metrics, compare_numbers
from racines_leaderboard.audit.verdicts import (
    SKIPPED,
    Report,
    Verdict,
    equal,
    fails,
    holds,
    unknown,
)
from racines_leaderboard.board.collect import Record, read_record
from racines_leaderboard.board.recompute import Ground, recompute_scores, score_on
from racines_leaderboard.records.schema import sealed, write_record
from racines_leaderboard.records.tracks import TRACK
from racines_models.protocol import Run
from racines_models.provenance import weights_sha256
from racines_models.registry import generator_class, open_runs, weights_of
from racines_models.training.checkpoint import train_seeds


def audit(path: Path, bench: Bench, quick: bool = False) -> Report:
    """Audit a record, `<results>/<board>/<track>/<name>.json`; `quick` recomputes no number."""
    record = _read(path, bench)
    if isinstance(record, Report):
        return record
    verdicts = [holds("record", "fits its schema, and stands where it says")]
    verdicts += _check(path, record, bench)
    how: dict[str, Any] = {}
    if quick:
        verdicts += [
            Verdict(f"metrics.{key}", SKIPPED, "--quick recomputes no number", metric["value"])
            for key, metric in record["scores"]["metrics"].items()
        ]
    else:
        numbers, how = _recomputed(record, bench)
        settled = {each.subject for each in numbers}
        verdicts = [each for each in verdicts if each.subject not in settled] + numbers
    return _report(record, verdicts, how)


def retrain(path: Path, bench: Bench, into: Path) -> Report:
    """Audit a record by training its system again; write the tier if all that ranks holds.

    The runs are kept in the folder `into`; one that was killed goes on.
    """
    record = _read(path, bench)
    if isinstance(record, Report):
        return record
    verdicts = list(_check(path, record, bench))
    not_merged = "its code is not merged: only its artefacts can be scored again"
    if reason := not_merged if claims.submitted(record) else bench.lacks_for(record):
        return _report(record, [*verdicts, unknown("reproduced", reason)], {})
    folder = into / bench.board / record["track"] / record["name"]
    if record["track"] == "generators":
        scores = score_fitted(record, bench, folder)
    else:
        scores = score_agent(record, bench, folder, train=True)
    made = json.loads(json.dumps(scores))
    how = {"road": "trained again", "agreement": "interval", "from": "another training"}
    report = _report(record, [*verdicts, *_within(record, made)], how)
    if report.holds:
        keys = ("seeds", "metrics", "weights", "code", "environment")
        earned = {"tier": "reproduced", "reproduced": {key: made[key] for key in keys}}
        write_record(path, sealed(record | earned))
    return report


def _read(path: Path, bench: Bench) -> Record | Report:
    """Return a record, or the report that it is damaged or belongs elsewhere."""
    track = TRACK[path.parent.name]
    try:
        return read_record(path, bench.board, track)
    except RacinesError as error:
        return Report(bench.board, track.name, path.stem, "", (fails("record", str(error)),))


def _report(record: Record, verdicts: list[Verdict], how: dict[str, Any]) -> Report:
    track, name, tier = (record[key] for key in ("track", "name", "tier"))
    return Report(record["board"], track, name, tier, tuple(verdicts), how)


def _check(path: Path, record: Record, bench: Bench) -> Iterator[Verdict]:
    """Give the verdicts that need no scoring; the other records of the track have a say."""
    yield from claims.check_claims(record, bench)
    if record["track"] == "generators":
        yield from claims.dataset(record, bench)
        yield from claims.drawing_seeds(record, bench)
    else:
        yield from claims.task(record, bench)
    others = [_read(other, bench) for other in sorted(path.parent.glob("*.json")) if other != path]
    peers = [other for other in others if not isinstance(other, Report)]
    yield from claims.judges(record, bench, peers)
    yield from claims.check_weights(record, bench)
    yield from claims.check_content(record, bench)
    yield from check_metrics(record, bench)


def _recomputed(record: Record, bench: Bench) -> tuple[list[Verdict], dict[str, Any]]:
    """Recompute the numbers of a record; return a verdict a number, and how it was done."""
    road = find_road(record, bench)
    if isinstance(road, str):
        claimed = record["scores"]["metrics"].items()
        return [unknown(f"metrics.{key}", road, each["value"]) for key, each in claimed], {}
    try:
        made = json.loads(json.dumps(road.score()))
    except RacinesError as error:
        return [fails("metrics", f"made from {road.source}: {error}")], {"road": road.name}
    tier = agreement(record, made, road.name)
    verdicts = list(compare_numbers(record, made, tier))
    if road.name == "fitted":
        verdicts += [
            equal(f"claims.{name}", sha256, made["weights"].get(name), road.source)
            for name, sha256 in claims.named(record).items()
        ]
    how = {"road": road.name, "agreement": tier, "from": road.source}
    return verdicts, how | {"environment": made["environment"]}


def _within(record: Record, made: dict[str, Any]) -> Iterator[Verdict]:
    """Say whether each metric that ranks lies in the record's interval; others are told."""
    for key, claimed in record["scores"]["metrics"].items():
        here, subject = made["metrics"].get(key), f"reproduced.{key}"
        if here is None or here["value"] is None or claimed["low"] is None:
            yield unknown(subject, "no interval, or not made here", claimed["value"])
            continue
        both = claimed["value"], here["value"]
        inside = claimed["low"] <= here["value"] <= claimed["high"]
        interval = f"95 % interval {claimed['low']:.6g} to {claimed['high']:.6g}"
        if key in TRACK[record["track"]].ranked_by:
            say = holds if inside else fails
            yield say(subject, f"in its {interval}", *both)
        else:
            where = "inside" if inside else "outside"
            yield unknown(subject, f"does not rank: {where} its {interval}", *both)


@dataclass(frozen=True)
class Road:
    """How the numbers of a record are recomputed: from which files, and how near they must come.

    artefacts       the submitted files, confined as by `racines leaderboard --recompute`
    run             the weights that the record names, in the folder of their run
    fitted          a method that does not train: fitted again on the data
    half precision  the published copy of the weights that the record names
    no weights      an agent that learns nothing
    """

    name: str
    source: str
    """From what, in words."""
    score: Callable[[], dict[str, Any]]


def find_road(record: Record, bench: Bench) -> Road | str:
    """Return the best way to recompute a record's numbers, or why there is none."""
    if lacking := bench.lacks_for(record):
        return lacking
    if claims.submitted(record):
        on, folder = _ground(record, bench), claims.submission_of(record, bench)
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
    name, folder = record["name"], claims.run_of(record, bench)
    try:
        cls = generator_class(name)
    except RacinesError:
        return f"{name} is no registered generator, and has no artefact that can be scored again"
    if folder.is_dir() and weights_of(name, folder) == claims.named(record):
        return Road("run", f"the weights in {folder}", lambda: score_run(record, bench, folder))
    if "training" not in {each.name for each in dataclasses.fields(cls.Config)}:
        source = "it does not train: fitted again on the data"
        return Road("fitted", source, lambda: score_fitted(record, bench))
    copies = claims.published(record, bench)
    if copies is not None and set(copies) == set(claims.named(record)):
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
    folder, claimed = claims.run_of(record, bench), claims.named(record)
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
    if train and claims.named(record):
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


def find_records(results: Path, names: list[str], board: str | None) -> list[Path]:
    """Return the records of some names, NAME or TRACK/NAME; all of them if no name is given."""
    paths = [p for p in sorted(results.glob(f"{board or '*'}/*/*.json")) if p.parts[-2] in TRACK]
    if not paths:
        raise RacinesError(f"{results}: no results of {board or 'any board'}")
    called = {path: {path.stem, f"{path.parent.name}/{path.stem}"} for path in paths}
    for name in names:
        if not any(name in known for known in called.values()):
            known = ", ".join(sorted({path.stem for path in paths}))
            raise RacinesError(f"{name!r}: no such result; those there: {known}")
    return [path for path in paths if not names or called[path] & set(names)]
