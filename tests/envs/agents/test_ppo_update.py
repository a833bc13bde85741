"""PPO's update by hand: advantages, the clipped ratio, what is bootstrapped and what is not."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn import functional
from torchrl.envs.utils import ExplorationType, set_exploration_type

from racines_envs.agents.ppo import PPOAgent, PPOConfig, PPOTraining

ENVS, STEPS = 4, 12
CONFIG = PPOConfig(
    frames=ENVS * STEPS * 10, envs=ENVS, update_every=ENVS * STEPS, minibatch=ENVS * STEPS,
    epochs=1, hidden=(16, 16), gamma=0.8, gae_lambda=0.6, reward_scale=0.25, clip=0.1,
    entropy=0.3, max_gradient=1e9,
)  # fmt: skip


def training(phantom, folder, **changes) -> PPOTraining:
    torch.manual_seed(0)
    run = PPOTraining(PPOAgent, replace(CONFIG, **changes), folder, 0, phantom, None, False)
    run._build()
    return run


def experience(run: PPOTraining) -> TensorDict:
    """Steps with rewards from 0 to 1, one row that ends after six and one that is cut."""
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        batch = run.env.rollout(STEPS, run.policy, break_when_any_done=False)
    ends = {
        key: torch.zeros(ENVS, STEPS, 1, dtype=torch.bool) for key in ("terminated", "truncated")
    }
    ends["terminated"][0, 5] = ends["truncated"][1, 5] = True
    batch["next"].update(ends | {"done": ends["terminated"] | ends["truncated"]})
    batch["next", "reward"] = torch.rand(ENVS, STEPS, 1)
    return batch


def advantages(run: PPOTraining, batch: TensorDict) -> tuple[Tensor, Tensor]:
    """Schulman et al., 2016, one step at a time: (envs, steps) advantages and value targets."""
    with torch.no_grad():
        value, ahead = (run.critic(each["params"])[..., 0] for each in (batch, batch["next"]))
    reward = batch["next", "reward"][..., 0] * 0.25
    ended, done = (batch["next", key][..., 0].float() for key in ("terminated", "done"))
    advantage, after = torch.zeros(ENVS, STEPS), torch.zeros(ENVS)
    for t in reversed(range(STEPS)):
        surprise = reward[:, t] + 0.8 * ahead[:, t] * (1 - ended[:, t]) - value[:, t]
        after = surprise + 0.8 * 0.6 * (1 - done[:, t]) * after
        advantage[:, t] = after
    return advantage, advantage + value


def loss(run: PPOTraining, batch: TensorDict) -> Tensor:
    """Schulman et al., 2017, equations 7 and 9, with a smooth L1 loss of the critic."""
    advantage, target = (each.reshape(-1) for each in advantages(run, batch))
    advantage = (advantage - advantage.mean()) / advantage.std()
    flat = batch.reshape(-1)
    chances = run.actor(flat["params"]).log_softmax(-1)
    ratio = (chances.gather(1, flat["action"][:, None])[:, 0] - flat["action_log_prob"]).exp()
    assert bool(((ratio - 1).abs() > 0.1).any()), "some ratios have to be clipped"
    gain = torch.minimum(ratio * advantage, ratio.clamp(0.9, 1.1) * advantage).mean()
    entropy = -(chances.exp() * chances).sum(-1).mean()
    value = run.critic(flat["params"])[:, 0]
    return functional.smooth_l1_loss(value, target) - gain - 0.3 * entropy


def perturb(run: PPOTraining) -> None:
    """Let the policy move on, as later minibatches of an update find it."""
    with torch.no_grad():
        for parameter in run.actor.parameters():
            parameter += 0.2 * torch.randn(parameter.shape)


def test_an_episode_that_was_cut_is_bootstrapped_and_one_that_ended_is_not(phantom, tmp_path):
    run = training(phantom, tmp_path)
    batch = experience(run)
    advantage, target = advantages(run, batch)
    run._update(batch)
    assert torch.allclose(batch["advantage"][..., 0], advantage, atol=1e-5)
    assert torch.allclose(batch["value_target"][..., 0], target, atol=1e-5)


def test_the_gradient_is_that_of_the_papers_loss(phantom, tmp_path, monkeypatch):
    run = training(phantom, tmp_path)
    batch, found = experience(run), []
    perturb(run)
    weights = [*run.actor.parameters(), *run.critic.parameters()]
    expected = torch.autograd.grad(loss(run, batch.clone()), weights)
    step = run.optimiser.step
    monkeypatch.setattr(
        run.optimiser, "step", lambda: (found.extend(w.grad.clone() for w in weights), step())
    )
    run._update(batch)
    for ours, theirs in zip(expected, found, strict=True):
        assert torch.allclose(ours, theirs, atol=1e-5)


def test_an_update_passes_over_all_steps_at_rates_that_fall(phantom, tmp_path, monkeypatch):
    run = training(
        phantom, tmp_path, epochs=3, minibatch=16, max_gradient=0.01, actor_lr=0.1, critic_lr=0.2
    )
    run.frames = run.config.frames // 4
    rows, norms, compute, step = [], [], run.loss.forward, run.optimiser.step

    def seen(batch):
        rows.append(batch["params"])
        return compute(batch)

    def stepped():
        gradients = [w.grad.flatten() for w in run.loss.parameters() if w.grad is not None]
        norms.append(float(torch.cat(gradients).norm()))
        step()

    monkeypatch.setattr(run.loss, "forward", seen)
    monkeypatch.setattr(run.optimiser, "step", stepped)
    batch = experience(run)
    moved = run.actor.scale.num_batches_tracked.clone()
    run._update(batch)
    assert [group["lr"] for group in run.optimiser.param_groups] == pytest.approx([0.075, 0.15])
    assert len(norms) == 9 and max(norms) <= 0.01 + 1e-6
    every = batch["params"].reshape(-1, 9).unique(dim=0)
    epochs = [torch.cat(rows[i : i + 3]) for i in (0, 3, 6)]
    assert all(torch.equal(epoch.unique(dim=0), every) for epoch in epochs)
    assert not torch.equal(epochs[0], epochs[1])
    assert not run.actor.training and not run.critic.training
    assert run.actor.scale.num_batches_tracked == moved + 1


def test_the_first_ratio_of_an_update_is_one(phantom, tmp_path):
    run = training(phantom, tmp_path)
    for _ in range(2):
        run._update(experience(run))
        batch = experience(run).reshape(-1)
        chances = run.actor(batch["params"]).log_softmax(-1)
        now = chances.gather(1, batch["action"][:, None])[:, 0]
        assert torch.allclose(now, batch["action_log_prob"], atol=1e-6)


def test_the_defaults_are_those_that_agents_were_published_with():
    config = PPOConfig()
    assert (config.gamma, config.gae_lambda, config.clip) == (0.97, 0.95, 0.2)
    assert (config.reward_scale, config.entropy, config.max_gradient) == (0.05, 0.01, 0.5)
    assert (config.epochs, config.minibatch, config.update_every) == (10, 512, 2048)
    assert config.anneal and config.actor_lr == config.critic_lr == 1e-3
