"""The documentation's tables of the tasks are what the code says."""

import dataclasses

import pytest

from racines_data.phantom import PhantomConfig, shared_phantom
from racines_envs.studies.task_table import task_table, task_tables
from racines_envs.task.tasks import TASKS, get_task
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "tasks.md"


@pytest.mark.parametrize("anatomy", ["heart", "abdomen"])
def test_the_page_holds_the_tables_of_the_code(anatomy):
    """To mend the page: python -m racines_envs.studies.task_table."""
    phantom = shared_phantom(PhantomConfig(anatomy=anatomy))
    tables = task_tables(anatomy, phantom)
    assert tables in PAGE.read_text()
    for task in TASKS.values():
        assert (f"| `{task.id}` |  |" in tables) == (task.anatomy == anatomy)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"step_rotation": 0.05}, "| unit steps | 3 mm, 0.05 rad |"),
        ({"termination": "first_hit"}, "| terminated | at the first hit |"),
        ({"force_limit": 15.0}, "| normal force | at most 15 N |"),
        ({"start_distance": (0.03, 0.05)}, "30 to 50 mm from there |"),
    ],
)
def test_a_change_of_a_task_shows_in_its_table(real_phantom, changes, line):
    task = get_task("SC")
    table = task_table(dataclasses.replace(task, **changes), real_phantom)
    assert line in table and line not in task_table(task, real_phantom)
