"""PPO on a servo's belief: what it is told of an episode, what it learns from, and for whom."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.views import VIEWS
from racines_envs.agents.belief.agent import PPOBeliefAgent, PPOBeliefConfig
from racines_envs.agents.belief.agent import _Training as Training
from racines_envs.agents.belief.sight import SIZE, Sight
from racines_envs.agents.belief.transform import TAUGHT, seen_through
from racines_envs.agents.memory.eyes import eyes_of
from racines_envs.agents.onnx.policy import export_policy
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.policy import make_actor
from racines_envs.agents.training import seeded
from racines_envs.apis.torchrl_env import ScanEnv
from racines_envs.evaluation.agent_specs import check_view
from racines_envs.evaluation.trainings import find_trainings
from racines_envs.task.actions import IDLE
from racines_envs.task.tasks import PATIENT_TASKS
from racines_envs.worlds.making import make_core
from tests.envs.patients.test_memory import save

GOAL = slice(SIZE - len(VIEWS), SIZE)
STEPS, BEST = SIZE - len(VIEWS) - 2, slice(SIZE - len(VIEWS) - 9, SIZE - len(VIEWS) - 3)
"""Where the numbers say the goal, the steps so far, and the way to the best pose passed."""


@pytest.fixture(scope="module")
def servo(tmp_path_factory) -> Path:
    """Return a servo's run of two trainings, which have learned nothing."""
    folder = tmp_path_factory.mktemp("servo")
    save(folder, 0)
    save(folder / "seed-1", 1)
    return folder


def core_of(ward, rows: int = 3, view: str = "AnyView-patients"):
    return make_core(view, rows, observation="multimodal", phantom=ward)


def sight(servo: Path, memory: bool = True) -> Sight:
    return Sight(eyes_of(str(servo), 0, "cpu"), memory)


def steps_of(core, seen, count: int) -> list[torch.Tensor]:
    """Return what is told at reset and after each of so many steps, all rows alike."""
    told = [seen.see(core.reset(torch.arange(core.num_envs) + 5))]
    for step in range(count):
        action = torch.full((core.num_envs,), step % IDLE)
        told.append(seen.see(core.step(action).observation))
    return told


def test_what_is_told_adds_up_over_an_episode(still, servo):
    core = core_of(still)
    told = steps_of(core, sight(servo).begin(core), 4)
    assert all(each.shape == (3, SIZE) and each.isfinite().all() for each in told)
    assert torch.equal(told[-1][:, GOAL].argmax(1), core.state.goal)
    assert told[-1][:, STEPS].tolist() == pytest.approx([4 / core.task.max_steps] * 3)
    core = core_of(still)
    alone = steps_of(core, sight(servo, memory=False).begin(core), 4)
    assert torch.equal(told[0][:, :18], alone[0][:, :18]), "nothing has been seen before"
    assert not torch.allclose(told[-1][:, :18], alone[-1][:, :18], atol=1e-3)
    assert not alone[-1][:, BEST].any() and told[-1][:, BEST].abs().max() > 0.0


@pytest.mark.contract
def test_a_row_is_told_of_itself_alone(still, servo):
    """To the last bit: the same episode among others and alone."""
    core = core_of(still, 5)
    whole = steps_of(core, sight(servo).begin(core), 3)
    for row in (0, 4):
        one = core_of(still, 1)
        seen = sight(servo).begin(one)
        told = [seen.see(one.reset(torch.tensor([row + 5])))]
        told += [seen.see(one.step(torch.tensor([step])).observation) for step in range(3)]
        for ours, theirs in zip(whole, told, strict=True):
            assert torch.equal(ours[row], theirs[0])


def test_an_episode_forgets_the_one_before(still, servo):
    """Rows that begin anew are told what a first look tells; the others stay as they were."""
    core = core_of(still)
    seen = sight(servo).begin(core)
    before = steps_of(core, seen, 3)[-1]
    mask = torch.tensor([False, True, False])
    after = seen.see(core.reset(mask=mask), mask)
    assert torch.equal(after[~mask], before[~mask]) and not torch.equal(after[1], before[1])
    other = core_of(still)
    other.reset(torch.arange(3) + 5)
    fresh = sight(servo).begin(other).see(other.reset(mask=mask))
    assert torch.equal(after[1], fresh[1])


def test_torchrl_is_told_the_same(still, servo):
    """The environment that it learns in, with rows that end and begin, and without images."""
    env = seen_through(
        ScanEnv("AnyView-patients", 2, observation="multimodal", phantom=still), sight(servo)
    )
    env.set_seed(5)
    seen = env.reset()
    core = core_of(still, 2)
    told = sight(servo).begin(core)
    assert torch.equal(seen["features"], told.see(core.reset(torch.arange(2) + 5)))
    assert seen.get("image", None) is None
    for step in range(5):  # row 0 declares by idling, row 1 goes on
        action = torch.tensor([IDLE, step])
        stepped, seen = env.step_and_maybe_reset(seen.set("action", action))
        said = told.see(core.step(action).observation)
        assert torch.equal(stepped["next", "features"], said)
        if bool(core.state.done.any()):
            ended = core.state.done.clone()
            said = told.see(core.reset(mask=ended), ended)
        assert torch.equal(seen["features"], said)
    assert core.state.steps.tolist() == [2, 5]


def tiny(servo: Path, **change) -> PPOBeliefConfig:
    """Return settings of a training of seconds: as many lessons as steps by reward."""
    return PPOBeliefConfig(
        members=str(servo), patients=1, frames=64, imitate=32, envs=8, update_every=32, epochs=1,
        minibatch=16, validation_starts=2, validate_every=64, hidden=(16, 16), **change,
    )  # fmt: skip


@pytest.fixture(scope="module")
def trained(servo, tmp_path_factory, hearts):
    folder = tmp_path_factory.mktemp("belief")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(hearts))
        # Episodes of its validation end sooner: who has learned nothing would use all steps.
        short = replace(PATIENT_TASKS["AnyView-patients"], max_steps=30)
        patch.setitem(PATIENT_TASKS, "AnyView-patients", short)
        agent = PPOBeliefAgent.train(tiny(servo), folder, seed=0, progress=False)
        PPOBeliefAgent.train(tiny(servo), folder / "seed-1", seed=1, progress=False)
    return agent, folder


def test_trainings_count_together_though_each_sees_through_another_servo(trained):
    found = find_trainings(trained[1])
    assert [each.seed for each in found] == [0, 1]
    one, two = (PPOBeliefAgent.load(each.folder).sight.sha256 for each in found)
    assert one != two


def test_lessons_are_the_planners_and_are_learned(servo, tmp_path):
    """What it is taught in a state is what the planner does there; more lessons, fewer errors."""
    run = Training(PPOBeliefAgent, tiny(servo), tmp_path, 0, None, None, False)
    with seeded(0, 1):
        run._build()
        seen = run.env.set_seed(3) and run.env.reset()
        planner = PlannerAgent()
        planner.attach(run.env.base_env.core)
        assert torch.equal(seen[TAUGHT], planner.act({}, torch.empty(0)))
        batch = next(iter(run._experience()))
        taught = [run._imitate(batch.clone())["update/taught"] for _ in range(40)]
    assert taught[-1] < 0.9 * taught[0]
    assert len(run.lessons) == 40 and run.lessons[0].batch_size == (32,)
    assert TAUGHT not in run.actor.keys, "it is never shown what it is taught"


def test_what_is_learned_is_saved_and_acts_again(trained, still):
    agent, folder = trained
    again = PPOBeliefAgent.load(folder)
    assert again.sight.sha256 == agent.sight.sha256
    acted = []
    for each in (agent, again):
        core = core_of(still, 2, "SC-patients")
        each.attach(core)
        seen, actions = core.reset(torch.tensor([3, 4])), []
        for _ in range(6):
            actions.append(each.act(seen, core.decision_seeds()))
            seen = core.step(actions[-1]).observation
        acted.append(torch.stack(actions))
    assert torch.equal(*acted)


def test_one_policy_is_for_all_views_of_patients(trained):
    agent, folder = trained
    for view in ("A4C-patients", "AnyView-patients", "PL-beating"):
        check_view(agent, view, "ppo-belief", folder)
    with pytest.raises(RacinesError, match="trained for AnyView-patients"):
        check_view(agent, "A4C", "ppo-belief", folder)


def test_it_sees_through_the_servo_that_it_learned_with(trained, servo, tmp_path):
    """Whose weights are gone is named, and not replaced by another training's."""
    _, folder = trained
    config = (folder / "config.json").read_text().replace(str(servo), str(tmp_path))
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("policy.safetensors", "metrics.json"):
        (moved / name).write_bytes((folder / name).read_bytes())
    (moved / "config.json").write_text(config)
    save(tmp_path, 0, drawn=77)
    with pytest.raises(RacinesError, match="sees through a servo whose weights have the sha256"):
        PPOBeliefAgent.load(moved)


def test_a_memory_is_no_onnx_file(trained, tmp_path):
    with pytest.raises(RacinesError, match="ppo-belief remembers .* record a trace"):
        export_policy(trained[0], tmp_path / "policy.onnx")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"view": "A4C"}, "A4C has one heart"),
        ({"observation": "params"}, "sees image and pose through a servo"),
        ({"encoder": "explored"}, "leave observation, encoder and backend out"),
        ({"collectors": 2}, "give 1"),
        ({"imitate": 10**6}, "give 0 to frames"),
        ({"first": 10**6}, "there are"),
    ],
)
def test_settings_that_do_not_fit_are_refused(change, words):
    with pytest.raises(RacinesError, match=words):
        replace(PPOBeliefConfig(), **change)


def test_its_network_reads_what_it_is_told(servo):
    actor = make_actor(PPOBeliefConfig(), sight(servo))
    assert actor.keys == ["features", "params"]
    assert actor(torch.zeros(2, SIZE), torch.zeros(2, 9)).shape == (2, IDLE + 1)
