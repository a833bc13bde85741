"""Forces fitted on recordings: polynomial ridge regression from the pose to the wrench.

For recordings that no contact model describes. The regressor (Hoerl and Kennard, Ridge Regression,
1970) takes position, the probe's x axis and its beam, standardised, and all their products up to
the third degree. It is told the pose alone: what comes of motion (friction) it cannot know.
"""

from dataclasses import asdict, dataclass
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.imaging import ImageSource
from racines_data.phantom import contact
from racines_data.tables import markdown_table
from racines_data.world import World
from racines_envs.task.sensing import ForceSource

if TYPE_CHECKING:
    from racines_data.store.frames import FrameStore

SOURCES = ("auto", "contact", "recorded", "fitted")
SCHEMA = "racines.forces/1"
KINDS = ("rmse", "mae")
UNITS = {f"{what}_{x}": unit for what, unit in (("force", "N"), ("torque", "N·m")) for x in "xyz"}
"""By axis, in the order of the first six parameters."""


@dataclass(frozen=True)
class ForceConfig:
    """The regressor."""

    degree: int = 3
    """Highest degree of a product."""
    penalty: float = 1e-6
    """Weight of the squared coefficients, of standardised features, a frame."""
    frames: int = 30_000
    """Most frames fitted on, evenly spread over the train split."""

    def __post_init__(self) -> None:
        if self.degree < 1 or self.penalty <= 0 or self.frames < 1:
            raise RacinesError("forces: degree, penalty and frames are positive")


class FittedForces:
    """A fitted regressor; a source of forces (`wrench`). A row's result ignores its batch."""

    def __init__(self, parameters: Tensor, config: ForceConfig | None = None) -> None:
        """Fit on (M, 12) parameters with finite forces, on the CPU, in double precision."""
        config = config or ForceConfig()
        raw = self._raw(parameters_to_pose(parameters.double()))
        self._mean, std = raw.mean(0), raw.std(0, correction=0)
        self._std = torch.where(std > 1e-9, std, 1.0)
        scaled = (raw - self._mean) / self._std
        # Beyond what was recorded a cubic runs away: features and forces stay within their ranges.
        self._low, self._high = scaled.amin(0), scaled.amax(0)
        width = raw.shape[1]
        products = [
            (*combination, *[width] * (config.degree - degree))
            for degree in range(config.degree + 1)
            for combination in combinations_with_replacement(range(width), degree)
        ]
        self._products = torch.tensor(products, dtype=torch.int64).view(len(products), -1)
        wrench = parameters[:, :6].double()
        self._least, self._most = wrench.amin(0), wrench.amax(0)
        x = self._features(scaled)
        gram = x.T @ x + config.penalty * len(x) * torch.eye(x.shape[1], dtype=x.dtype)
        self._weights = torch.linalg.solve(gram, x.T @ wrench).T.contiguous()

    @staticmethod
    def _raw(pose: Pose) -> Tensor:
        return torch.cat([pose.position, pose.rotation[..., 0], pose.rotation[..., 2]], -1)

    def _features(self, scaled: Tensor) -> Tensor:
        padded = torch.cat([scaled, torch.ones_like(scaled[:, :1])], 1)
        return padded[:, self._products].prod(-1)

    def to(self, device: torch.device | str) -> "FittedForces":
        """Move the regressor to a device, in single precision, and return it."""
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                kind = torch.float32 if value.is_floating_point() else value.dtype
                setattr(self, name, value.to(device, kind))
        return self

    def wrench(self, pose: Pose) -> Tensor:
        """Return the (B, 6) wrench at (B,) poses, N and N·m, in the probe's axes."""
        scaled = (self._raw(pose).to(self._mean.dtype) - self._mean) / self._std
        x = self._features(scaled.clamp(self._low, self._high))
        wrench = (x.unsqueeze(1) * self._weights).sum(-1)
        return wrench.clamp(self._least, self._most).to(torch.float32)


def fit_forces(store: "FrameStore", config: ForceConfig | None = None) -> FittedForces:
    """Fit on the train split of a dataset; deterministic."""
    config = config or ForceConfig()
    parameters = measured(store, "train")
    keep = min(len(parameters), config.frames)
    return FittedForces(parameters[torch.arange(keep) * len(parameters) // keep], config)


def measured(store: "FrameStore", split: str) -> Tensor:
    """Return the (M, 12) parameters of a split's frames with pose and force, if there are any."""
    parameters = store.parameters[slice(*store.bounds(split))]
    parameters = parameters[torch.isfinite(parameters).all(1)]
    if not len(parameters):
        raise RacinesError(
            f"{store.root}: no frame of split {split!r} has a pose and a force: forces cannot be "
            "fitted on this dataset; use forces='contact' with a phantom"
        )
    return parameters


def make_forces(
    forces: ForceSource | str, images: ImageSource, world: World, store: "FrameStore | None",
    device: torch.device | str,
) -> ForceSource | None:  # fmt: skip
    """Return the source of forces that a setting names; None lets the environment choose.

    `auto` is the backend's own, or else the contact model; `contact`, `recorded` and `fitted` (on
    `store`) are refused where there is none; an object with `wrench(pose)` is taken as it is.
    """
    if not isinstance(forces, str):
        if not isinstance(forces, ForceSource):
            raise RacinesError(f"forces {forces!r} has no wrench(pose)")
        return forces
    if forces not in SOURCES:
        raise RacinesError(f"unknown forces {forces!r}: choose one of {', '.join(SOURCES)}")
    if forces == "auto":
        return None
    if forces == "fitted":
        if store is None:
            raise RacinesError("forces='fitted' needs the dataset to fit on: give data=<folder>")
        return fit_forces(store).to(device)
    if forces == "recorded":
        if isinstance(images, ForceSource):
            return images
        raise RacinesError("forces='recorded' needs the backend 'replay': others record none")
    if world.surface_height is None:
        raise RacinesError(
            "forces='contact' needs a phantom, and these are recordings: use forces='recorded' or "
            "'fitted'"
        )
    return world


def force_report(
    store: "FrameStore", config: ForceConfig | None = None, split: str = "test"
) -> dict[str, Any]:
    """Return the errors of the fitted forces on a split that they have not seen, axis by axis.

    Beside them those of predicting the mean of the train split and, of a phantom's dataset, of its
    contact model at rest: it knows the pose exactly as the regressor does, and no velocity either.
    """
    from racines_envs.worlds.replay import source_phantom
    from racines_models.provenance import code_version, dataset_card

    config = config or ForceConfig()
    truth, trained = measured(store, split), measured(store, "train")
    pose, wrench = parameters_to_pose(truth), truth[:, :6]
    predicted = {
        "fitted": fit_forces(store, config).to("cpu").wrench(pose),
        "mean": trained[:, :6].mean(0).expand_as(wrench),
    }
    phantom = source_phantom(store)
    if phantom is not None:
        top = phantom.block.maximum[2]
        predicted["contact"] = contact.wrench(pose, None, top, phantom.contact)
    return {
        "schema": SCHEMA,
        "dataset": dataset_card(store),
        "split": split,
        "frames": {"train": min(len(trained), config.frames), split: len(truth)},
        "config": asdict(config),
        "errors": {name: _errors(p - wrench) for name, p in predicted.items()},
        "code": code_version(),
    }


def _errors(error: Tensor) -> dict[str, dict[str, Any]]:
    rmse, mae = error.square().mean(0).sqrt().tolist(), error.abs().mean(0).tolist()
    return {
        axis: {"rmse": rmse[i], "mae": mae[i], "n": len(error), "unit": unit}
        for i, (axis, unit) in enumerate(UNITS.items())
    }


def forces_markdown(report: dict[str, Any]) -> str:
    """Return the report as a table: one row an axis, RMSE and MAE of each prediction."""
    errors = report["errors"]
    head = ["axis", *(f"{name} {kind.upper()}" for name in errors for kind in KINDS)]
    rows = [
        (f"{axis}, {unit}", *(f"{e[axis][kind]:.3f}" for e in errors.values() for kind in KINDS))
        for axis, unit in UNITS.items()
    ]
    return markdown_table(head, rows, right=1)
