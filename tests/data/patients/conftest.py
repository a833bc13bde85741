from pathlib import Path

import pytest

from racines_data.patients import Pool

SEEDS = (10_000, 10_008, 10_039)
"""A healthy, a dilated and a hypertrophied patient of validation."""


@pytest.fixture(scope="session", autouse=True)
def own_cache(hearts: Path) -> object:
    """Hearts are baked by the code under test, never read from a user's cache."""
    patch = pytest.MonkeyPatch()
    patch.setenv("XDG_CACHE_HOME", str(hearts))
    yield
    patch.undo()


@pytest.fixture(scope="session")
def pool(own_cache: object) -> Pool:
    return Pool(SEEDS, beating=True)
