"""Training of the pose regressor, by the trainer of the generators; its report on held-out data."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.geometry import Pose, geodesic, parameters_to_pose
from racines_data.manifest import scale_known
from racines_data.store.frames import FrameStore
from racines_models.devices import resolve_device
from racines_models.judges.pose.frames import parameters_in, told_in
from racines_models.judges.pose.regressor import PoseConfig, PoseNetwork, PoseRegressor
from racines_models.protocol import Run
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.statistics import median_interval
from racines_models.training.augmentation import augment
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.objective import TrainBatch, Update
from racines_models.training.trainer import train

LARGEST = {"mm": float("inf"), "deg": 180.0}
"""Error of a pose, by unit."""
BETA = 0.1
"""Where the loss turns from square to straight, in standard deviations of a target."""


class PoseLearner:
    """What the trainer needs of the pose regressor."""

    name = "pose"

    def __init__(self, config: PoseConfig, seed: int, data: dict[str, Any]):
        self.config = config
        self.identity = {"name": self.name, "config": asdict(config), "seed": seed, "data": data}
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = PoseNetwork(config.input_size, config.width)

    def modules(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {"pose": self.network}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return ("pose",)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return its AdamW."""
        rate, decay = self.config.learning_rate, self.config.weight_decay
        return {"pose": AdamW(self.network.parameters(), rate, weight_decay=decay, fused=True)}

    def updates(self, nets: Mapping[str, nn.Module], batch: TrainBatch) -> Iterator[Update]:
        """Yield the one step: smooth L1 of the standardised targets, which seeks medians."""
        x = augment(self.network.normalise(batch.images), batch.seeds, self.config.augmentation)
        error = nn.functional.smooth_l1_loss(
            nets["pose"](x), self.network.targets(batch.parameters), beta=BETA, reduction="none"
        )
        logged = {"position": error[:, :3].mean(), "rotation": error[:, 3:].mean()}
        yield Update("pose", logged["position"] + logged["rotation"], logged)


def train_pose(store: FrameStore, config: PoseConfig, run: Run) -> dict[str, Any]:
    """Train, save into `run.folder`, and return the metrics on the test trajectories.

    From a config of patients it learns poses about their hearts (`config.frame` is heart then).

    Raises:
        RacinesError: no training frames, or `run.resume` is True and nothing can be resumed.
    """
    rows = store.split_indices("train")
    if not len(rows):
        raise RacinesError("pose: the train split is empty; build a dataset with more sweeps")
    if store.patients is not None:
        config = replace(config, frame="heart")
    taught = told_in(config.frame, store)
    run = replace(run, device=resolve_device(run.device))
    learner = PoseLearner(config, run.seed, dataset_card(store))
    learner.network.fit_targets(taught.parameters[rows])
    learner.network.to(run.device)
    figures = train(learner, taught, config.training, run)
    regressor = PoseRegressor(learner.network, config, run.device)
    made = {"dataset": dataset_card(store), "seed": run.seed, "code": code_version()}
    regressor.save(run.folder, **made)
    metrics = {"schema": "racines.pose-metrics/1"} | made | report(regressor, store)
    metrics |= {"training": figures, "environment": environment(run.device)}
    write_json(run.folder / "metrics.json", metrics)
    discard_checkpoint(run.folder)
    return metrics


def report(regressor: PoseRegressor, store: FrameStore, split: str = "test") -> dict[str, Any]:
    """Read the poses of a split and compare with the recorded ones, in the regressor's frame.

    Returns:
        `split`; `metrics`: `pose_error_mm` and `pose_error_deg`, medians over all frames, and
        `…_view`, over the frames of a view; each with value, low, high, n. Without a known scale
        nothing is told in millimetres.

    Raises:
        RacinesError: it reads poses about patients' hearts, and no patients are scanned.
    """
    rows = store.split_indices(split)
    frames = store.take(rows)
    true = parameters_in(regressor.config.frame, store, rows)
    errors = pose_errors(regressor.predict(frames.images), true)
    units = store.units(rows)
    of_view = (frames.views >= 0) & (frames.views != len(store.labels) - 1)
    metrics = {}
    for suffix, chosen in (("", torch.ones_like(of_view)), ("_view", of_view)):
        for unit, values in zip(("mm", "deg"), errors, strict=True):
            if bool(chosen.any()) and (unit != "mm" or scale_known(store.manifest)):
                found = values[chosen].numpy(), units[chosen.numpy()]
                median = median_interval(*found, 0.0, LARGEST[unit])
                metrics[f"pose_error_{unit}{suffix}"] = median.to_json(unit)
    return {"split": split, "metrics": metrics}


def pose_errors(found: Pose, parameters: Tensor) -> tuple[Tensor, Tensor]:
    """Return the (N,) distances in mm and (N,) angles in degrees, float64, from the true poses."""
    true = parameters_to_pose(parameters.double())
    distance = (found.position.double() - true.position).norm(dim=-1)
    return distance * 1e3, torch.rad2deg(geodesic(found.rotation.double(), true.rotation))
