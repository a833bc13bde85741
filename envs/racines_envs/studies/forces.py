"""How well the fitted forces hold on trajectories that they were not fitted on."""

from dataclasses import asdict
from typing import Any

from torch import Tensor

from racines_data.geometry import parameters_to_pose
from racines_data.schema import PARAMETERS
from racines_data.store.frames import FrameStore
from racines_data.tables import markdown_table
from racines_envs.worlds.forces import ForceConfig, fit_forces, measured
from racines_envs.worlds.replay_images import source_phantom

SCHEMA = "racines.forces/1"
AXES = PARAMETERS[:6]
KINDS = ("rmse", "mae")
UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")


def force_report(
    store: FrameStore, config: ForceConfig | None = None, split: str = "test"
) -> dict[str, Any]:
    """Return the errors of the fitted forces on a split that they have not seen, axis by axis.

    Beside them those of predicting the mean of the train split and, of a phantom's dataset, of its
    contact model at rest: it knows the pose exactly as the regressor does, and no velocity either.

    Raises:
        RacinesError: no frame with a pose and a force in one of the splits.
    """
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
        from racines_data.phantom import contact

        surface = phantom.block.maximum[2]
        predicted["contact"] = contact.wrench(pose, None, surface, phantom.contact)
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
    rmse, mae = error.square().mean(0).sqrt(), error.abs().mean(0)
    return {
        axis: {"rmse": float(rmse[i]), "mae": float(mae[i]), "n": len(error), "unit": unit}
        for i, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True))
    }


def forces_markdown(report: dict[str, Any]) -> str:
    """Return the report as a table: one row an axis, RMSE and MAE of each prediction."""
    errors = report["errors"]
    head = ["axis", *(f"{name} {kind.upper()}" for name in errors for kind in KINDS)]
    rows = [
        (f"{axis}, {unit}", *(f"{e[axis][kind]:.3f}" for e in errors.values() for kind in KINDS))
        for axis, unit in zip(AXES, UNITS, strict=True)
    ]
    return markdown_table(head, rows, right=1)
