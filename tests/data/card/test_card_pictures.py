"""The pictures of a card: the same bytes each time, small, and only of what there is."""

import dataclasses
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from PIL import Image

from racines_data.build.dataset import DataConfig, build
from racines_data.card.frames import read_frames
from racines_data.card.pictures import samples_figure, write_pictures
from racines_data.manifest import read_manifest, store_name
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.validate.run import validate
from tests.data.fake_source import FakeConfig, FakeSource

pytestmark = pytest.mark.usefixtures("drawn_pictures")


@pytest.fixture(scope="module")
def shown(drawn_pictures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of `built`, with its pictures."""
    root = tmp_path_factory.mktemp("shown") / "racines"
    build(FakeSource(FakeConfig()), root, DataConfig(workers=1))
    return root


def pictures(root: Path) -> dict[str, bytes]:
    return {path.stem: path.read_bytes() for path in (root / "card").glob("*.png")}


def draw_again(root: Path, folder: Path) -> tuple[dict[str, bytes], dict[str, Any]]:
    folder.mkdir()
    (folder / "store").symlink_to(root / "store")
    manifest = {k: v for k, v in read_manifest(root).items() if k not in ("pictures", "statistics")}
    write_pictures(folder, manifest)
    return pictures(folder), manifest


def test_two_draws_give_equal_bytes_whatever_the_users_style(shown: Path, tmp_path: Path):
    first = pictures(shown)
    assert set(first) == {"parameters", "samples", "shares", "trajectories"}
    with matplotlib.rc_context({"font.size": 20, "axes.grid": True, "lines.linewidth": 9}):
        second, manifest = draw_again(shown, tmp_path / "b")
        assert matplotlib.rcParams["font.size"] == 20
    assert second == first
    assert manifest["statistics"] == read_manifest(shown)["statistics"]


def test_pictures_are_small_and_hold_nothing_but_pixels(shown: Path):
    assert sum(map(len, pictures(shown).values())) < 2_000_000
    for path in (shown / "card").glob("*.png"):
        with Image.open(path) as image:
            assert image.width <= 1200 and not image.info.keys() & {"Software", "date:create"}


class Bare(FakeSource):
    """Neither forces nor labels: a tracked sweep."""

    name = "tracked"

    def produce(self, unit: Unit) -> Trajectory:
        made = super().produce(unit)
        made.parameters[:, :6] = np.nan
        unknown = np.full(len(made), -1)
        grades = np.full(len(made), np.nan, np.float32)
        return dataclasses.replace(made, views=unknown, grades=grades)


class Still(FakeSource):
    """Labels and grades without poses and times: CACTUS."""

    name = "cactus"
    poses = False

    def produce(self, unit: Unit) -> Trajectory:
        made = super().produce(unit)
        made.parameters[:] = np.nan
        return dataclasses.replace(made, timestamps=np.full(len(made), np.nan))


class Organ(FakeSource):
    """Another organ's views."""

    labels = ("RK", "LIVER", "GB", "Random")

    def produce(self, unit: Unit) -> Trajectory:
        made = super().produce(unit)
        return dataclasses.replace(made, views=np.minimum(made.views, 3), target_view="RK")

    def plan(self) -> list[Unit]:
        return [dataclasses.replace(unit, target_view="RK") for unit in super().plan()]


@pytest.mark.parametrize(
    ("source", "drawn"),
    [
        (Bare, {"samples", "parameters", "trajectories"}),
        (Still, {"samples", "shares"}),
        (Organ, {"samples", "parameters", "shares", "trajectories"}),
    ],
)
def test_only_what_there_is_is_drawn(source, drawn: set[str], tmp_path: Path):
    root = tmp_path / "racines"
    manifest = build(source(FakeConfig(frames=60, trajectories=6)), root, DataConfig(workers=1))
    assert set(manifest["pictures"]) == set(pictures(root)) == drawn
    card = (root / "README.md").read_text()
    assert ("## Statistics" in card) == ("parameters" in drawn)
    assert ("## Classes and grades" in card) == ("shares" in drawn)
    assert "CACTUS |" not in card or source is Still
    assert ("rotation (degrees)" in card) == ("parameters" in drawn)
    assert ("from the best grade" in card) == (source is not Bare)
    assert validate(root).manifest == manifest


def test_unmeasured_parameters_are_left_out(tmp_path: Path):
    root = tmp_path / "racines"
    manifest = build(Bare(FakeConfig(frames=40, trajectories=4)), root, DataConfig(workers=1))
    names = set(manifest["statistics"]["parameters"])
    assert names == {f"{kind}_{axis}" for kind in ("position", "rotation") for axis in "xyz"}


class Hearts(FakeSource):
    """Every trajectory is of the heart that its session is."""

    def produce(self, unit: Unit) -> Trajectory:
        made = super().produce(unit)
        grades = np.arange(len(made)).astype(np.float32)
        views = np.zeros(len(made), np.int64)
        return dataclasses.replace(made, views=views, grades=grades, phantom=int(unit.session[1:]))


def test_a_heart_is_shown_by_its_best_frame(tmp_path: Path):
    root = tmp_path / "racines"
    many = Hearts(FakeConfig(frames=48, trajectories=12, sessions=6, seed=7))
    build(FakeSource(FakeConfig()), root, DataConfig(workers=1), many=many)
    manifest = read_manifest(root)
    assert "hearts" in manifest["pictures"]
    card = (root / "README.md").read_text()
    assert "(card/hearts.png)" in card and "6 other simulated hearts" in card
    with Image.open(root / "card" / "hearts.png") as image:
        columns = image.width / 1.25 / 110
    assert round(columns) == 6


def test_samples_go_down_the_grades(built: Path):
    frames = read_frames(built / store_name("frames"), read_manifest(built))
    rows = frames.views == 0
    grades = frames.grades.copy()
    grades[rows] = np.linspace(1, 10, rows.sum())
    figure = samples_figure(dataclasses.replace(frames, grades=grades))
    told = [text.get_text() for text in figure.axes[0].texts]
    graded = [float(text.split()[1]) for text in told if text.startswith("grade")][:6]
    assert graded[0] == 10.0 and graded[-1] == 1.0 and graded == sorted(graded, reverse=True)
