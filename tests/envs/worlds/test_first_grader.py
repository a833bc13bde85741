"""The default reward's grader on a fresh clone: the published one, wherever one works."""

from pathlib import Path

import gymnasium
import pytest

import racines_envs  # noqa: F401  (registers the tasks)
from racines_data.errors import RacinesError
from racines_envs.task.tasks import get_task
from racines_envs.worlds.backends import GRADER_FILE, GRADER_FOLDER, make_grader, usual_grader
from racines_models.published import places


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder outside the checkout, where nothing has been trained."""
    monkeypatch.chdir(tmp_path)
    places._tell.cache_clear()
    return tmp_path


@pytest.mark.parametrize(
    "name",
    ["racines/SC-v0", pytest.param("racines/SC-patients-v0", marks=pytest.mark.thorough)],
)
def test_a_task_is_made_with_its_default_reward_and_says_once_whose_grader(
    elsewhere: Path, name: str, capsys: pytest.CaptureFixture[str]
):
    env = gymnasium.make(f"racines_envs:{name}")
    env.reset(seed=0)
    assert isinstance(env.step(0)[1], float)
    env.close()
    vector = gymnasium.make_vec(f"racines_envs:{name}", num_envs=2)
    vector.reset(seed=0)
    assert vector.step(vector.action_space.sample() * 0)[1].shape == (2,)
    vector.close()
    told = capsys.readouterr().err
    published = str(places.CHECKOUT / places.WEIGHTS / "grader")
    assert told.count(published) == (name == "racines/SC-v0"), "patients' reward is shaped"


def test_what_was_trained_here_stands_before_what_is_published(
    elsewhere: Path, capsys: pytest.CaptureFixture[str]
):
    task = get_task("SC")
    assert usual_grader(task) == places.CHECKOUT / places.WEIGHTS / "grader"
    nearer = elsewhere / places.WEIGHTS / "grader"
    nearer.mkdir(parents=True)
    (nearer / GRADER_FILE).touch()
    assert usual_grader(task) == places.WEIGHTS / "grader", "the current folder before the code's"
    capsys.readouterr()
    GRADER_FOLDER.mkdir(parents=True)
    (GRADER_FOLDER / GRADER_FILE).touch()
    assert usual_grader(task) == GRADER_FOLDER
    assert capsys.readouterr().err == "", "one's own grader needs no word"


def test_without_any_the_error_names_the_remedy(elsewhere: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(places, "CHECKOUT", elsewhere)
    with pytest.raises(RacinesError, match="racines train grader.*reward='oracle'"):
        make_grader(usual_grader(get_task("SC")), "cpu")
