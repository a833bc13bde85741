"""Two validation patients, still and beating; baked where an image is asked for."""

from pathlib import Path

import pytest

from racines_envs.worlds.ward import Ward, make_ward
from tests.envs.patients.eyes import save


@pytest.fixture(autouse=True)
def own_hearts(hearts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hearts are baked by the code under test, never read from a user's cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(hearts))


@pytest.fixture(scope="session")
def still() -> Ward:
    return make_ward("patients", "validation", 2)


@pytest.fixture(scope="session")
def beating() -> Ward:
    return make_ward("beating", "validation", 2)


@pytest.fixture(scope="session")
def servo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a servo's run of two trainings, to be read only."""
    folder = tmp_path_factory.mktemp("eyes") / "servo"
    save(folder, 0)
    save(folder / "seed-1", 1)
    return folder
