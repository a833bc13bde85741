"""The servo with a memory: what it looks back on, and where it goes."""

from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    geodesic,
    matmul3,
    orthonormalise,
    rotation_vector,
)
from racines_data.patients.pool import Pool
from racines_data.patients.splits import seeds_of
from racines_data.views import VIEWS
from racines_envs.agents.memory import agent as module
from racines_envs.agents.memory import episodes
from racines_envs.agents.memory.agent import CHOOSE, ServoMemoryAgent
from racines_envs.agents.memory.episodes import EpisodeConfig, act_on
from racines_envs.agents.memory.eyes import eyes_of
from racines_envs.agents.memory.lead import (
    ABOUT,
    BELIEVED,
    BEST,
    CHOICE,
    CHOICES,
    Legs,
    best_of,
)
from racines_envs.agents.memory.learner import MemoryConfig
from racines_envs.agents.memory.notes import LONGEST, Notes, lies, pose_at
from racines_envs.agents.rollout import rollout
from racines_envs.agents.servo.belief import BOUNDS, Belief
from racines_envs.agents.servo.frames import places_of
from racines_envs.task.tiers import middles
from racines_envs.worlds.making import make_core
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.recall import LIES, TOKEN, RecallNetwork
from tests.envs.patients.eyes import some
from tests.variants import first_of


def network(seed: int = 0) -> RecallNetwork:
    """Return one whose every layer says something."""
    torch.manual_seed(seed)
    made = RecallNetwork(len(VIEWS))
    with torch.no_grad():
        for weights in made.parameters():
            weights += 0.05 * torch.randn_like(weights)
    return made.eval()


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


def inside(found: Pose, labels: torch.Tensor) -> torch.Tensor:
    """Return (N,) bool: poses lie within the bounds about the middles of (N,) labels."""
    about, limits = middles(labels), [torch.tensor(each) for each in BOUNDS]
    turn = rotation_vector(matmul3(found.rotation, about.rotation.transpose(1, 2).contiguous()))
    within = [(found.position - about.position).abs() <= limits[0] + 1e-5]
    return torch.cat([*within, turn.abs() <= limits[1] + 1e-4], 1).all(1)


@pytest.mark.thorough
def test_views_of_train_patients_lie_within_the_bounds():
    for patient in seeds_of("train")[2_000:2_060]:
        pool = Pool(places_of(patient, 5))
        targets = pool.targets(torch.arange(len(pool)))
        for label in range(len(VIEWS)):
            of_view = Pose(*(part[:, label] for part in targets))
            assert bool(inside(of_view, torch.full((len(pool),), label)).all()), (patient, label)


def test_what_it_believes_is_bounded_and_what_it_notes_is_not(still, servo: Path):
    """Readings that lead far off: the belief stays, and the memory sees them as they were."""
    core = make_core("AnyView-patients", 6, observation="multimodal", phantom=still)
    observation, tokens = core.reset(torch.arange(6)), []
    for bounded in (False, True):
        network = eyes_of(str(servo), 0, "cpu").network
        with torch.no_grad():
            network.head[-1].bias += 6.0  # of every number: ways among them
        agent = ServoMemoryAgent(MemoryConfig(bounded=bounded), network)
        agent.attach(core)
        with torch.no_grad():
            found, _ = agent.read(observation, core.state.pose)
        within = inside(found.pose, core.state.goal)
        assert bool(within.all()) if bounded else not bool(within.any())
        tokens.append(agent._token)
    assert torch.equal(*tokens)


SOON = 40
"""Steps of a search that is cut short, where what comes after it is asked."""


@pytest.fixture
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHOOSE", SOON)
    monkeypatch.setattr(module, "FURTHER", 25)


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
