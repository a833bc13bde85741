"""Tasks on patients: rows are independent, agents declare, starts tell nothing, misuse is named."""

import functools

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.views import VIEWS
from racines_envs.task.actions import IDLE
from racines_envs.task.names import GOALS, task_id
from racines_envs.task.rewards import RewardConfig, Score, paper
from racines_envs.task.tasks import PATIENT_TASKS, get_task
from racines_envs.task.tiers import middles
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import Ward, make_ward
from racines_models.judges.grader.model import Grader


def core_of(ward, view="A4C", count=1, observation="params", **more):
    tier = "beating" if ward.pool.beating else "patients"
    return make_core(f"{view}-{tier}", count, observation=observation, phantom=ward, **more)


def test_the_papers_reward_asks_the_grader_of_patients(beating, tmp_path, monkeypatch):
    core = core_of(beating, "AnyView", 2, reward="paper")
    assert core.grader.sha256 == Grader.load("models/weights/phantom-patients/grader").sha256
    core.reset(0)
    before = core.grader.probabilities_and_grade(core.picture())
    paid = core.step(torch.tensor([4, 7])).reward
    after = core.grader.probabilities_and_grade(core.picture())
    own = [
        Score(p.gather(1, core.state.goal[:, None])[:, 0], g, torch.zeros(2))
        for p, g in (before, after)
    ]
    assert torch.equal(paid, paper(*own, torch.zeros(2, dtype=torch.bool), RewardConfig()))
    hearts = make_core("A4C", observation="params", reward="paper").grader
    assert hearts.sha256 != core.grader.sha256
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("racines_models.published.places.CHECKOUT", tmp_path)
    with pytest.raises(RacinesError, match="train grader --out models/runs/grader-patients"):
        core_of(beating, reward="paper")


def nominal_start(core):
    """Start all rows at their own nominal poses."""
    core.reset(0)
    target = core.target
    case = core.state.case
    return core.reset(0, pose=Pose(*target), case=case)


@pytest.mark.parametrize("observation, steps", [("params", 40), ("multimodal", 3)])
def test_a_batch_equals_single_environments(beating, observation, steps):
    together = core_of(beating, "AnyView", 3, observation)
    alone = [core_of(beating, "AnyView", 1, observation) for _ in range(3)]
    first = together.reset(5)
    for row, core in enumerate(alone):
        seen = core.reset(5 + row)
        assert all(torch.equal(seen[k][0], first[k][row]) for k in first)
    draw = torch.Generator().manual_seed(0)
    for _ in range(steps):
        action = torch.randint(0, 13, (3,), generator=draw)
        batch, info = together.step(action, autoreset=True), together.info(view_error=False)
        for row, core in enumerate(alone):
            single = core.step(action[row : row + 1], autoreset=True)
            for key, value in single.observation.items():
                assert torch.equal(value[0], batch.observation[key][row]), key
            for ours, theirs in zip(single[1:], batch[1:], strict=True):
                assert torch.equal(ours[0], theirs[row])
            for key, value in core.info(view_error=False).items():
                assert torch.equal(value[0], info[key][row]), key


def test_a_patient_is_the_same_in_another_pool(still):
    other = make_ward("patients", "validation", [still.pool.seeds[1]])
    infos = []
    for ward, case in ((still, 1), (other, 0)):
        core = core_of(ward, count=2)
        core.reset(3, case=torch.tensor([case, case]))
        for _ in range(5):
            core.step(torch.tensor([4, 7]))
        infos.append(core.info())
    for key, value in infos[0].items():
        assert torch.equal(value, infos[1][key]), key


def test_the_image_moves_with_time_and_with_nothing_else(beating):
    core = core_of(beating, observation="image")
    first = core.reset(1)["image"].clone()
    again = core.reset(1)["image"]
    assert torch.equal(first, again)
    assert not torch.equal(core.step(torch.tensor([IDLE])).observation["image"], first)
    assert set(core.observe()) == {"image"}  # the phase is never observed


def test_three_idle_steps_declare_and_two_do_not(still):
    core = core_of(still)
    core.reset(0)
    for action in (IDLE, IDLE, 0, IDLE, IDLE):
        assert not core.step(torch.tensor([action])).terminated
    last = core.step(torch.tensor([IDLE]))
    info = core.info()
    assert last.terminated and info["declared"] and not info["success"]
    assert info["seconds"].item() == pytest.approx(0.6)
    assert last.reward < 1.0  # a false declaration wins nothing


def test_a_refused_step_declares_nothing(still):
    core = core_of(still)
    start = core.reset(0)
    inward = [4] * 12  # into the skin until the force limit refuses
    assert not any(bool(core.step(torch.tensor([a])).terminated) for a in inward)
    assert core.state.force_hits > 3 and start is not None


def test_who_declares_at_the_view_succeeds_and_is_paid(still, beating):
    for ward in (still, beating):
        core = core_of(ward, count=4)
        nominal_start(core)
        steps = [core.step(torch.full((4,), IDLE)) for _ in range(3)]
        info = core.info()
        assert bool(steps[-1].terminated.all() & info["success"].all() & info["reached"].all())
        assert bool((steps[-1].reward > RewardConfig().hit - 1.0).all())


def test_an_episode_without_a_word_is_cut(still):
    core = core_of(still)
    core.reset(0)
    ends = [core.step(torch.tensor([i % 2])) for i in range(200)]
    assert ends[-1].truncated and not any(bool(each.terminated) for each in ends)
    assert not core.info()["declared"]


@pytest.mark.parametrize("view", VIEWS)
def test_starts_tell_nothing_of_the_patient(still, view):
    core, count = core_of(still, view, 200), 200
    starts = []
    for patient in (0, 1):
        core.reset(torch.arange(count), case=torch.full((count,), patient))
        pose = core.state.pose
        assert bool(still.workspace.contains(pose).all() & ~core.info(False)["success"].any())
        starts.append(pose.position)
    same = (starts[0] == starts[1]).all(1)
    assert same.double().mean() > 0.9  # the others would have shown the view already
    away = (starts[0] - middles(core.state.goal).position)[:, :2].norm(dim=-1)
    low, high = core.task.start_distance
    assert float(away.min()) >= low - 1e-6 and float(away.max()) <= high + 1e-6


def test_goals_are_drawn_for_each_episode_and_observed(still):
    core = core_of(still, "AnyView", 64)
    goal = core.reset(0)["goal"]
    assert goal.sum(1).eq(1).all() and goal.amax(0).eq(1).all()
    assert torch.equal(goal.argmax(1), core.state.goal)


@pytest.mark.parametrize("name", ["SC-patients", "AnyView-beating"])
def test_check_env_passes(still, beating, name):
    ward = beating if name.endswith("beating") else still
    make = {"phantom": ward, "observation": "params"}
    check_env(gymnasium.make(f"racines_envs:racines/{name}-v0", **make).unwrapped)
    env = gymnasium.make_vec(f"racines_envs:racines/{name}-v0", num_envs=2, **make)
    patients = list(ward.pool.seeds)
    _, info = env.reset(seed=0, options={"patient": patients})
    assert info["seconds"].tolist() == [0.0, 0.0]


def test_torchrl_keeps_its_specs(beating):
    from torchrl.envs.utils import check_env_specs

    from racines_envs import ScanEnv

    check_env_specs(ScanEnv("AnyView-beating", 2, phantom=beating, observation="params"))


def test_all_tasks_are_registered():
    for tier in ("patients", "beating"):
        for view in GOALS:
            assert task_id(view, tier=tier) in gymnasium.registry
    assert len(PATIENT_TASKS) == 2 * len(GOALS)


def test_the_one_heart_is_told_as_ever():
    told = get_task("SC").definition
    assert "tier" not in told and told["termination"] == "k_hits"
    assert get_task("SC-patients").definition["termination"] == "declared"


@pytest.mark.parametrize(
    "view, more, words",
    [
        ("A4C-patients", {"split": "all"}, "unknown split 'all'"),
        ("A4C-patients", {"split": "validation", "patients": [20_000]}, "of test, not of valid"),
        ("A4C-patients", {"patients": 200}, "100 fit"),
        ("A4C-patients", {"split": "test", "patients": 141}, "1 to 140"),
        ("A4C-patients", {"backend": "generator"}, "knows no patients"),
        ("A4C", {"split": "test"}, "use A4C-patients"),
        ("A4C-nobody", {}, "unknown view"),
    ],
)
def test_misuse_is_named(view, more, words):
    with pytest.raises(RacinesError, match=words):
        make_core(view, observation="params", reward="oracle", **more)


def test_a_patient_who_is_not_there_is_named(still: Ward):
    env = gymnasium.make("racines_envs:racines/SC-patients-v0", phantom=still, observation="params")
    with pytest.raises(RacinesError, match="patient 3 is not in the pool"):
        env.reset(seed=0, options={"patient": 3})


@pytest.mark.parametrize("mode", AutoresetMode)
def test_rows_of_patients_begin_anew_as_gymnasiums_own_do(still, mode):
    settings = {"phantom": still, "observation": "params", "reward": "shaped"}
    name = "racines_envs:racines/SC-patients-v0"
    ours = gymnasium.make_vec(name, num_envs=2, autoreset_mode=mode, **settings)
    single = functools.partial(gymnasium.make, name, **settings)
    theirs = SyncVectorEnv([single] * 2, autoreset_mode=mode)
    a, b = ours.reset(seed=3), theirs.reset(seed=3)
    rng, ended = np.random.default_rng(0), 0
    for _ in range(25):
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(a[-1]["seconds"], b[-1]["seconds"])
        action = np.where(rng.random(2) < 0.7, 12, rng.integers(12, size=2))  # 12 declares
        a, b = ours.step(action), theirs.step(action)
        for mine, others in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(mine, others)
        done = a[2] | a[3]
        ended += int(done.sum())
        if mode is AutoresetMode.DISABLED and done.any():
            masks = ({"reset_mask": done.copy()} for _ in range(2))
            a, b = (env.reset(options=next(masks)) for env in (ours, theirs))
    assert ended >= 4
