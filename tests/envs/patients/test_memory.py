"""The servo with a memory: what it looks back on, learns from, and where it goes."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    geodesic,
    matmul3,
    orthonormalise,
    rotation_vector,
)
from racines_data.views import VIEWS
from racines_envs.agents.memory import agent as module
from racines_envs.agents.memory import episodes, rounds
from racines_envs.agents.memory.agent import CHOOSE, ServoMemoryAgent
from racines_envs.agents.memory.episodes import EpisodeConfig, Episodes, act_on
from racines_envs.agents.memory.eyes import eyes_like, eyes_of
from racines_envs.agents.memory.lead import (
    ABOUT,
    BELIEVED,
    BEST,
    CHOICE,
    CHOICES,
    Legs,
    best_of,
)
from racines_envs.agents.memory.learner import MemoryConfig, MemoryLearner
from racines_envs.agents.memory.notes import LONGEST, Notes, lies, pose_at
from racines_envs.agents.rollout import rollout
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.belief import BOUNDS, Belief
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.task.tiers import middles
from racines_envs.worlds.making import make_core
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.recall import FEATURES, LIES, TOKEN, RecallNetwork
from racines_models.networks.servo import ServoNetwork
from racines_models.weights import save_weights
from tests.variants import first_of


def network(seed: int = 0) -> RecallNetwork:
    """Return one whose every layer says something."""
    torch.manual_seed(seed)
    made = RecallNetwork(len(VIEWS))
    with torch.no_grad():
        for weights in made.parameters():
            weights += 0.05 * torch.randn_like(weights)
    return made.eval()


def some(count: int, length: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return tokens, of which the last few are not there, and labels."""
    draw = torch.Generator().manual_seed(seed)
    tokens = torch.randn(count, length, TOKEN, generator=draw)
    ends = torch.randint(length // 2, length, (count, 1), generator=draw)
    return tokens, torch.arange(length) < ends, torch.arange(count) % len(VIEWS)


@torch.no_grad()
def test_it_knows_nothing_of_what_comes_later_or_is_not_there():
    made, (tokens, seen, labels) = network(), some(4, 20)
    first = made(tokens, seen, labels)
    other = torch.randn(4, 20, TOKEN)
    later = torch.where((torch.arange(20) > 8)[:, None], other, tokens)
    again = made(later, seen, labels)
    for one, two in zip(first, again, strict=True):
        assert torch.allclose(one[:, :9], two[:, :9], atol=1e-6)
        assert not torch.allclose(one[:, 9:], two[:, 9:], atol=1e-3)
    absent = torch.where(seen.unsqueeze(-1), tokens, other)
    ours, theirs = (made.recall(each, seen, labels) for each in (tokens, absent))
    for one, two in zip(ours, theirs, strict=True):
        assert torch.allclose(one, two, atol=1e-6)
    assert bool(torch.isinf(ours[1][~seen]).all()) and bool(ours[1][seen].isfinite().all())


@torch.no_grad()
def test_it_judges_poses_by_what_was_known_then():
    made, (tokens, seen, labels) = network(), some(3, 16)
    which, by = torch.full((3, 2), 2), torch.tensor([[5, 7]] * 3)
    said = made.score(tokens, seen, labels, made(tokens, seen, labels), which, by)
    changed = tokens.clone()
    changed[:, 7:] += 1.0
    other = made.score(changed, seen, labels, made(changed, seen, labels), which, by)
    assert torch.allclose(said[:, 0], other[:, 0], atol=1e-5)
    assert not torch.allclose(said[:, 1], other[:, 1], atol=1e-3)


@pytest.mark.contract
@torch.no_grad()
def test_a_memory_is_its_rows_own():
    """To the last bit: what is looked back on in a batch and alone."""
    made, (tokens, seen, labels) = network(), some(11, LONGEST)
    whole = in_fixed_batches(lambda *part: made.recall(*part), tokens, seen, labels)
    for row in (0, 4, 10):
        rows = torch.tensor([row])
        alone = in_fixed_batches(
            lambda *part: made.recall(*part), tokens[rows], seen[rows], labels[rows]
        )
        for one, two in zip(whole, alone, strict=True):
            assert torch.equal(one[row], two[0])


def test_places_about_the_middle_are_told_and_found_again(still):
    labels = torch.arange(2).repeat(3) % len(VIEWS)
    targets = still.pool.targets(torch.arange(6) % len(still.pool))
    pose = type(targets)(*(part[torch.arange(6), labels] for part in targets))
    again = pose_at(lies(pose, labels), labels)
    assert torch.allclose(again.position, pose.position, atol=1e-6)
    assert float(geodesic(again.rotation, pose.rotation).max()) < 1e-3


def test_notes_begin_anew_with_an_episode():
    notes = Notes.new(2, torch.device("cpu"))
    one, every = torch.ones(2, TOKEN), torch.tensor([True, True])
    for step in range(3):
        notes.take(one * step, torch.full((2,), step), every)
    notes.take(one * 9, torch.tensor([0, 3]), torch.tensor([False, True]))
    assert notes.seen.sum(1).tolist() == [1, 4]
    assert notes.tokens[:, 0, 0].tolist() == [9.0, 0.0]
    late = torch.tensor([LONGEST + 5, 4])
    notes.take(one, late, every)
    assert notes.seen[0].nonzero().flatten().tolist() == [0, LONGEST - 1]


def test_the_best_is_amid_those_that_show_the_view():
    where = torch.zeros(1, 5, 6)
    where[0, :, 0] = torch.tensor([0.0, 0.1, 0.2, 0.3, 5.0])
    hits = torch.tensor([[3.0, 4.0, 3.0, -6.0, 3.9]])
    found = best_of(where, hits)
    assert float(found[0, 0]) == pytest.approx(0.1, abs=0.01), "neither the edge nor another space"
    assert torch.equal(best_of(where, torch.full((1, 5), -torch.inf))[0], torch.zeros(6))


def test_legs_as_they_are_planned():
    device = torch.device("cpu")
    plain, whole = Legs.planned(0, device), Legs.planned(2, device)
    assert plain.kinds.tolist() == [BELIEVED] * 3 + [CHOICE] * 3
    assert plain.choices.tolist() == [4, 4, 4, 5, 6, 6]
    assert whole.kinds.tolist() == [BELIEVED] * 3 + [CHOICE, BEST, BEST] + [CHOICE] * 3
    assert whole.waypoints.tolist() == [*ABOUT, 0, 1, 2, 0, 0, 0]
    assert whole.choices.tolist() == [4, 4, 4, 7, 7, 7, 8, 9, 9]


def test_what_is_believed_stays_where_views_can_lie():
    """An image that leads on and on turns no probe about."""
    labels = torch.arange(4)
    about, none = middles(labels), torch.zeros(4, 3, 3)
    away = torch.tensor([[0.05, -0.05, 0.0], [0.3, -0.02, 0.0], [0.0, 0.0, 0.04], [0.0] * 3])
    turn = torch.tensor([[0.1, -0.2, 0.3], [0.0] * 3, [0.0] * 3, [0.0, 0.0, -2.3]])
    rotation = orthonormalise(matmul3(axis_angle_to_matrix(turn), about.rotation))
    found = Belief(Pose(about.position + away, rotation), none, none).bounded(labels).pose
    lain = found.position - about.position
    turned = rotation_vector(matmul3(found.rotation, about.rotation.transpose(1, 2).contiguous()))
    limits = [torch.tensor(each) for each in BOUNDS]
    assert torch.allclose(lain, away.clamp(-limits[0], limits[0]), atol=1e-6)
    assert torch.allclose(turned, turn.clamp(-limits[1], limits[1]), atol=1e-5)
    assert torch.allclose(lain[0], away[0], atol=1e-6) and float(turned[3, 2]) > -0.51


def save(folder: Path, seed: int, drawn: int | None = None) -> None:
    torch.manual_seed(seed if drawn is None else drawn)
    folder.mkdir(parents=True, exist_ok=True)
    save_weights(folder / "policy.safetensors", ServoNetwork(len(VIEWS)).state_dict())
    told = {"agent": "servo", "config": asdict(ServoConfig()), "seed": seed}
    (folder / "config.json").write_text(json.dumps(told))
    (folder / "metrics.json").write_text("{}")


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a servo's run of two trainings, to be read only."""
    folder = tmp_path_factory.mktemp("eyes") / "servo"
    save(folder, 0)
    save(folder / "seed-1", 1)
    return folder


SOON = 40
"""Steps of a search that is cut short, where what comes after it is asked."""


@pytest.fixture
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHOOSE", SOON)
    monkeypatch.setattr(module, "FURTHER", 25)


def fake_episodes(agent: Any, patient: int, config: EpisodeConfig, seed: int) -> Episodes:
    """Return episodes whose readings err by much together, and by little once features are known:
    the first feature tells where the view truly is."""
    draw = torch.Generator().manual_seed(patient)
    count, length = config.episodes, 12
    target = torch.randn(count, 6, generator=draw)
    tokens = 0.1 * torch.randn(count, length, TOKEN, generator=draw)
    spread = 2.0 * torch.rand(count, length, 1, generator=draw)
    tokens[..., :6] = target.unsqueeze(1) + spread * torch.randn(count, length, 6, generator=draw)
    tokens[..., 6:12] += (target + torch.randn(count, 6, generator=draw)).unsqueeze(1)
    tokens[..., 20:26] += 3.0 * target.unsqueeze(1)
    away = (tokens[..., :6] - target.unsqueeze(1)).norm(dim=-1)
    shown = torch.sigmoid(6.0 - 3.0 * away)
    seen = torch.ones(count, length, dtype=torch.bool)
    labels = torch.arange(count) % len(VIEWS)
    return Episodes(tokens, seen, torch.stack([shown, shown], -1), labels, target)


def settings(servo: Path) -> MemoryConfig:
    return MemoryConfig(
        members=str(servo), patients=4, round_patients=2, validation_patients=1,
        acts=EpisodeConfig(episodes=6, places=1), episodes=64, round_episodes=32, batch_size=8,
        precision="fp32",
    )  # fmt: skip


@pytest.fixture
def tiny(servo: Path, monkeypatch: pytest.MonkeyPatch) -> MemoryConfig:
    monkeypatch.setattr(rounds, "act_on", fake_episodes)
    return settings(servo)


@pytest.fixture(scope="module")
def trained(
    servo: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[int, tuple[ServoMemoryAgent, Path]]:
    """Return a training by seed, and its folder."""
    made = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rounds, "act_on", fake_episodes)
        for seed in (0, 1):
            folder = tmp_path_factory.mktemp("memory") / str(seed)
            agent = ServoMemoryAgent.train(settings(servo), folder, seed=seed, progress=False)
            made[seed] = agent, folder
    return made


def learner(config: MemoryConfig, patients: range, episodes: int) -> MemoryLearner:
    acts = EpisodeConfig(episodes=episodes)
    own, held = (
        rounds.joined([fake_episodes(None, each, acts, 0) for each in whose])
        for whose in (patients, range(900, 904))
    )
    return MemoryLearner(config, own, held, 0, "ab" * 32)


def test_it_learns_what_no_reading_says(tiny: MemoryConfig, tmp_path: Path):
    """Readings of an episode err alike, so that their mean errs too: looking back mends that."""
    made = learner(replace(tiny, episodes=1_600, batch_size=16), range(40), 10)
    before = made.look(0, tmp_path)
    optimizer = made.optimizers()["network"]
    for batch in made.batches(0, 1_600):
        for group in optimizer.param_groups:
            group["lr"] = 2e-3
        (update,) = made.updates(made.modules(), batch)
        optimizer.zero_grad()
        update.loss.backward()
        optimizer.step()
    after = made.look(1_600, tmp_path)
    assert after["validation/position_error"] < 0.6 * before["validation/position_error"]
    assert after["validation/chosen"] > before["validation/chosen"]
    assert after["validation/passed"] == before["validation/passed"] > 0.5


def test_batches_are_functions_of_what_went_before(tiny: MemoryConfig):
    one, other = (learner(tiny, range(3), 4) for _ in range(2))
    whole, rest = list(one.batches(0, 64)), list(other.batches(32, 64))
    for ours, theirs in zip(whole[4:], rest, strict=True):
        assert torch.equal(ours.seeds, theirs.seeds)
        assert torch.equal(ours.episodes.tokens, theirs.episodes.tokens)
        mine, its = (next(each.updates(one.modules(), ours)).loss for each in (one, other))
        assert torch.equal(mine, its), "what a step leaves out and asks is the batch's own"


def test_training_saves_what_it_loads_and_each_sees_through_the_servo_of_its_seed(
    tiny: MemoryConfig, trained: dict[int, tuple[ServoMemoryAgent, Path]]
):
    tokens, seen, labels = some(3, LONGEST)
    for seed, (agent, folder) in trained.items():
        loaded = ServoMemoryAgent.load(folder)
        assert agent.recall is not None and loaded.recall is not None
        with torch.no_grad():
            ours, theirs = (
                each.recall.recall(tokens, seen, labels) for each in (agent, loaded) if each.recall
            )
        assert all(torch.equal(*both) for both in zip(ours, theirs, strict=True))
        own = ServoAgent.load(Path(tiny.members) / (f"seed-{seed}" if seed else ""))
        images = torch.randint(0, 256, (2, 128, 128), dtype=torch.uint8)
        assert torch.equal(own.readings(images).ways, loaded.readings(images).ways)
        told = json.loads((folder / "metrics.json").read_text())
        counted = [each["training"]["episodes"] for each in (told, *told["rounds"])]
        assert counted == [64, 32] and "images" not in told["training"]
        steps = 12 * tiny.acts.episodes
        assert told["frames"] == (tiny.patients + tiny.round_patients) * steps
        kept = {each.name for each in folder.rglob("*") if each.is_dir()}
        assert not kept & {"done", "checkpoint"}, "nothing of the work is left"


def test_a_killed_run_goes_on(
    tiny: MemoryConfig,
    trained: dict[int, tuple[ServoMemoryAgent, Path]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    whole, _ = trained[0]
    acted: list[int] = []

    def until_killed(agent: Any, patient: int, config: EpisodeConfig, seed: int) -> Episodes:
        if len(acted) == 6:
            acted.append(0)
            raise KeyboardInterrupt
        acted.append(patient)
        return fake_episodes(agent, patient, config, seed)

    monkeypatch.setattr(rounds, "act_on", until_killed)
    with pytest.raises(KeyboardInterrupt):
        ServoMemoryAgent.train(tiny, tmp_path / "cut", progress=False)
    again = ServoMemoryAgent.train(tiny, tmp_path / "cut", progress=False)
    patients = [each for each in acted if each]
    assert len(patients) == len(set(patients)) == 7, "no patient is scanned twice"
    assert whole.recall is not None and again.recall is not None
    for ours, theirs in zip(whole.recall.parameters(), again.recall.parameters(), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.thorough
def test_several_processes_act_as_one_does(servo: Path, tmp_path: Path):
    few = {"patients": 1, "round_patients": 1, "validation_patients": 1}
    config = MemoryConfig(
        members=str(servo), acts=EpisodeConfig(episodes=1, places=1), episodes=16,
        round_episodes=8, batch_size=8, precision="fp32", **few,
    )  # fmt: skip
    alone, many = (
        ServoMemoryAgent.train(
            replace(config, processes=count), tmp_path / str(count), progress=False
        ).recall
        for count in (1, 2)
    )
    assert alone is not None and many is not None
    for ours, theirs in zip(alone.parameters(), many.parameters(), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize("patient", first_of([2, 3]))
def test_what_it_learns_from_is_what_it_saw(
    servo: Path, patient: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(episodes, "LONGEST", 20)
    eyes, config = eyes_of(str(servo), 0, "cpu"), EpisodeConfig(episodes=3, places=1)
    agent = ServoMemoryAgent(MemoryConfig(), eyes.network)
    seen = act_on(agent, patient, config, 0)
    assert seen.tokens.shape[2] == TOKEN and bool(seen.seen[:, 0].all())
    steps = (seen.tokens[:, 1:, :3] - seen.tokens[:, :-1, :3]).norm(dim=-1) * LIES[0]
    assert float(steps.max()) < 0.004, "a step is 3 mm"
    assert bool(((seen.truths >= 0.0) & (seen.truths <= 1.0)).all())
    again = act_on(agent, patient, config, 0)
    assert all(torch.equal(*both) for both in zip(seen, again, strict=True))
    monkeypatch.setattr(episodes, "LONGEST", 1)
    assert not torch.equal(act_on(agent, patient, config, 1).tokens[:, 0], seen.tokens[:, 0])


class Knows(RecallNetwork):
    """One that is told where the view is, and that only its pose shows it."""

    def __init__(self, core: Any) -> None:
        super().__init__(len(VIEWS))
        self.core = core

    def recall(self, tokens, seen, labels):
        # The rows are not named: the target is that of the middle told by the nearest start.
        every = lies(self.core.target, self.core.state.goal)
        starts = tokens[:, 0, :6].unsqueeze(1)
        row = (starts - self.first).square().sum(-1).argmin(1)
        centre = every[row]
        away = (tokens[..., :6] - centre.unsqueeze(1)).norm(dim=-1)
        return centre, (3.0 - 20.0 * away).masked_fill(~seen, -torch.inf)


def test_it_goes_where_its_memory_leads_and_rests_at_the_best(
    still, servo: Path, short_search: None
):
    core = make_core("AnyView-patients", 6, observation="multimodal", phantom=still)
    knows = Knows(core)
    agent = ServoMemoryAgent(MemoryConfig(), eyes_of(str(servo), 0, "cpu").network, knows)
    seeds = torch.arange(6)
    core.reset(seeds)
    knows.first = lies(core.state.pose, core.state.goal)
    final = rollout(core, agent, seeds).final
    assert final["declared"].all() and final["success"].mean() > 0.8
    assert float(final["position_error"].max()) < 0.004, "the eyes alone see nothing"
    assert final["steps"].min() > SOON, "the memory leads"
    assert final["steps"].max() + CHOOSE - SOON < core.task.max_steps


def test_it_looks_about_the_best_and_chooses_again(still, servo: Path, short_search: None):
    """Where a memory puts the view wrongly and knows it when it sees it, more looks find more."""

    class Misled(Knows):
        def recall(self, tokens, seen, labels):
            centre, hits = super().recall(tokens, seen, labels)
            return centre + torch.tensor([0.0, 0.4, 0.0, 0.0, 0.0, 0.0]), hits

    eyes, seeds, passed = eyes_of(str(servo), 0, "cpu").network, torch.arange(6), []
    for looks in (0, 4):
        core = make_core("AnyView-patients", 6, observation="multimodal", phantom=still)
        knows = Misled(core)
        agent = ServoMemoryAgent(MemoryConfig(looks=looks), eyes, knows)
        core.reset(seeds)
        knows.first = lies(core.state.pose, core.state.goal)
        final = rollout(core, agent, seeds).final
        assert final["declared"].all()
        passed.append((final["position_error"].mean(), final["steps"].mean()))
    assert passed[1][0] < 0.85 * passed[0][0] and passed[1][1] > passed[0][1] + 5


@pytest.mark.parametrize("further", first_of([{"bounded": True, "looks": 4}, {}]))
def test_a_row_does_not_depend_on_its_batch(
    still, servo: Path, short_search: None, further: dict[str, Any]
):
    config = MemoryConfig(**further)
    agent = ServoMemoryAgent(config, eyes_of(str(servo), 0, "cpu").network, network())
    seeds = torch.arange(3)
    case = seeds % len(still.pool)
    many = make_core("AnyView-patients", 3, observation="multimodal", phantom=still)
    whole = rollout(many, agent, seeds, case).actions
    one = make_core("AnyView-patients", 1, observation="multimodal", phantom=still)
    alone = rollout(one, agent, seeds[2:], case[2:]).actions
    assert [int(each[2]) for each in whole[: len(alone)]] == [int(each[0]) for each in alone]
    assert len(alone) > SOON + 10 and len(ABOUT) + CHOICES == 5


def test_an_empty_folder_of_its_name_is_no_servo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The published servo is found all the same."""
    (tmp_path / "servo").mkdir()
    monkeypatch.chdir(tmp_path)
    assert len(eyes_of("servo", 1, "cpu").sha256) == 64


def test_what_does_not_fit_is_refused(tiny: MemoryConfig, servo: Path, tmp_path: Path):
    servo = shutil.copytree(servo, tmp_path / "servo")
    tiny = replace(tiny, members=str(servo))
    with pytest.raises(RacinesError, match=r"no training of seed 2 \(seeds 0, 1\)"):
        ServoMemoryAgent.train(tiny, tmp_path / "out", seed=2, progress=False)
    assert not (tmp_path / "out").exists()
    with pytest.raises(RacinesError, match="a policy of 'servo', not servo-memory"):
        ServoMemoryAgent.load(servo)
    with pytest.raises(RacinesError, match=r"sha256 abababababababab….*train the memory anew"):
        eyes_like("ab" * 32, str(servo), tmp_path, "cpu")
    ServoMemoryAgent.train(tiny, tmp_path / "made", progress=False)
    save(servo, 0, drawn=5)  # another servo in the place of the one it saw through
    with pytest.raises(RacinesError, match="sees through a servo whose weights have the sha256"):
        ServoMemoryAgent.load(tmp_path / "made")
    with pytest.raises(RacinesError, match="looks 5: 0 to 4"):
        MemoryConfig(looks=5)
    with pytest.raises(RacinesError, match="there are 9999 and 1000"):
        MemoryConfig(first=9_990)
    with pytest.raises(RacinesError, match="1 or more"):
        EpisodeConfig(places=0)
    assert ServoNetwork(1).head[-1].in_features == FEATURES
