"""Scores of a generator on held-out poses: each number with n, an interval and its provenance."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from racines_data.engines import Engine
from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.store.frames import SECTOR, FrameStore
from racines_models.contract import declared
from racines_models.judges.grader.model import Grader
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.sample import Progress, Sample, draw, runs_of, speed, take_sample
from racines_models.scores.features import Extractor, GraderFeatures, InceptionFeatures, Remembered
from racines_models.scores.scorer import PRDC_FRAMES as PRDC_FRAMES
from racines_models.scores.scorer import Scorer, ScoresConfig, plain
from racines_models.scores.spread import SpreadExtractor, SpreadGrader, SpreadPose, spread_draw
from racines_models.scores.turns import by_angle, turn_figures
from racines_models.statistics import Evidence

SCHEMA = "racines.generator-scores/1"
NOTES = [
    "FID is biased upwards by small n: compare only figures of equal n, extractor and dataset.",
    "Intervals are over trajectories and trainings; those of one training say nothing of another.",
]
TURN_NOTES = [
    *NOTES[:1],
    f"One heart. Intervals are over sectors of {SECTOR:g}° of turns and over trainings; those of "
    "one training say nothing of another, and none says anything of another heart.",
    "Strata are of the angle from the turn to the nearest training turn, modulo 180°.",
]


@dataclass(frozen=True)
class Scores:
    """The scores file's content, and the images it speaks of."""

    content: dict[str, Any]
    sample: Sample
    images: Tensor
    """(N, 128, 128) uint8, drawn with the first seed."""
    evidence: Evidence = field(default_factory=Evidence)
    """What the figures follow from; `statistics.write_scores` keeps it beside them."""


def score(
    generator: ImageSource | Sequence[ImageSource],
    store: FrameStore,
    config: ScoresConfig,
    name: str,
    grader: Grader | None = None,
    pose: PoseRegressor | None = None,
    seeds: Sequence[int] | None = None,
    cache: Path | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
    engine: Engine | None = None,
) -> Scores:
    """Score a generator on a split of a dataset.

    Args:
        generator: Anything that makes images of parameters; or several trainings of one method,
            which take the drawing seeds in turn. Figures are means over trainings.
        store: Holds the true frames.
        config: Sample size, seeds and split.
        name: The generator's name in the scores.
        grader: Adds FID, KID and PRDC on its features, and where views are known its agreement
            with the truth.
        pose: Adds the errors of the poses that it reads from the images.
        seeds: Instead of those of the config.
        cache: Folder for what is computed of the reference alone.
        device: Where features are computed.
        progress: Told of images drawn and images embedded, as they come.
        engine: Draws and looks at images, started; None: this process.

    Raises:
        RacinesError: an empty split, or images that cannot be scored.
    """
    began = time.perf_counter()
    seeds = tuple(config.seeds if seeds is None else seeds)
    if not seeds:
        raise RacinesError("scores.seeds: give one seed or more")
    sample = take_sample(store, config.split, config.samples)
    runs = runs_of(generator)
    turns = take_turns(runs, seeds)
    seeds = tuple(seed for _, seed in turns)
    draw_by = draw if engine is None else partial(spread_draw, engine)
    drawn = [draw_by(each, sample.frames, seed, progress) for each, seed in turns]
    scorer = Scorer(config, store, sample, drawn, cache, progress, len(runs))
    inception: Extractor = InceptionFeatures(device)
    if engine is not None:
        inception = SpreadExtractor(inception, engine)
        grader = None if grader is None else SpreadGrader(grader, engine)
        pose = None if pose is None else SpreadPose(pose, engine)
    turned = store.turns is not None  # strata are parts of what was looked at whole
    extractors: dict[str, Extractor] = {"inception": Remembered(inception) if turned else inception}
    figures = scorer.likeness() | scorer.distances("", extractors["inception"])
    if grader is not None:
        extractors["grader"] = GraderFeatures(grader)
        figures |= scorer.distances("_grader", extractors["grader"])
        if bool((sample.frames.views >= 0).any()):  # of a recording nobody may know views
            figures |= scorer.agreement(grader)
    if pose is not None:
        figures |= scorer.poses(pose)
    strata: dict[str, Any] = {}
    if turned:
        figures |= turn_figures(scorer, extractors["inception"], extractors.get("grader"))
        strata["by_stratum"] = by_angle(scorer, extractors["inception"])
    figures |= scorer.variety(runs, seeds) | scorer.memory()
    figures |= scorer.plugged(extractors["inception"], figures)
    if config.speed and hasattr(runs[0], "generate"):
        for batch in (1, 64):
            rate = round(speed(runs[0], sample.frames, batch), 1)
            rule = f"best of 5 calls at batch {batch}"
            figures[f"images_per_second_{batch}"] = plain(rate, batch, "images/s", rule=rule)
    content = {
        "schema": SCHEMA,
        "generator": name,
        "dataset": dataset_card(store) | {"split": config.split, "sample": sample.digest},
        "seeds": list(seeds),
        "runs": len(runs),
        "trained": any(declared(run).trained is not False for run in runs),
        "metrics": figures,
        **strata,
        "extractors": {key: extractor.settings for key, extractor in extractors.items()}
        | ({} if pose is None else {"pose": pose.settings}),
        "weights": None,
        "code": code_version(),
        "environment": environment(device),
        "seconds": round(time.perf_counter() - began, 3),
        "notes": TURN_NOTES if turned else NOTES,
    }
    return Scores(content, sample, drawn[0], scorer.evidence)


def take_turns(runs: Sequence[ImageSource], seeds: Sequence[int]) -> list[tuple[ImageSource, int]]:
    """Return which run draws with which seed: every run as often, and each seed at least once.

    A method that draws the same whatever the seed draws once a run. Where the seeds do not suffice,
    those that follow the largest are taken.
    """
    card = getattr(runs[0], "card", None)
    still = card is not None and not card.stochastic
    wanted = len(runs) * (1 if still else math.ceil(len(seeds) / len(runs)))
    last = max(seeds)
    longer = [*seeds, *range(last + 1, last + 1 + wanted)][:wanted]
    return [(runs[k % len(runs)], seed) for k, seed in enumerate(longer)]
