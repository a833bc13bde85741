# pyright: strict
"""The poses that a regressor should have read: of the base frame, or about patients' hearts."""

import torch
from torch import Tensor

from racines_data.geometry import parameters_to_pose, pose_to_parameters
from racines_data.store.frames import FrameStore
from racines_data.store.hearts import hearts_of, to_heart

FRAMES = "base", "heart"
"""What a pose is told in: the base frame, or that of the heart which is scanned."""


def parameters_in(frame: str, store: FrameStore, rows: Tensor) -> Tensor:
    """Return the (N, 12) float32 parameters of (N,) rows, their poses told in a frame.

    Raises:
        RacinesError: poses about hearts are asked for, and no patients are scanned, or it is not
            said where their hearts lie.
    """
    parameters = store.parameters[rows]
    if frame == "base":
        return parameters
    breath = None if store.phases is None else store.phases[rows, 1]
    pose = to_heart(parameters_to_pose(parameters.double()), hearts_of(store, rows), breath)
    return pose_to_parameters(pose, parameters[:, :6].double()).float()


def told_in(frame: str, store: FrameStore) -> FrameStore:
    """Return the store itself, or one of the same frames whose poses are told in a frame."""
    if frame == "base":
        return store
    return store.with_parameters(parameters_in(frame, store, torch.arange(len(store))))
