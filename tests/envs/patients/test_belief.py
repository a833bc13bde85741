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
from racines_envs.agents.networks import Recurrence
from racines_envs.agents.onnx.policy import export_policy
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.policy import make_actor
from racines_envs.agents.rollout import rollout
from racines_envs.agents.training import seeded
from racines_envs.apis.torchrl_env import ScanEnv
from racines_envs.evaluation.agent_specs import check_view
from racines_envs.evaluation.trainings import find_trainings
from racines_envs.task.actions import IDLE
from racines_envs.task.core import PARAMS_SIZE
from racines_envs.task.tasks import PATIENT_TASKS
from racines_envs.worlds.making import make_core
from racines_models.networks.batching import in_fixed_batches
from tests.envs.patients.eyes import save

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


def sight(servo: Path, memory: bool = True, window: int = 1, recurrent: bool = False) -> Sight:
    return Sight(eyes_of(str(servo), 0, "cpu"), memory, window, recurrent)


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


def test_a_window_holds_the_last_looks_and_where_they_were(still, servo):
    """Beside each other, the oldest first; an episode begins with its first look alone."""
    window, size = 3, SIZE + PARAMS_SIZE
    core = core_of(still)
    single = sight(servo, memory=False).begin(core)
    looks = []

    def look(observation) -> None:
        looks.append(torch.cat([single.see(observation), observation["params"]], 1))

    look(core.reset(torch.arange(3) + 5))
    for step in range(3):
        look(core.step(torch.full((3,), step)).observation)
    core = core_of(still)
    seen = sight(servo, False, window).begin(core)
    told = steps_of(core, seen, 3)
    for step, each in enumerate(told):
        before = [looks[max(0, step - k)] for k in reversed(range(window))]
        assert torch.equal(each, torch.cat(before, 1)), step
    mask = torch.tensor([False, True, False])
    after = seen.see(core.reset(mask=mask), mask).view(3, window, size)
    assert torch.equal(after[[0, 2]].flatten(1), told[-1][[0, 2]]), "who goes on waits"
    assert torch.equal(after[1], after[1, :1].expand(window, -1)), "who begins forgets"


def test_a_recurrence_is_a_gru_and_a_row_ignores_its_batch():
    torch.manual_seed(0)
    ours, peer = Recurrence(11, 8), torch.nn.GRU(11, 8, batch_first=True)
    with torch.no_grad():
        for mine, theirs in ((ours.reads, "ih"), (ours.keeps, "hh")):
            getattr(peer, f"weight_{theirs}_l0").copy_(mine.weight)
            getattr(peer, f"bias_{theirs}_l0").copy_(mine.bias)
    looks = torch.randn(21, 6, 11)
    said = in_fixed_batches(ours, looks)
    assert torch.allclose(said, peer(looks)[1][0], atol=1e-6)
    for row in (0, 7, 20):
        assert torch.equal(in_fixed_batches(ours, looks[row : row + 1])[0], said[row])


@pytest.mark.contract
@pytest.mark.parametrize("window", [1, 3])
def test_a_row_is_told_of_itself_alone(still, servo, window):
    """To the last bit: the same episode among others and alone."""
    core = core_of(still, 5)
    whole = steps_of(core, sight(servo, window=window).begin(core), 3)
    for row in (0, 4):
        one = core_of(still, 1)
        seen = sight(servo, window=window).begin(one)
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


@pytest.mark.parametrize("recurrent", [False, True])
def test_a_policy_of_a_window_learns_is_saved_and_acts_again(
    servo, still, tmp_path, hearts, monkeypatch, recurrent
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(hearts))
    short = replace(PATIENT_TASKS["A4C-patients"], max_steps=10)
    monkeypatch.setitem(PATIENT_TASKS, "A4C-patients", short)
    config = tiny(servo, view="A4C-patients", memory=False, window=4, recurrent=recurrent)
    agent = PPOBeliefAgent.train(config, tmp_path, seed=0, progress=False)
    assert isinstance(agent.actor.features, Recurrence) is recurrent
    again = PPOBeliefAgent.load(tmp_path)
    core, acted = core_of(still, 5, "A4C-patients"), []
    for each in (agent, again):
        acted.append(torch.stack(rollout(core, each, torch.arange(5)).actions))
    assert torch.equal(*acted)
    one = core_of(still, 1, "A4C-patients")
    alone = torch.stack(rollout(one, again, torch.tensor([4])).actions)[:, 0]
    assert torch.equal(alone, acted[0][: len(alone), 4]), "to the last step as among others"


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
        ({"window": 0}, "give 1 to 200 looks"),
        ({"window": 201}, "give 1 to 200 looks"),
        ({"recurrent": True}, "2 or more to be recurrent"),
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
