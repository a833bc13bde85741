"""From a folder to a world of its recorded frames."""

import dataclasses
from pathlib import Path

import torch

from racines_data.errors import RacinesError
from racines_data.store.frames import FrameStore, open_store
from racines_envs.worlds.recorded.frames import Frames, best_shown, read_frames
from racines_envs.worlds.recorded.settings import ALL, LABEL, POSE, ReplayConfig
from racines_envs.worlds.recorded.world import GOAL, Aim, Recordings
from racines_models.devices import resolve_device


def open_recordings(
    data: Path | str | FrameStore | None = None,
    view: str = "",
    config: ReplayConfig | None = None,
    device: torch.device | str = "cpu",
) -> Recordings:
    """Return the frames of a dataset as a world to look for a view, or for a goal frame, in.

    Args:
        data: The dataset's folder (data/racines by default), or its open store.
        view: One of the dataset's views; may be left out where there is a `goal`, or where its
            frames show one view alone.
        config: What can be chosen, the goal included.
        device: Where poses and, but on the CPU, images lie.

    Raises:
        RacinesError: no dataset, no poses, neither labels nor a goal, a goal that is not among the
            frames, a view that none of them shows, one frame alone, an unknown split or session, or
            a split without a start.
    """
    config = config or ReplayConfig()
    store = data if isinstance(data, FrameStore) else open_store(data)
    frames = read_frames(store, config, resolve_device(device))
    world = Recordings(frames, _aim(frames, view, config), config)
    _ = world.start_frames  # refused here, not at the first reset
    return world


def of_split(world: Recordings, split: str) -> Recordings:
    """Return the same recordings with starts, or frames, of another split."""
    config = dataclasses.replace(world.settings, split=split)
    frames, aim = world.frames, world.aim
    view = "" if aim.view == GOAL else aim.view
    if config.frames == ALL:  # the goal stays: it is not chosen anew among other frames
        goal = frames.name(aim.frame)
        config = dataclasses.replace(config, goal=goal, judged_by=aim.by)
    return open_recordings(frames.store, view, config, frames.rows.device)


def _aim(frames: Frames, view: str, config: ReplayConfig) -> Aim:
    """Return what is looked for, in these frames."""
    root, labels = frames.store.root, frames.store.labels
    if config.goal:
        frame = frames.find(config.goal)
        label = int(frames.views[frame])
        return _aim_of_frame(frames, frame, label, view, config)
    if frames.labelled_by == "nobody":
        raise RacinesError(
            f"{root}: its frames bear no view, and no goal is given: give replay.goal, as "
            f"{frames.name(len(frames) // 2)}, or labels: racines data annotate {root}"
        )
    shown = [labels[i] for i in frames.views.unique().tolist() if i < len(labels) - 1]
    if not shown:
        raise RacinesError(f"{root}: none of the frames replayed shows a view: give replay.goal")
    if not view:
        if len(shown) != 1:
            raise RacinesError(f"{root}: name the view: its frames show {', '.join(shown)}")
        view = shown[0]
    if view not in labels[:-1]:
        raise RacinesError(f"unknown view {view!r}: choose one of {', '.join(labels[:-1])}")
    frame = best_shown(frames.views, frames.grades, frames.pose, labels.index(view))
    if frame is None:
        raise RacinesError(
            f"{root}: none of the frames replayed shows {view}: choose one of {', '.join(shown)}"
        )
    return Aim(view, labels.index(view), frame, config.judged_by or LABEL)


def _aim_of_frame(frames: Frames, frame: int, label: int, view: str, config: ReplayConfig) -> Aim:
    """Return the aim of a goal frame: its pose, or its label where that is asked for."""
    labels, named = frames.store.labels, label < len(frames.store.labels) - 1
    if view and (not named or labels[label] != view):
        bears = labels[label] if named else "no view"
        raise RacinesError(f"goal {config.goal}: the frame bears {bears}, not {view}")
    if config.judged_by == LABEL:
        if not named:
            raise RacinesError(
                f"goal {config.goal}: the frame bears no view: leave replay.judged_by out, or use "
                "pose"
            )
        return Aim(labels[label], label, frame, LABEL)
    return Aim(view or GOAL, label if named else -1, frame, POSE)
