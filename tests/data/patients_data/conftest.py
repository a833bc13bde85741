"""One dataset with patients, built once: three of them, still and beating, beside a phantom's."""

from pathlib import Path

import pytest

from racines_data.build.dataset import DataConfig, build
from racines_data.sources.patients import BeatingSource, PatientsSource
from tests import warm
from tests.conftest import Once
from tests.data.fake_source import FakeConfig, FakeSource

SETTINGS = {"train": 1, "validation": 1, "test": [20_000], "frames_per_sweep": 4}
SEEDS = {"train": 1, "validation": 10_000, "test": 20_000}
ONE = DataConfig(workers=1, shards=2)


@pytest.fixture(autouse=True)
def own_hearts(own_caches: None, hearts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(hearts))


@pytest.fixture(scope="session")
def root(made_once: Once, hearts: Path) -> Path:
    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_CACHE_HOME", str(hearts))
            warm.plain_pictures(patch.setattr)
            build(FakeSource(FakeConfig()), folder / "racines", ONE)
            for kind in (BeatingSource, PatientsSource):  # the order does not matter
                build(kind.from_config(SETTINGS), folder / "racines", ONE)

    return made_once("patients", make) / "racines"
