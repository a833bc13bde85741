"""Fixtures of the dataset's tests: caches of their own, and one small dataset for all."""

from pathlib import Path

import datasets
import pytest

from racines_data.build.dataset import DataConfig, build
from tests import warm
from tests.data.fake_source import FakeConfig, FakeSource


@pytest.fixture(autouse=True)
def own_caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("RACINES_DATA", raising=False)
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache" / "datasets")


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a dataset of 200 frames, 20 trajectories, 2 sessions; read only."""
    root = tmp_path_factory.mktemp("built") / "racines"
    with pytest.MonkeyPatch.context() as patch:
        warm.plain_pictures(patch.setattr)  # whichever test is the first to ask for it
        build(FakeSource(FakeConfig()), root, DataConfig(workers=1))
    return root
