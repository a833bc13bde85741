"""One Ray of two workers for all tests of engines; it starts once a test process."""

import os
from collections.abc import Iterator

import pytest

from racines_data.engines.ray import RayEngine

STORE = 100 << 20
"""Bytes of its object store."""


@pytest.fixture(scope="session")
def cluster() -> Iterator[None]:
    import ray

    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_DEDUP_LOGS": "0"}
    # A token in the user's home, if there is one, is no concern of tests and their commands.
    os.environ["RAY_AUTH_MODE"] = "disabled"
    ray.init(
        "local", num_cpus=2, object_store_memory=STORE, include_dashboard=False,
        log_to_driver=False, logging_level="ERROR",
        # Beside the other tests, workers as polite as Ray makes them would hardly run.
        _system_config={"worker_niceness": 0},
    )  # fmt: skip
    yield
    ray.shutdown()


@pytest.fixture
def engine(cluster: None) -> Iterator[RayEngine]:
    with RayEngine() as opened:
        yield opened
