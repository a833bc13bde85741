"""Phantoms shared by the tests of environments and agents."""

from dataclasses import replace

import pytest

from racines_data.phantom import Phantom, shared_phantom
from racines_envs.task.tasks import TASKS
from tests.envs.fakes import FakeGrader, FakePhantom


@pytest.fixture
def phantom() -> FakePhantom:
    return FakePhantom()


@pytest.fixture
def grader() -> FakeGrader:
    return FakeGrader()


@pytest.fixture
def short_episodes(monkeypatch) -> None:
    """Episodes of SC and PL end after thirty steps: for what does not ask how long they are."""
    for view in ("SC", "PL"):
        monkeypatch.setitem(TASKS, view, replace(TASKS[view], max_steps=30))


@pytest.fixture(scope="session")
def real_phantom() -> Phantom:
    return shared_phantom()
