"""The dataset by trajectory: filters, frames, and marks that lie where the frame does."""

import dataclasses
import io
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.schema import SPLITS
from racines_data.sources.rotation.source import RotationSource
from racines_data.store.frames import FrameStore
from racines_leaderboard.studio import browsing
from racines_leaderboard.studio.browsing import (
    figures_html,
    grades_figure,
    image_html,
    parameters_html,
    path_figure,
)
from tests.data.sources.rotation_folder import write_rotation


@pytest.fixture(scope="module")
def store(tiny_root: Path) -> FrameStore:
    return browsing.opened(tiny_root, "frames")


def test_every_trajectory_is_in_one_split_and_found_by_its_view(store: FrameStore):
    by_split = {split: browsing.trajectories(store, split, "all") for split in SPLITS}
    assert sorted(sum(by_split.values(), [])) == sorted(store.trajectories)
    for split, names in by_split.items():
        of_views = [browsing.trajectories(store, split, view) for view in store.labels]
        assert sorted(sum(of_views, [])) == sorted(names)
    sweep = browsing.trajectory(store, by_split["test"][0])
    assert sweep.split == "test" and sweep.frames > 1
    low, high = store.bounds("test")
    assert low <= sweep.rows.start and sweep.rows.stop <= high


def test_a_frame_shows_its_own_image_and_numbers(store: FrameStore):
    sweep = browsing.trajectory(store, store.trajectories[0])
    frame = browsing.frame_of(sweep, sweep.frames)
    assert frame == sweep.frames - 1
    x = 1e3 * float(store.parameters[sweep.rows.stop - 1, 6])
    angle = math.degrees(float(store.parameters[sweep.rows.stop - 1, 9]))
    shown = parameters_html(sweep, frame)
    assert f"<td>{x:.2f}</td>" in shown and f"<td>{angle:.2f}</td>" in shown
    assert image_html(sweep, 0) != image_html(sweep, frame)
    assert "simulated" in image_html(sweep, 0)
    assert figures_html(sweep, 0) != figures_html(sweep, frame)


def test_marks_lie_on_the_pictures(store: FrameStore):
    sweep = browsing.trajectory(store, store.trajectories[0])
    grades, path = grades_figure(sweep), path_figure(sweep)
    assert path is not None
    for marked in (grades, path):
        assert marked.png.startswith(b"\x89PNG")
        assert ((marked.places > 0) & (marked.places < 1)).all()
    assert (np.diff(grades.places[:, 0]) > 0).all(), "time goes to the right"
    # The dot is where the line is drawn: the picture has the view's colour there.
    picture = np.asarray(Image.open(io.BytesIO(path.png)).convert("RGB")).astype(int)
    height, width, _ = picture.shape
    hits = 0
    for x, y in path.places:
        column, row = int(x * width), int(y * height)
        patch = picture[row - 4 : row + 5, column - 4 : column + 5]
        hits += bool((patch.max(-1) - patch.min(-1) > 60).any())
    assert hits > 0.9 * sweep.frames


@pytest.mark.parametrize("frame", [0, 10**6, 1.5, math.nan, "1", None, True])
def test_frames_beyond_the_trajectory_are_refused(store: FrameStore, frame):
    sweep = browsing.trajectory(store, store.trajectories[0])
    with pytest.raises(RacinesError, match="frame"):
        browsing.frame_of(sweep, frame)


def test_unknown_names_are_refused(store: FrameStore, tiny_root: Path):
    for call in (
        lambda: browsing.trajectory(store, "<script>"),
        lambda: browsing.trajectories(store, "all", "all"),
        lambda: browsing.trajectories(store, "test", "nothing"),
        lambda: browsing.opened(tiny_root, "../frames"),
        lambda: browsing.opened(None, "frames"),
    ):
        with pytest.raises(RacinesError, match="was not offered"):
            call()


def test_data_without_poses_have_no_path(store: FrameStore):
    class Without:
        def __init__(self) -> None:
            self.__dict__.update(store.__dict__)
            self.parameters = store.parameters.clone()
            self.parameters[:, 6:] = math.nan

    sweep = browsing.trajectory(store, store.trajectories[0])
    blind = dataclasses.replace(sweep, store=Without())  # pyright: ignore
    assert path_figure(blind) is None
    assert figures_html(blind, 0).count("<img") == 1
    assert "–" in parameters_html(blind, 0)


def test_turns_tell_the_beat_and_the_angle_but_no_breath(tmp_path: Path):
    folder = write_rotation(tmp_path / "heart", turns=24)
    build(
        RotationSource.from_config({}, [folder]),
        tmp_path / "turns",
        DataConfig(workers=1, shards=1),
    )
    store = browsing.opened(tmp_path / "turns", "frames")
    shown = image_html(browsing.trajectory(store, store.trajectories[0]), 0)
    assert "beat 0.00" in shown and "° from the nearest training turn" in shown
    assert "breath" not in shown and "nan" not in shown
    facts = browsing.facts_html(browsing.trajectory(store, store.trajectories[0]))
    assert "nan" not in facts
