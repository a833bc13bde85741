"""Each example of docs/clients.md in its library's own environment, and how fast both sides are.

Left out of `make test`; without the environments, which `make test-clients` makes, it is skipped.
"""

import json

import pytest

from tests.clients.examples import EXAMPLES, ROOT, STEPS, TASKS, example, interpreter
from tests.clients.running import run_in

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(params=EXAMPLES)
def client(request: pytest.FixtureRequest) -> str:
    if not interpreter(request.param).exists():
        pytest.skip(f"no environment .venv-{request.param}: make test-clients makes it")
    return request.param


def test_the_example_trains_on_both_tasks(client: str):
    told = run_in(client, "-c", example(client))
    lines = [line.split() for line in told.splitlines() if line.startswith(("racines/", "SC"))]
    assert len(lines) == len(TASKS)
    assert [line[0].removeprefix("racines/").removesuffix("-v0") for line in lines] == [
        task.removeprefix("racines/").removesuffix("-v0") for task in TASKS
    ]
    if client != "gymnasium":
        assert all(int(line[1]) >= STEPS for line in lines)


def test_our_rows_are_faster_than_64_environments_of_the_librarys_own(client: str):
    told = json.loads(
        run_in(client, str(ROOT / "tests/clients/timing.py"), client).splitlines()[-1]
    )
    print(client, told)
    assert told["ratio"] > 1


def test_tianshous_rows_are_those_of_its_own_vector_environment():
    if not interpreter("tianshou").exists():
        pytest.skip("no environment .venv-tianshou: make test-clients makes it")
    script = str(ROOT / "tests/clients/tianshou_equal.py")
    assert run_in("tianshou", script).splitlines()[-1] == "equal"
