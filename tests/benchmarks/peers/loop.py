"""PPO as one plain loop over a Gymnasium vector environment, in the style of CleanRL.

One file, no framework: rollout, advantages, minibatches (Huang et al., 2022, "The 37 implementation
details of PPO"). Networks, batch and settings are those of our `PPOConfig`.
"""

import time
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical

from racines_envs.agents.policy import make_network
from racines_envs.agents.ppo import PPOConfig
from racines_envs.task.actions import ACTIONS


class Loop:
    """Actor and critic, and the loop that trains them."""

    def __init__(self, config: PPOConfig, seed: int) -> None:
        """Draw the networks."""
        torch.manual_seed(seed)
        self.config = config
        self.actor = make_network(config, None, len(ACTIONS), 0.01).eval()
        self.critic = make_network(config, None, 1, 1.0).eval()
        groups = [(self.actor, config.actor_lr), (self.critic, config.critic_lr)]
        self.optimiser = torch.optim.Adam(
            [{"params": [*net.parameters()], "lr": rate} for net, rate in groups], eps=1e-5
        )

    def train(self, envs: Any, frames: int, seed: int) -> float:
        """Learn from so many frames of a vector environment; return the seconds it took."""
        config, count = self.config, self.config.envs
        steps = config.update_every // count
        start = time.perf_counter()
        seen = torch.from_numpy(envs.reset(seed=seed)[0])
        reset = torch.zeros(count)
        for done in range(0, frames, config.update_every):
            for group, rate in zip(
                self.optimiser.param_groups, (config.actor_lr, config.critic_lr), strict=True
            ):
                group["lr"] = rate * (1.0 - done / frames)
            rows: list[tuple[Tensor, ...]] = []
            for _ in range(steps):
                with torch.no_grad():
                    choice = Categorical(logits=self.actor(seen))
                    action = choice.sample()
                    value = self.critic(seen)[:, 0]
                following, reward, ended, cut, _ = envs.step(action.numpy())
                gain = torch.from_numpy(np.asarray(reward, np.float32)) * config.reward_scale
                rows.append((seen, action, choice.log_prob(action), value, gain, reset))
                over = torch.from_numpy(ended | cut).float()
                seen, reset = torch.from_numpy(following), over
            with torch.no_grad():
                last = self.critic(seen)[:, 0]
            self.update([torch.stack(each) for each in zip(*rows, strict=True)], last, reset)
        return time.perf_counter() - start

    def update(self, rollout: list[Tensor], last: Tensor, over: Tensor) -> None:
        """Improve both by several passes over a rollout (steps, envs)."""
        config = self.config
        seen, action, chance, value, gain, reset = rollout
        advantage, carried = torch.zeros_like(gain), torch.zeros_like(last)
        for t in reversed(range(len(gain))):
            after = value[t + 1] if t + 1 < len(gain) else last
            going = 1.0 - (reset[t + 1] if t + 1 < len(gain) else over)
            delta = gain[t] + config.gamma * after * going - value[t]
            carried = delta + config.gamma * config.gae_lambda * going * carried
            advantage[t] = carried
        # With next-step autoreset the step that resets is none of the agent's: it is left out.
        kept = reset.flatten() == 0
        flat = [x.flatten(0, 1)[kept] for x in (seen, action, chance, advantage, advantage + value)]
        for _ in range(config.epochs):
            for rows in torch.randperm(len(flat[0])).split(config.minibatch):
                self.step(*(x[rows] for x in flat))
        self.actor.train(), self.critic.train()
        with torch.no_grad():
            self.actor(flat[0][: config.minibatch]), self.critic(flat[0][: config.minibatch])
        self.actor.eval(), self.critic.eval()

    def step(
        self, seen: Tensor, action: Tensor, old: Tensor, advantage: Tensor, target: Tensor
    ) -> None:
        """Take one gradient step on a minibatch."""
        config = self.config
        choice = Categorical(logits=self.actor(seen))
        ratio = (choice.log_prob(action) - old).exp()
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        clipped = ratio.clamp(1.0 - config.clip, 1.0 + config.clip)
        loss = -torch.min(advantage * ratio, advantage * clipped).mean()
        loss = loss - config.entropy * choice.entropy().mean()
        loss = loss + nn.functional.smooth_l1_loss(self.critic(seen)[:, 0], target)
        self.optimiser.zero_grad()
        loss.backward()
        for network in (self.actor, self.critic):
            nn.utils.clip_grad_norm_(network.parameters(), config.max_gradient)
        self.optimiser.step()
