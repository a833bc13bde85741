"""What a frame, a step and a scored image cost, and how tasks spread over eight nodes.

    python -m tests.benchmarks.scale        # writes docs/results/scale.json; a few minutes

Costs are CPU seconds of one thread (`time.process_time`), which other work on the machine hardly
changes; wall times are not told. The eight nodes are simulated on this machine by
`ray.cluster_utils.Cluster`: they show who gets which task, and nothing of a network.
"""

import json
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import torch

from racines_data.build import staging
from racines_data.build.dataset import DataConfig, build
from racines_data.files import write_json
from racines_data.sources.gate.bounds import bounds_of
from racines_data.sources.patients import BeatingSource
from racines_data.sources.phantom import PhantomSource

ROOT = Path(__file__).parents[2]
OUT = ROOT / "docs/results/scale.json"
FRAMES, IMAGES, TASKS, NODES = (240, 1440), 48, 400, 8
HEARTS = 5
PLAN = {"frames": 10_000_000, "hearts": 10_000, "submissions": 1_000}
A_HEART, MASK = 120, 128 * 128
"""Frames of a heart in the plan, and bytes of the mask of each."""
SCORED, STEPS = 2 * 3 * 256, 3 * 100 * 200
"""Images that scores of a generator look at, of three trainings and the truth; steps of an agent,
at most."""
HOUR, GB = 3600, 1e9


def cost(work: Callable[[], Any], count: int) -> float:
    """Return the CPU seconds of one of `count` things, the least of two goes."""

    def once() -> float:
        began = time.process_time()
        work()
        return time.process_time() - began

    return min(once(), once()) / count


def frames_of(source: Any, units: Sequence[Any]) -> list[Any]:
    """Make the staged tables of some units."""
    bounds = bounds_of(source, ())
    return [staging._make(source, bounds, unit) for unit in units]


def of_build() -> dict[str, Any]:
    """Measure a frame of the phantom: making it, its staged bytes and its bytes in a dataset."""
    sources: list[Any] = [
        PhantomSource.from_config({"frames": n, "shortest": 60, "longest": 60}, []) for n in FRAMES
    ]
    units = sources[0].plan()
    frames_of(sources[0], units[:1])  # the phantom is made once a worker
    made = cost(lambda: frames_of(sources[0], units), FRAMES[0])
    staged = sum(table.nbytes for table in frames_of(sources[0], units[:1])) / units[0].frames
    seconds, sizes = [], []
    with TemporaryDirectory() as folder:
        for source in sources:
            root = Path(folder) / "racines"
            began = time.process_time()
            build(source, root, DataConfig(workers=1, shards=4))
            seconds.append(time.process_time() - began)
            sizes.append(sum(path.stat().st_size for path in root.rglob("*") if path.is_file()))
    more = FRAMES[1] - FRAMES[0]  # what a dataset costs whatever its size is left out
    return {
        "frame_seconds": made,
        "driver_frame_seconds": (seconds[1] - seconds[0]) / more - made,
        "staged_frame_bytes": staged,
        "dataset_frame_bytes": (sizes[1] - sizes[0]) / more,
    }


def of_hearts() -> dict[str, Any]:
    """Measure a beating heart that nobody has baked, and a frame of it."""
    settings = {"train": HEARTS, "validation": 0, "test": 0, "frames_per_sweep": 12}
    source, first, then = BeatingSource.from_config(settings), [], []
    of_heart: dict[int, list[Any]] = {}
    for unit in source.plan():
        of_heart.setdefault(unit.patient, []).append(unit)
    with TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        for units in of_heart.values():
            began = time.process_time()
            frames_of(source, units[:1])
            baked = time.process_time()
            frames_of(source, units[:1])
            then.append(time.process_time() - baked)
            first.append(baked - began - then[-1])
    frame = median(then) / settings["frames_per_sweep"]
    return {"heart_seconds": median(first), "beating_frame_seconds": frame}


def of_scoring() -> dict[str, Any]:
    """Measure a step of an environment, and an image that is looked at by each judge."""
    from racines_envs.agents.random import RandomAgent
    from racines_envs.agents.rollout import rollout
    from racines_envs.task.starts import evaluation_seeds
    from racines_envs.worlds.making import make_core
    from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
    from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
    from racines_models.scores.features import InceptionFeatures

    seeds, steps = evaluation_seeds(20, 0), {}
    for observation in ("params", "image"):
        core = make_core("SC", 20, observation=observation, reward="oracle")
        agent: Any = RandomAgent()
        agent.observation = observation
        done = int(rollout(core, agent, seeds).final["steps"].sum())
        steps[f"{observation}_step_seconds"] = cost(
            lambda core=core, agent=agent: rollout(core, agent, seeds), done
        )
    images = torch.randint(0, 256, (IMAGES, 128, 128), dtype=torch.uint8)
    grader = Grader(GraderNetwork(64, 1.0), GraderConfig())
    pose, inception = PoseRegressor(PoseNetwork(64, 0.5), PoseConfig()), InceptionFeatures()
    looks: dict[str, Callable[[], Any]] = {
        "inception": lambda: inception(images),
        "grader": lambda: grader.judge(images),
        "pose": lambda: pose.predict(images),
    }
    for look in looks.values():
        look()
    return steps | {f"{name}_seconds": cost(look, IMAGES) for name, look in looks.items()}


def nothing(state: None, task: int) -> int:
    """Do nothing: what a task costs is then the engine's."""
    return task


def where(state: float, task: int) -> str:
    """Return the node that a task ran on, after so many seconds."""
    import ray

    time.sleep(state)
    return ray.get_runtime_context().get_node_id()


@contextmanager
def nodes(count: int) -> Iterator[Any]:
    """Simulate a cluster of so many nodes of one CPU each."""
    import ray
    from ray.cluster_utils import Cluster

    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_DEDUP_LOGS": "0"}
    small: dict[str, Any] = {"num_cpus": 1, "object_store_memory": 80 << 20}
    cluster = Cluster(True, True, {**small, "include_dashboard": False}, shutdown_at_exit=True)
    try:
        for _ in range(count - 1):
            cluster.add_node(**small)
        cluster.wait_for_nodes()
        yield cluster
    finally:
        ray.shutdown()
        cluster.shutdown()


def of_nodes() -> dict[str, Any]:
    """Spread tasks over eight nodes; one of the nodes goes away meanwhile."""
    from racines_data.engines.ray import RayEngine

    with nodes(NODES) as cluster, RayEngine() as engine:
        list(engine.map(where, 0.5, range(4 * NODES)))  # each node starts its worker
        list(engine.map(nothing, None, range(TASKS)))
        began = time.process_time()
        list(engine.map(nothing, None, range(TASKS)))
        task = (time.process_time() - began) / TASKS
        spread = Counter(engine.map(where, 0.2, range(20 * NODES)))
        some = iter(engine.map(where, 0.2, range(10 * NODES)))
        first = [next(some) for _ in range(NODES)]
        cluster.remove_node(list(cluster.worker_nodes)[-1], allow_graceful=False)
        left = [*first, *some]
    return {
        "nodes": NODES, "driver_task_seconds": task, "tasks": 20 * NODES, "used": len(spread),
        "fewest": min(spread.values()), "most": max(spread.values()),
        "after_a_loss": len(left), "asked": 10 * NODES,
    }  # fmt: skip


def planned(measured: dict[str, Any]) -> dict[str, Any]:
    """Return from the costs what the plan takes: hours of one core, GB."""
    making, hearts, scoring = (measured[key] for key in ("build", "hearts", "scoring"))
    frames, shown = PLAN["frames"], PLAN["hearts"] * A_HEART
    look = sum(scoring[f"{name}_seconds"] for name in ("inception", "grader", "pose"))
    beating = PLAN["hearts"] * hearts["heart_seconds"] + shown * hearts["beating_frame_seconds"]
    told = {
        "core_hours": frames * making["frame_seconds"] / HOUR,
        "driver_hours": frames * making["driver_frame_seconds"] / HOUR,
        "staged_gb": frames * making["staged_frame_bytes"] / GB,
        "dataset_gb": frames * making["dataset_frame_bytes"] / GB,
        "heart_core_hours": beating / HOUR,
        "heart_gb": shown * (making["staged_frame_bytes"] + MASK) / GB,
        "image_core_hours": PLAN["submissions"] * SCORED * look / HOUR,
        "step_core_hours": PLAN["submissions"] * STEPS * scoring["image_step_seconds"] / HOUR,
    }
    return {key: round(value, 1) for key, value in told.items()}


def figures(measured: dict[str, Any]) -> dict[str, float]:
    """Return what the page says, rounded: milliseconds, kB, hours."""
    making, hearts, scoring = (measured[key] for key in ("build", "hearts", "scoring"))
    milli = {
        "frame_ms": making["frame_seconds"],
        "driver_frame_ms": making["driver_frame_seconds"],
        "beating_frame_ms": hearts["beating_frame_seconds"],
        "params_step_ms": scoring["params_step_seconds"],
        "image_step_ms": scoring["image_step_seconds"],
        "inception_ms": scoring["inception_seconds"],
        "grader_ms": scoring["grader_seconds"],
        "pose_ms": scoring["pose_seconds"],
        "driver_task_ms": measured["nodes"]["driver_task_seconds"],
    }
    told = {key: round(value * 1e3, 3) for key, value in milli.items()}
    told["heart_s"] = round(hearts["heart_seconds"], 2)
    told["staged_frame_kb"] = round(making["staged_frame_bytes"] / 1e3, 1)
    told["dataset_frame_kb"] = round(making["dataset_frame_bytes"] / 1e3, 1)
    asked = ("tasks", "used", "fewest", "most", "after_a_loss")
    return told | {key: measured["nodes"][key] for key in asked} | measured["plan"]


def main() -> None:
    """Measure all and write it."""
    torch.set_num_threads(1)
    measured: dict[str, Any] = {"build": of_build(), "hearts": of_hearts(), "scoring": of_scoring()}
    measured["nodes"] = of_nodes()
    measured["plan"] = planned(measured)
    told = {
        "schema": "racines.figures/1",
        "what": "CPU seconds of one thread a frame, a step and an image; the plan from them",
        "command": "python -m tests.benchmarks.scale",
        "machine": f"{platform.machine()}, torch {torch.__version__}",
        "source": "measured once",
        "figures": figures(measured),
    }
    write_json(OUT, told)
    print(json.dumps(told, indent=2))


if __name__ == "__main__":
    main()
