"""The servo: ways are read back, beliefs fuse them, training repeats, it goes where it reads."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from racines_data.config import read_params
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, geodesic, matmul3
from racines_data.randomness import derive, uniform
from racines_envs.agents import many
from racines_envs.agents.rollout import rollout
from racines_envs.agents.servo import mind, rounds
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.belief import Belief, reading
from racines_envs.agents.servo.frames import FrameConfig, Frames, draw_poses, shard, shrink, ways_to
from racines_envs.agents.servo.learner import Bank, ServoConfig, ServoLearner
from racines_envs.agents.servo.visits import VisitConfig, visit
from racines_envs.cli.training import _Asked
from racines_envs.studies.robustness.core import DisturbedCore
from racines_envs.studies.robustness.disturbances import DISTURBANCES
from racines_envs.task.tiers import middles
from racines_envs.worlds.making import make_core
from racines_models.networks.servo import ServoNetwork


def test_a_way_leads_to_the_target(still):
    rows = torch.arange(2).repeat(16)
    targets = still.pool.targets(rows)
    seeds = derive(torch.zeros(32, dtype=torch.int64), torch.arange(32))
    pose = draw_poses(targets, seeds, 1.3)
    ways = ways_to(pose, targets)
    assert ways.shape == (32, 5, 6)
    for view in range(5):
        near = ways[:, view, 3:].norm(dim=-1) < 2.5
        read = reading(pose, ways[:, view], torch.full((32, 6), 0.01)).pose
        assert torch.allclose(read.position, targets.position[:, view], atol=1e-5)
        turned = geodesic(read.rotation, targets.rotation[:, view])
        assert float(turned[near].max()) < 1e-3


def test_beliefs_average_by_precision_and_mistrust_what_lies_far_off():
    pose = Pose(torch.zeros(1, 3), torch.eye(3)[None])

    def read(x: float, deviation: float):
        way = torch.tensor([[x, 0.0, 0.0, 0.0, 0.0, x]])
        return reading(pose, way, torch.full((1, 6), deviation))

    both = read(0.0, 0.01).after(read(0.002, 0.01))
    assert 0.0009 < float(both.pose.position[0, 0]) < 0.0012
    sure = read(0.0, 0.001).after(read(0.002, 0.01))
    assert float(sure.pose.position[0, 0]) < 0.0001
    astray = read(0.0, 0.002).after(read(0.2, 0.002))
    assert float(astray.pose.position[0, 0]) < 0.02
    turn = axis_angle_to_matrix(torch.tensor([[0.0, 0.0, 0.2]]))
    assert float(geodesic(astray.pose.rotation, turn)) > 0.0


def test_beliefs_know_each_axis_for_itself():
    """What is vague along one of the probe's axes is told by a probe that stands another way."""
    turn = axis_angle_to_matrix(torch.tensor([[0.0, 0.0, torch.pi / 2]]))
    upright, aside = Pose(torch.zeros(1, 3), torch.eye(3)[None]), Pose(torch.zeros(1, 3), turn)
    vague = torch.tensor([[0.03, 0.001, 0.001, 0.5, 0.01, 0.01]])
    off = torch.tensor([[0.02, 0.0, 0.0, 0.3, 0.0, 0.0]])  # along and about the probe's own x
    both = reading(upright, off, vague).after(reading(aside, off, vague), 1.0, torch.inf)
    assert float(both.pose.position.norm()) < 0.0005


def test_a_belief_is_its_rows_own():
    """To the last bit: what is fused in a batch and what is fused alone."""
    seeds = derive(torch.zeros(300, dtype=torch.int64), torch.arange(300))
    labels, drawn = torch.arange(300) % 5, uniform(seeds, 24, 5)
    turns = axis_angle_to_matrix(drawn[:, :3] - 0.5)
    first, second = (
        reading(Pose(drawn[:, at : at + 3] * 0.05, turns), drawn[:, at : at + 6] - 0.5, sure)
        for at, sure in ((3, drawn[:, 9:15] + 1e-3), (15, drawn[:, 18:24] * 0.1 + 1e-4))
    )

    def fused(rows: torch.Tensor):
        one, other = (
            Belief(Pose(*(part[rows] for part in each.pose)), each.placed[rows], each.turned[rows])
            for each in (first, second)
        )
        return one.among(labels[rows]).after(other)

    whole = fused(torch.arange(300))
    for row in range(0, 300, 37):
        alone = fused(torch.tensor([row]))
        for own, its in zip((*alone.pose, *alone[1:]), (*whole.pose, *whole[1:]), strict=True):
            assert torch.equal(own[0], its[row])


def test_readings_far_from_any_heart_yield_to_where_hearts_lie():
    labels = torch.tensor([2, 2])
    about = middles(labels)
    away = torch.tensor([[0.02, 0.0, 0.0, 0.0, 0.0, 0.2], [0.0, 0.3, 0.05, 1.5, 0.0, 0.0]])
    base = Pose(about.position, torch.eye(3).expand(2, 3, 3))
    deviation = torch.tensor([[0.003] * 3 + [0.05] * 3, [0.05] * 3 + [0.6] * 3])
    lost = reading(base, away, deviation)
    turned = matmul3(lost.pose.rotation, about.rotation)
    kept = lost._replace(pose=Pose(lost.pose.position, turned)).among(labels).pose
    shift, turn = kept.position - about.position, geodesic(kept.rotation, about.rotation)
    assert float(shift[0, 0]) == pytest.approx(0.02, rel=0.05) and float(turn[0]) > 0.18
    assert float(shift[1].norm()) < 0.1 and float(turn[1]) < 0.1
    assert float(shift[1, 2].abs()) < 0.001, "the probe stands on the skin"


class Told(ServoAgent):
    """A servo whose network is never wrong by more than a little noise."""

    observation = "params"

    def __init__(self) -> None:
        pass

    def attach(self, core) -> None:
        super().attach(core)
        self._core, self._draw = core, torch.Generator().manual_seed(0)

    def read(self, observation, pose):
        target = self._core.target
        # An image shows what it shows from where the probe is, wherever the arm says that it is.
        way = ways_to(
            self._core.state.pose, Pose(target.position[:, None], target.rotation[:, None])
        )[:, 0]
        noise = 0.15 * torch.tensor([0.02] * 3 + [0.35] * 3)
        strayed = way + torch.randn(way.shape, generator=self._draw) * noise
        return reading(pose, strayed, noise.expand_as(way)), self._core.scored_by(
            "oracle"
        ).grade / 10


@pytest.mark.parametrize("tier", ["still", "beating"])
def test_it_goes_to_where_it_reads_and_declares(request, tier):
    ward = request.getfixturevalue(tier)
    name = "AnyView-beating" if ward.pool.beating else "AnyView-patients"
    core = make_core(name, 12, observation="params", phantom=ward)
    final = rollout(core, Told(), torch.arange(12)).final
    assert final["declared"].mean() > 0.9 and final["success"].mean() > 0.8
    assert np.median(final["position_error"]) < 0.004


@pytest.mark.parametrize("name", ["pose bias", "action noise", "slip"])
def test_what_disturbs_its_steps_begins_no_new_episode(still, name):
    """It goes on from what it knows, and still finds and declares."""
    each = DISTURBANCES[name]
    core = make_core("AnyView-patients", 12, observation="params", phantom=still)
    final = rollout(DisturbedCore(core, {each: each.amounts[1]}), Told(), torch.arange(12)).final
    assert final["declared"].mean() > 0.9 and final["success"].mean() > 0.6


class Astray(Told):
    """A servo whose readings are all off by the same, so that only what it sees can mend it."""

    def read(self, observation, pose):
        belief, shown = super().read(observation, pose)
        off = torch.tensor([[0.005, -0.006, 0.0]])
        place = belief.pose.position + off
        return belief._replace(pose=belief.pose._replace(position=place)), shown


def test_what_it_sees_mends_what_its_readings_miss(still, monkeypatch):
    core = make_core("AnyView-patients", 12, observation="params", phantom=still)
    seen = rollout(core, Astray(), torch.arange(12)).final["position_error"].mean()
    monkeypatch.setattr(mind, "SHOWN", 0.0)
    blind = rollout(core, Astray(), torch.arange(12)).final["position_error"].mean()
    assert seen < 0.95 * blind, (seen, blind)


def test_looking_about_a_view_tells_more_than_one_look(still):
    core = make_core("AnyView-patients", 12, observation="params", phantom=still)
    final = rollout(core, Told(), torch.arange(12)).final
    assert np.median(final["position_error"]) < 0.5 * 0.15 * 0.02 * 3**0.5
    assert final["steps"].max() <= mind.CHOOSE + 40


def fake_shard(patient, config, folder, side=64):
    draw = torch.Generator().manual_seed(patient)
    images = torch.randint(0, 256, (config.frames, side, side), generator=draw, dtype=torch.uint8)
    ways = torch.randn(config.frames, 5, 6, generator=draw) * 0.01
    return Frames(images, ways, *torch.rand(2, config.frames, 5, generator=draw))


def fake_visit(agent, patient, places, config, seed):
    weight = float(agent.network.head[0].weight.detach().abs().sum())
    frames = fake_shard(patient, FrameConfig(6), None, agent.network.side)
    return frames._replace(scores=torch.full((6, 5), weight % 1.0))


VISITS = VisitConfig(rounds=1, patients=2, episodes=2, steps=3, images=16)


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(rounds, "shard", fake_shard)
    monkeypatch.setattr(rounds, "visit", fake_visit)
    return ServoConfig(
        patients=3, validation_patients=1, frames=FrameConfig(8), images=64, batch_size=8,
        precision="fp32", visits=VISITS,
    )  # fmt: skip


def bank(config):
    return Bank((1, 2, 3), config.frames.frames, lambda seed: fake_shard(seed, config.frames, None))


def test_training_saves_what_it_loads_and_acts(tiny, tmp_path, still):
    trained = ServoAgent.train(tiny, tmp_path, progress=False)
    loaded = ServoAgent.load(tmp_path)
    images = torch.randint(0, 256, (3, 128, 128), dtype=torch.uint8)
    ours, theirs = trained.readings(images), loaded.readings(images)
    assert all(torch.equal(*both) for both in zip(ours, theirs, strict=True))
    assert ours.ways.shape == ours.deviations.shape == (3, 5, 6)
    assert ours.scores.shape == ours.grades.shape == (3, 5)
    assert bool(((ours.scores > 0) & (ours.scores < 1)).all()) and bool(
        ((ours.grades > 0) & (ours.grades < 10)).all()
    )
    assert not ServoAgent.load(tmp_path).network.training


def test_a_bank_grows_by_patients(tiny):
    found = bank(tiny)
    assert [len(found.holding(count).images) for count in (1, 3, 2)] == [8, 24, 16]
    assert torch.equal(found.holding(1).images, fake_shard(1, tiny.frames, None).images)


def test_batches_are_functions_of_what_went_before(tiny):
    one, other = (ServoLearner(tiny, bank(tiny), bank(tiny), 0) for _ in range(2))
    whole, rest = list(one.batches(0, 64)), list(other.batches(32, 64))
    for ours, theirs in zip(whole[4:], rest, strict=True):
        assert torch.equal(ours.images, theirs.images) and torch.equal(ours.seeds, theirs.seeds)


def test_a_round_mixes_what_was_visited(tiny):
    own = Bank((7,), 6, lambda seed: fake_visit(ServoAgent(tiny, network()), seed, 1, VISITS, 0))
    learner = ServoLearner(tiny, bank(tiny), bank(tiny), 0, network(), own, turn=1)
    batch = next(learner.batches(0, 16))
    assert len(batch.images) == 8 and len(batch.scores[:4].unique()) == 1
    assert len(batch.scores[4:].unique()) > 5
    assert learner.training.images == 16 and learner.rate(0) < tiny.learning_rate / 2


def network():
    torch.manual_seed(0)
    return ServoNetwork(5)


def test_a_killed_run_goes_on_with_its_round(tiny, tmp_path, monkeypatch):
    whole = ServoAgent.train(tiny, tmp_path / "whole", progress=False)
    plain, calls = rounds.train, []

    def until_killed(learner, *others):
        calls.append(learner._turn)
        if calls == [0, 1]:
            raise KeyboardInterrupt
        return plain(learner, *others)

    monkeypatch.setattr(rounds, "train", until_killed)
    with pytest.raises(KeyboardInterrupt):
        ServoAgent.train(tiny, tmp_path / "cut", progress=False)
    again = ServoAgent.train(tiny, tmp_path / "cut", progress=False)
    assert calls == [0, 1, 1], "the first training is not done again"
    for ours, theirs in zip(whole.network.parameters(), again.network.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    kept = {each.name for each in (tmp_path / "cut").rglob("*") if each.is_dir()}
    assert not kept & {"done", "visited", "checkpoint"}, "nothing of the work is left"
    told = json.loads((tmp_path / "cut" / "metrics.json").read_text())
    assert told["training"]["images"] == 64 and told["rounds"][0]["training"]["images"] == 16


@pytest.mark.parametrize("patient", [2, 3])
def test_what_a_servo_visits_is_where_it_went(patient):
    agent = ServoAgent(ServoConfig(), network())
    seen = visit(agent, patient, 2, VisitConfig(episodes=4, steps=3), 0)
    assert seen.images.shape == (12, 64, 64) and seen.ways.shape == (12, 5, 6)
    first, then = seen.ways[:4], seen.ways[4:8]
    stepped = (first - then)[..., :3].norm(dim=-1).amax(1)
    assert float(stepped.max()) < 0.02 and bool((seen.scores <= 1.0).all())
    again = visit(agent, patient, 2, VisitConfig(episodes=4, steps=3), 0)
    assert all(torch.equal(*both) for both in zip(seen, again, strict=True))
    other = visit(agent, patient, 2, VisitConfig(episodes=4, steps=3), 1)
    assert not torch.equal(seen.ways, other.ways)


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(RacinesError, match="share"):
        VisitConfig(share=1.0)
    with pytest.raises(RacinesError, match="1 or more"):
        VisitConfig(steps=0)


def test_it_is_not_for_the_one_heart(tiny, tmp_path, phantom):
    agent = ServoAgent.train(tiny, tmp_path, progress=False)
    core = make_core("SC", observation="multimodal", reward="oracle", phantom=phantom)
    with pytest.raises(RacinesError, match="observes multimodal"):
        agent.attach(core)


WIDE = {"widths": (16, 16, 24, 24, 32, 32), "blocks": (1, 2, 1, 1, 1)}


def test_a_network_of_six_widths_looks_at_all_pixels(tiny, tmp_path, still):
    config = replace(tiny, **WIDE)
    trained = ServoAgent.train(config, tmp_path, progress=False)
    assert config.side == trained.network.side == 128
    loaded = ServoAgent.load(tmp_path)
    images = torch.randint(0, 256, (3, 128, 128), dtype=torch.uint8)
    assert torch.equal(trained.readings(images).ways, loaded.readings(images).ways)
    # A pixel's neighbour counts for itself, where the smaller network sees their mean alone.
    swapped = images.clone()
    swapped[:, 40:88, 40:88:2], swapped[:, 40:88, 41:88:2] = (
        images[:, 40:88, 41:88:2], images[:, 40:88, 40:88:2],
    )  # fmt: skip
    assert not torch.equal(loaded.readings(swapped).ways, loaded.readings(images).ways)
    assert loaded.view_scores(images.float()).shape == (3, 5)
    core = make_core("A4C-patients", 2, observation="multimodal", phantom=still)
    loaded.attach(core)
    assert len(loaded.act(core.reset(torch.arange(2)), core.decision_seeds())) == 2


def test_frames_are_as_large_as_the_network_looks_at(tmp_path):
    seen = {side: shard(2, FrameConfig(6, places=1), tmp_path, side).images for side in (64, 128)}
    assert torch.equal(shrink(seen[128]), seen[64]) and seen[128].shape[1:] == (128, 128)
    assert torch.equal(shrink(seen[128], 128), seen[128])


def test_several_processes_draw_and_visit_what_one_does(tmp_path, monkeypatch, warm_workers):
    began: list[int] = []

    class Counted(LocalEngine):
        def __init__(self, workers):
            began.append(workers)
            super().__init__(workers)

    monkeypatch.setattr(many, "LocalEngine", Counted)
    config = ServoConfig(
        patients=2, validation_patients=1, frames=FrameConfig(8, places=1), images=32,
        batch_size=8, precision="fp32", visits=VISITS,
    )  # fmt: skip
    alone, both = (
        ServoAgent.train(replace(config, processes=count), tmp_path / str(count), progress=False)
        for count in (1, 2)
    )
    for ours, theirs in zip(alone.network.parameters(), both.network.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    assert began == [2, 2], "the frames, and the visits"


def test_a_round_has_a_pace_of_its_own(tiny):
    visits = replace(VISITS, beside=1, batch_size=4, learning_rate=1e-4)
    config, own = replace(tiny, visits=visits), bank(tiny)
    learner = ServoLearner(config, own, own, 0, network(), own, turn=1)
    batch = next(learner.batches(0, 16))
    assert len(batch.images) == 4 and learner.rate(199) == pytest.approx(0.0)
    assert learner.training.batch_size == 4 and learner.rate(0) == pytest.approx(1e-4 / 200)
    only = {each.numpy().tobytes() for each in fake_shard(1, tiny.frames, None).images}
    assert {each.numpy().tobytes() for each in batch.images[2:]} <= only, "of one patient beside"


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"widths": (8, 8)}, "five or six"),
        ({"blocks": (1, 2)}, "4 widths after the first"),
        ({"blocks": (1, 0, 1, 1)}, "one or more"),
        ({"grown": 0.0}, "share above 0"),
        ({"processes": 0}, "1 or more"),
        ({"patients": 3, "visits": VisitConfig(beside=4)}, "4 of 3 patients"),
    ],
)
def test_shapes_that_cannot_be_are_refused(wrong, told):
    with pytest.raises(RacinesError, match=told):
        ServoConfig(**wrong)


@pytest.mark.parametrize("run", ["servo", "servo-memory"])
def test_a_training_that_is_done_stays_so_with_other_processes_or_another_store(run):
    values = read_params(profile="patients")

    def what(**more):
        return _Asked(*[None] * 7, more=more).training(run, values).what

    assert what(processes=7, store="elsewhere") == what()
    assert what(batch_size=7) != what()
