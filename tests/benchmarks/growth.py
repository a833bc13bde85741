"""How cost grows with size: build, load, draw, score, evaluate, audit and the leaderboard.

OMP_NUM_THREADS=1 python -m tests.benchmarks.growth docs/results/growth.json [PART...]

CPU seconds of one thread, so that other work on the machine counts little. To the times t of sizes
n is fitted t = a + b nᵏ: a is what a run costs at any size, k the exponent. Where the largest size
costs hardly more than the smallest, nothing is fitted: the part is flat. The largest memory of
the process is told beside; it never falls, so a part that holds more and more shows. A
quarter of an hour; the parts that are named are measured, the others kept.
"""

import copy
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import curve_fit

import racines_data
from racines_data.build.dataset import DataConfig, build, make_source
from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.patients import Pool, seeds_of
from racines_data.store.frames import FrameStore, open_store
from racines_envs.evaluation.run import EvaluationConfig, evaluate
from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.run import audit
from racines_leaderboard.board.collect import read_board
from racines_leaderboard.board.rank import rankings
from racines_leaderboard.board.table import board_tables
from racines_leaderboard.records.schema import sealed
from racines_leaderboard.records.tracks import TRACK
from racines_models.generators.nearest_pose import NearestPose
from racines_models.protocol import Run
from racines_models.provenance import environment
from racines_models.scores.metrics import Neighbourhoods
from racines_models.scores.scorer import ScoresConfig
from racines_models.scores.scoring import score
from tests.conftest import ROOT

BOARD, LIKE = "phantom-default", "ppo"
RECORDS = (10, 100, 1_000, 10_000)
FRAMES = 256  # drawn of each pool of hearts
ROUNDS, ENOUGH = 5, 30.0
"""Runs of a size, and CPU seconds after which no further one is begun."""
FLAT = 1.3
"""Times the cost at the smallest size, below which that at the largest is no growth: the exponent
of so small a difference would be one of noise."""
Part = Callable[[Path], Iterator[tuple[int, Callable[[], object]]]]
"""Yields sizes, and the work of each."""


def of_build(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Frames of a dataset, one process."""
    for frames in (600, 1_200, 2_400, 4_800):
        config = DataConfig(frames=frames, workers=1)
        source, out = make_source(config), folder / f"built-{frames}"
        yield frames, lambda out=out, config=config, source=source: build(source, out, config)


def of_load(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Frames of a dataset: opened, and taken twenty times in shuffled batches.

    All sizes are beyond the processor's caches, in which a small set is taken faster.
    """
    for frames in (3_600, 4_800, 7_200, 9_600):
        out = built(folder, frames)
        yield frames, lambda out=out: every_batch(open_store(out))


def of_pool(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Hearts of a pool, of which as many frames are drawn however many there are."""
    each = torch.arange(FRAMES)
    phase = torch.stack([each / FRAMES, each / FRAMES], 1).double()
    for hearts in (4, 16, 64):
        pool, rows = Pool(seeds_of("validation")[:hearts], beating=True), each % hearts
        every = pool.targets(rows, phase)
        pose = Pose(*(part[each, each % 5] for part in every))
        pool.render(pose, rows, phase, each)  # hearts are baked, or read, before the clock runs
        yield hearts, lambda pool=pool, pose=pose, rows=rows: pool.render(pose, rows, phase, each)


def of_score(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Frames that a generator is scored on; what compares every pair is left out."""
    store = open_store(built(folder, 4_800))
    retrieval = NearestPose()
    retrieval.fit(store, Run(folder / "nearest-pose", progress=False))
    for samples in (64, 128, 256, 512):
        config = ScoresConfig(samples=samples, speed=False)
        yield samples, lambda config=config: score(retrieval, store, config, "nearest-pose")


def of_pairs(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Frames among which precision, recall, density and coverage compare every pair."""
    for count in (1_000, 2_000, 4_000):
        one, other = torch.from_numpy(np.random.default_rng(0).normal(size=(2, count, 256)))
        yield count, lambda one=one, other=other: Neighbourhoods(one, other)


def of_evaluate(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Episodes that an agent from the pose acts."""
    run = ROOT / "envs/weights/phantom-default/ppo"
    for starts in (200, 400, 800, 1_600):
        config = EvaluationConfig(starts=starts, seeds=(0,), latency=0)
        yield starts, lambda config=config: evaluate("ppo", run, config)


def of_audit(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Records whose claims are checked, no number made again."""
    for count in (10, 30, 100, 300, 1_000):
        place = board(folder, count)
        yield count, lambda place=place: checked(place)


def of_read(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Records of a board: read, held to their evidence, and put between the anchors."""
    for count in RECORDS:
        place = board(folder, count)
        yield count, lambda place=place: read_board(place, BOARD)


def of_rank(folder: Path) -> Iterator[tuple[int, Callable[[], object]]]:
    """Records of a board whose every pair is compared for a place, and drawn as tables."""
    content = read_board(board(folder, RECORDS[-1]), BOARD)
    agents = content["agents"]
    for count in RECORDS[1:]:
        content = content | {"agents": agents[:count]}
        yield count, lambda content=content: drawn(content)


PARTS: dict[str, Part] = {
    "build, frames": of_build,
    "load, frames": of_load,
    "pool, hearts": of_pool,
    "score, frames": of_score,
    "score by pairs, frames": of_pairs,
    "evaluate, episodes": of_evaluate,
    "audit --quick, records": of_audit,
    "leaderboard read, records": of_read,
    "leaderboard ranked, records": of_rank,
}
PAIRS = {"score by pairs, frames", "leaderboard ranked, records"}
"""Parts that compare every pair, by design."""


def built(folder: Path, frames: int) -> Path:
    """Return the folder of a dataset of so many frames; made if it is missing."""
    out = folder / f"built-{frames}"
    if not out.is_dir():
        config = DataConfig(frames=frames, workers=1)
        build(make_source(config), out, config)
    return out


def every_batch(store: FrameStore) -> None:
    """Take each frame of the train split some times, and some rows as `datasets` gives them."""
    for passes in range(20):
        for batch in store.batches("train", 256, passes):
            batch.images.sum()
    rows = racines_data.load(root=store.root, split="train")
    for row in islice(rows, 64):
        assert row["image"].size == (128, 128)


def board(folder: Path, count: int) -> Path:
    """Return results in which one record of the default board stands so many times."""
    place = folder / f"board-{count}"
    track = place / BOARD / "agents"
    if track.is_dir():
        return place
    shutil.copytree(ROOT / "leaderboard/results" / BOARD / "agents", track)
    shutil.copy(ROOT / "leaderboard/results" / BOARD / "board.json", place / BOARD)
    record = json.loads((track / f"{LIKE}.json").read_text())
    for i in range(count - len(list(track.glob("*.json")))):
        name, one = f"{LIKE}-{i:05d}", copy.deepcopy(record)
        one["name"] = one["scores"]["agent"] = name
        one["scores"]["evidence"]["file"] = f"{name}.parquet"
        (track / f"{name}.json").write_text(json.dumps(sealed(one)))
        os.link(track / f"{LIKE}.parquet", track / f"{name}.parquet")
    return place


def checked(place: Path) -> None:
    """Audit each record of a board without making a number again."""
    bench = Bench(BOARD, Places(results=place))
    for path in sorted((place / BOARD / "agents").glob("*.json")):
        audit(path, bench, quick=True)


def drawn(content: dict[str, Any]) -> None:
    """Rank the agents of a board and draw its tables."""
    assert rankings(TRACK["agents"], content["agents"])
    assert board_tables(BOARD, content)


def is_flat(seconds: list[float]) -> bool:
    """Return whether the cost hardly grew from the smallest size to the largest."""
    return seconds[-1] < FLAT * seconds[0]


def fitted(sizes: list[int], seconds: list[float]) -> tuple[float, float]:
    """Return what a run costs at any size, s, and the exponent of the rest."""
    n, t = np.array(sizes) / max(sizes), np.array(seconds)

    def law(n: np.ndarray, fixed: float, slope: float, exponent: float) -> np.ndarray:
        return fixed + slope * n**exponent

    bounds = ([0, 0, 0.2], [min(t), 2 * max(t), 4])
    (fixed, _, exponent), _ = curve_fit(law, n, t, (min(t) / 2, max(t), 1), sigma=t, bounds=bounds)
    return float(fixed), float(exponent)


def measure(part: Part, folder: Path) -> dict[str, Any]:
    """Measure a part at its sizes; the best of five runs, or of as many as half a minute takes."""
    told: dict[str, Any] = {"sizes": [], "seconds": [], "megabytes": []}
    for size, work in part(folder):
        took = []
        while len(took) < ROUNDS and sum(took) < ENOUGH:
            start = time.process_time()
            work()
            took.append(time.process_time() - start)
        told["sizes"].append(size)
        told["seconds"].append(round(min(took), 3))
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        told["megabytes"].append(round(most))
    if not is_flat(told["seconds"]):
        told["fixed"], told["exponent"] = fitted(told["sizes"], told["seconds"])
    return told


def main(out: Path, *names: str) -> None:
    """Measure the parts, or those whose names begin so, and write them after each."""
    document: dict[str, Any] = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    kept = document.get("parts", {})
    with tempfile.TemporaryDirectory() as folder:
        for name, part in PARTS.items():
            if names and not name.startswith(names):
                continue
            kept[name] = measure(part, Path(folder))
            print(name, kept[name], flush=True)
            write_json(out, document_of({each: kept[each] for each in PARTS if each in kept}))


def law_of(name: str, part: dict[str, Any]) -> tuple[str, str]:
    """Return what a part costs at any size, and its exponent, as the table says it."""
    if is_flat(part["seconds"]):
        return "all", "– (flat)"
    pairs = " (every pair)" if name in PAIRS else ""
    return f"{part['fixed']:.2f}", f"{part['exponent']:.2f}{pairs}"


def document_of(parts: dict[str, Any]) -> dict[str, Any]:
    """Return the file of what was measured, with its table."""
    columns = ["what", "sizes", "CPU seconds", "of which at any size", "exponent", "memory, MB"]
    rows = [
        [name, f"{each['sizes'][0]:,} – {each['sizes'][-1]:,}",
         f"{each['seconds'][0]:.3g} – {each['seconds'][-1]:.3g}", *law_of(name, each),
         f"{each['megabytes'][0]:,} – {each['megabytes'][-1]:,}"]
        for name, each in parts.items()
    ]  # fmt: skip
    where = environment("cpu")
    return {
        "schema": "racines.figures/1",
        "what": "how cost grows with size, one thread",
        "command": "OMP_NUM_THREADS=1 python -m tests.benchmarks.growth docs/results/growth.json",
        "machine": f"{where['cpu']}, one thread, torch {where['torch']}, beside other work",
        "source": "measured once",
        "parts": parts,
        "tables": {"growth": {"columns": columns, "right": 1, "rows": rows}},
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
