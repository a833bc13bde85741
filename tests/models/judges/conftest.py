"""One grader for the tests of graders and of students, its store and what its training told."""

import pytest

from racines_models.judges.grader.training import train_grader
from tests.models.judges.test_grader import CONFIG, run
from tests.models.labelled import LabelledStore


@pytest.fixture(scope="session")
def labelled():
    return LabelledStore(trajectories=30, length=12)


@pytest.fixture(scope="session")
def taught(labelled, tmp_path_factory):
    """The folder of a trained grader, to be read only, and what its training told."""
    folder = tmp_path_factory.mktemp("grader")
    return folder, train_grader(labelled, CONFIG, run(folder))
