"""Two validation patients, still and beating; baked where an image is asked for."""

import pytest

from racines_envs.worlds.ward import Ward, make_ward


@pytest.fixture(scope="session")
def still() -> Ward:
    return make_ward("patients", "validation", 2)


@pytest.fixture(scope="session")
def beating() -> Ward:
    return make_ward("beating", "validation", 2)
