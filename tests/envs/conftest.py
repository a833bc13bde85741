"""Phantoms shared by the tests of environments and agents."""

import pytest

from racines_data.phantom import Phantom, shared_phantom
from tests.envs.fakes import FakeGrader, FakePhantom


@pytest.fixture
def phantom() -> FakePhantom:
    return FakePhantom()


@pytest.fixture
def grader() -> FakeGrader:
    return FakeGrader()


@pytest.fixture(scope="session")
def real_phantom() -> Phantom:
    return shared_phantom()
