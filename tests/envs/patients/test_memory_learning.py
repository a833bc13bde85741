"""The servo with a memory: what it learns, from what, and whom it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.views import VIEWS
from racines_envs.agents.memory import rounds
from racines_envs.agents.memory.agent import ServoMemoryAgent
from racines_envs.agents.memory.episodes import EpisodeConfig, Episodes
from racines_envs.agents.memory.eyes import eyes_like, eyes_of
from racines_envs.agents.memory.learner import MemoryConfig, MemoryLearner
from racines_envs.agents.memory.notes import LONGEST
from racines_envs.agents.servo.agent import ServoAgent
from racines_models.networks.recall import FEATURES, TOKEN
from racines_models.networks.servo import ServoNetwork
from tests.envs.patients.eyes import save, some


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
