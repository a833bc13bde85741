"""Fixtures of the dataset's tests: caches of their own, and one small dataset for all."""

from pathlib import Path

import datasets
import pytest
from matplotlib.figure import Figure

from racines_data.build.dataset import DataConfig, build
from racines_data.card import pictures as card_pictures
from tests.data.fake_source import FakeConfig, FakeSource


@pytest.fixture(autouse=True)
def own_caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("RACINES_DATA", raising=False)
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache" / "datasets")


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the pictures of cards empty: to draw them is nine tenths of a small build."""
    for kind in ("trajectories", "parameters", "shares", "samples", "hearts"):
        monkeypatch.setattr(card_pictures, f"{kind}_figure", lambda *_: Figure((0.1, 0.1)))
    monkeypatch.setattr(card_pictures, "encode", lambda figure, gray: b"blank")


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a dataset of 200 frames, 20 trajectories, 2 sessions; read only."""
    root = tmp_path_factory.mktemp("built") / "racines"
    build(FakeSource(FakeConfig()), root, DataConfig(workers=1))
    return root
