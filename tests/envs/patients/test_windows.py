"""A servo looks through the rib spaces beside the first, and rests where the view shows best."""

import torch

from racines_data.geometry import Pose, axis_angle_to_matrix, geodesic, matmul3
from racines_envs.agents.rollout import rollout
from racines_envs.agents.servo import mind, windows
from racines_envs.agents.servo.belief import Belief, reading
from racines_envs.agents.servo.frames import ways_to
from racines_envs.agents.servo.windows import AIM, SPACE, SPACES, Windows, beside
from racines_envs.task.tiers import middles
from racines_envs.worlds.making import make_core
from tests.envs.patients.test_servo import Told


def believed(count: int, shift: float = 0.0) -> Belief:
    about = middles(torch.zeros(count, dtype=torch.int64))
    place = about.position + torch.tensor([shift, 0.0, 0.0])
    sure = torch.eye(3).expand(count, 3, 3)
    return Belief(about._replace(position=place), sure, sure)


def seen(worth: list[float], weight: float = 1.0) -> torch.Tensor:
    rows = torch.zeros(len(worth), 8)
    rows[:, 0], rows[:, 7] = weight, weight * torch.tensor(worth)
    return rows


def test_the_space_beside_sees_the_same_depth():
    pose = middles(torch.arange(5))
    side = torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0])
    there = beside(pose, side)
    shift = there.pose.position - pose.position
    assert torch.allclose(shift[:, 0], SPACE * side, atol=1e-6)
    assert float(shift[:, 1:].abs().max()) < 1e-7
    deep = pose.position + AIM * pose.rotation[:, :, 2]
    towards = torch.nn.functional.normalize(deep - there.pose.position, dim=-1)
    assert torch.allclose(there.pose.rotation[:, :, 2], towards, atol=1e-5)
    assert float(geodesic(there.pose.rotation, pose.rotation).max()) < 0.3
    same = beside(pose, torch.zeros(5)).pose
    assert torch.allclose(same.rotation, pose.rotation, atol=1e-6)


def test_each_space_is_looked_at_then_the_best_is_chosen():
    first = believed(2, 0.01)
    kept = Windows.new(first, seen([0.0, 0.0]))
    rows, now, worth = torch.ones(2, dtype=torch.bool), first, seen([0.4, 0.9])
    no, about = ~rows, believed(2).pose
    for number, then in ((1, [0.8, 0.3]), (2, [0.5, 0.2])):
        kept.leave(rows, now, worth, now.pose, about)
        now, emptied = kept.enter(rows, now, worth, no)
        assert kept.number.tolist() == [number] * 2 and bool(kept.travels.all())
        assert float(emptied.abs().sum()) == 0.0, "what was seen elsewhere does not count here"
        away = now.pose.position[0, 0] - first.pose.position[0, 0]
        # The view lies at smaller x in most people: that side first, then the other.
        assert torch.allclose(away, torch.tensor(-SPACE if number == 1 else SPACE), atol=1e-6)
        worth = seen(then)
    kept.leave(rows, now, worth, now.pose, about)
    now, worth = kept.enter(rows, now, worth, no)
    assert bool(kept.chosen.all()) and worth[:, 7].tolist() == seen([0.8, 0.9])[:, 7].tolist()
    away = now.pose.position[:, 0] - first.pose.position[:, 0]
    assert torch.allclose(away, torch.tensor([-SPACE, 0.0]), atol=1e-6)


def test_who_is_late_chooses_among_what_was_seen_and_rows_are_their_own():
    first, worth = believed(3), seen([-0.5, -0.5, -0.5])
    kept = Windows.new(first, worth)
    rows, late = torch.tensor([True, True, False]), torch.tensor([True, False, False])
    kept.leave(rows, first, worth, first.pose, first.pose)
    now, _ = kept.enter(rows, first, worth, late)
    assert kept.number.tolist() == [SPACES, 1, 0] and kept.travels.tolist() == [True, True, False]
    moved = (now.pose.position - first.pose.position)[:, 0].abs()
    assert moved.tolist()[::2] == [0.0, 0.0] and moved[1] > 0.9 * SPACE, "it never saw another"
    kept.forget(torch.tensor([True, False, True]))
    assert kept.number.tolist() == [0, 1, 0] and kept.travels.tolist() == [False, True, False]
    assert float(kept.seen[0][0].abs().sum()) == 0.0 < float(kept.seen[0][1].abs().sum())


def minded(rows: torch.Tensor) -> list[Pose]:
    """Return where some of 24 rows believe their views, step by step, read at random."""
    draw = torch.Generator().manual_seed(1)
    labels = torch.arange(24) % 5
    kept, believed = None, []
    for step in range(mind.CHOOSE + 10):
        about = middles(labels)
        turn = axis_angle_to_matrix(0.2 * torch.randn(24, 3, generator=draw))
        place = about.position + 0.02 * torch.randn(24, 3, generator=draw)
        way, deviation = 0.02 * torch.rand(2, 24, 6, generator=draw) + 0.002
        worth, reached = torch.rand(2, 24, generator=draw)
        pose = Pose(place[rows], matmul3(turn, about.rotation)[rows])
        read = reading(pose, way[rows], deviation[rows])
        kept = kept or mind.Mind.new(read)
        kept.learn(read, pose, worth[rows], labels[rows], torch.full((len(rows),), step > 0))
        kept.search(labels[rows])
        believed.append(kept.centre(labels[rows]))
        kept.step(reached[rows] < 0.3)
    assert bool(kept.windows.chosen.all())
    return believed


def test_where_a_row_searches_does_not_hang_on_the_others():
    every = minded(torch.arange(24))
    for rows in (torch.tensor([3]), torch.arange(5, 22)):
        for whole, part in zip(every, minded(rows), strict=True):
            assert torch.equal(whole.position[rows], part.position)
            assert torch.equal(whole.rotation[rows], part.rotation)


class Local(Told):
    """A servo that reads the view where it is, one rib space off as well, but sees it is worse."""

    def read(self, observation, pose):
        target, at = self._core.target, self._core.state.pose
        truth = Pose(target.position[:, None], target.rotation[:, None])
        side = torch.full((len(at.position),), 1.0)
        false = beside(target, torch.where(target.position[:, 0] < 0.41, side, -side)).pose
        ways = [ways_to(at, each)[:, 0] for each in (truth, Pose(*(p[:, None] for p in false)))]
        far = [way[:, :3].norm(dim=-1) for way in ways]
        wrong = far[1] < far[0]
        way = torch.where(wrong[:, None], ways[1], ways[0])
        worth = torch.where(wrong, 0.55, 0.75) - 10.0 * torch.minimum(*far)
        deviation = torch.tensor([0.004] * 3 + [0.07] * 3).expand_as(way)
        return reading(pose, way, deviation), worth


def test_what_looks_like_the_view_one_space_off_is_left(still, monkeypatch):
    core = make_core("A4C-patients", 24, observation="params", phantom=still)
    found = rollout(core, Local(), torch.arange(24)).final
    # With one space alone it rests where it first believes the view.
    monkeypatch.setattr("racines_envs.agents.servo.mind.CHOOSE", 0)
    blind = rollout(core, Local(), torch.arange(24)).final
    off = 0.6 * windows.SPACE
    assert (blind["position_error"] > off).mean() > 0.25, "the trap works"
    assert (found["position_error"] > off).mean() < 0.5 * (blind["position_error"] > off).mean()
    assert found["declared"].mean() > 0.9
