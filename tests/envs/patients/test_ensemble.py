"""Several servos that look as one: the surer counts more, and disagreement is doubt."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.views import VIEWS
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.ensemble import EnsembleConfig, ServoEnsembleAgent
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.worlds.making import make_core
from racines_models.networks.servo import Reading, ServoEnsemble, ServoNetwork
from racines_models.weights import save_weights


class Says(ServoNetwork):
    """A network that reads the same from every image."""

    def __init__(self, way: float, deviation: float, score: float) -> None:
        super().__init__(1)
        self.said = way, deviation, score

    def read(self, images: torch.Tensor) -> Reading:
        way, deviation, score = (torch.full((len(images), 1), each) for each in self.said)
        way, deviation = (each.unsqueeze(2).expand(-1, 1, 6) for each in (way, deviation))
        return Reading(way, deviation, score, 10.0 * score)


def read(*said: tuple[float, float, float]) -> tuple[float, ...]:
    found = ServoEnsemble([Says(*each) for each in said]).read(torch.zeros(2, 64, 64))
    assert found.ways.shape == found.deviations.shape == (2, 1, 6)
    return tuple(float(each.flatten()[0]) for each in found)


def test_members_that_agree_are_as_sure_as_one():
    assert read((0.01, 0.002, 0.6), (0.01, 0.002, 0.6)) == pytest.approx((0.01, 0.002, 0.6, 6.0))


def test_the_surer_member_counts_more_and_what_they_disagree_by_is_doubt():
    way, deviation, score, _ = read((0.00, 0.001, 0.2), (0.01, 0.003, 0.6))
    assert way == pytest.approx(0.001) and score == pytest.approx(0.4)
    # The variance of a mixture: of each member about the mean, weighted.
    variance = 0.9 * (0.001**2 + 0.001**2) + 0.1 * (0.003**2 + 0.009**2)
    assert deviation == pytest.approx(variance**0.5)


def save(folder: Path, seed: int, agent: str = "servo", **shape: Any) -> ServoNetwork:
    torch.manual_seed(seed)
    network = ServoNetwork(len(VIEWS), **shape)
    save_weights(folder / "policy.safetensors", network.state_dict())
    told = {"agent": agent, "config": asdict(ServoConfig(**shape)), "seed": seed}
    (folder / "config.json").write_text(json.dumps(told))
    (folder / "metrics.json").write_text("{}")
    return network.eval()


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return the folder of a servo's run of four trainings."""
    for seed, place in enumerate(("", "seed-1", "seed-2", "seed-3")):
        (tmp_path / "servo" / place).mkdir()
        save(tmp_path / "servo" / place, seed)
    return tmp_path / "servo"


def test_each_training_takes_the_servos_that_follow_and_is_loaded_as_it_was(
    run: Path, tmp_path: Path, still: Any
):
    config = EnsembleConfig(members=str(run), size=2)
    images = torch.randint(0, 256, (5, 128, 128), dtype=torch.uint8)
    for seed in (0, 1):
        made = ServoEnsembleAgent.train(config, tmp_path / f"both-{seed}", seed=seed)
        again = ServoEnsembleAgent.load(tmp_path / f"both-{seed}")
        own = [ServoAgent.load(run / (f"seed-{k}" if k else "")) for k in (2 * seed, 2 * seed + 1)]
        scores = torch.stack([each.readings(images).scores for each in own]).mean(0)
        for agent in (made, again):
            assert torch.allclose(agent.readings(images).scores, scores)
        assert torch.equal(again.readings(images[:2]).ways, again.readings(images).ways[:2])
        told = json.loads((tmp_path / f"both-{seed}" / "metrics.json").read_text())
        assert [each["seed"] for each in told["members"]] == [2 * seed, 2 * seed + 1]
    core = make_core("A4C-patients", 2, observation="multimodal", phantom=still)
    again.attach(core)
    assert again.act(core.reset(torch.arange(2)), core.decision_seeds()).shape == (2,)


def test_members_of_six_widths_look_at_all_pixels(run: Path, tmp_path: Path):
    shape = {"widths": (16, 16, 24, 24, 32, 32), "blocks": (1, 2, 1, 1, 1)}
    for seed, place in enumerate(("", "seed-1", "seed-2", "seed-3")):
        save(run / place, seed, **shape)
    made = ServoEnsembleAgent.train(EnsembleConfig(members=str(run), size=2), tmp_path / "both")
    again = ServoEnsembleAgent.load(tmp_path / "both")
    images = torch.randint(0, 256, (2, 128, 128), dtype=torch.uint8)
    own = [ServoAgent.load(each).readings(images).scores for each in (run, run / "seed-1")]
    assert made.network.side == again.network.side == 128
    assert torch.allclose(again.readings(images).scores, torch.stack(own).mean(0))


@pytest.mark.parametrize(
    ("ask", "told"),
    [
        (lambda run: {"size": 3, "seed": 1}, "has 4 trainings, and an ensemble of 3 with seed 1"),
        (lambda run: {"size": 1}, "servo-ensemble.size: 1: give 2 or more"),
        (lambda run: {"members": save(run, 0, "ppo") and str(run)}, "seed-1: another .*agent"),
        (lambda run: {"members": "no-such-servo"}, "no-such-servo"),
    ],
)
def test_what_is_no_ensemble_is_refused(
    run: Path, tmp_path: Path, ask: Callable[[Path], dict[str, Any]], told: str
):
    asked = {"members": str(run), "size": 2} | ask(run)
    seed = asked.pop("seed", 0)
    with pytest.raises(RacinesError, match=told):
        ServoEnsembleAgent.train(EnsembleConfig(**asked), tmp_path / "out", seed=seed)
    assert not (tmp_path / "out").exists()


def test_a_policy_of_another_agent_is_refused(run: Path):
    with pytest.raises(RacinesError, match="a policy of 'servo', not servo-ensemble"):
        ServoEnsembleAgent.load(run)
