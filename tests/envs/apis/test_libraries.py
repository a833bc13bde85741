"""Other people's learners on the tasks: as they are, and as docs/clients.md shows them.

The libraries that are not beside us in one environment: `make test-clients`.
"""

import gymnasium
import numpy as np
import pytest
import torch
from torch import nn

from tests.clients.examples import STEPS, example

ID = "racines_envs:racines/SC-v0"


class ActorCritic(nn.Module):
    def __init__(self, envs):
        super().__init__()
        size, actions = envs.single_observation_space.shape[0], envs.single_action_space.n
        self.body = nn.Sequential(nn.Linear(size, 32), nn.Tanh())
        self.actor, self.critic = nn.Linear(32, actions), nn.Linear(32, 1)

    def forward(self, seen, action=None):
        hidden = self.body(seen)
        choice = torch.distributions.Categorical(logits=self.actor(hidden))
        action = choice.sample() if action is None else action
        return action, choice.log_prob(action), choice.entropy(), self.critic(hidden).squeeze(-1)


def clean_ppo(envs, updates=3, steps=32, epochs=2, gamma=0.99, trace=0.95, clip=0.2):
    """PPO in one function on a vector environment, as CleanRL writes it."""
    agent = ActorCritic(envs)
    optimiser = torch.optim.Adam(agent.parameters(), 1e-3)
    seen, _ = envs.reset(seed=1)
    seen, done = torch.tensor(seen), torch.zeros(envs.num_envs)
    losses, ends = [], 0
    for _ in range(updates):
        rows = []
        for _ in range(steps):
            with torch.no_grad():
                action, logprob, _, value = agent(seen)
            after, reward, terminated, truncated, _ = envs.step(action.numpy())
            # Gymnasium's NEXT_STEP: the step after an end only resets, and teaches nothing.
            rows.append((seen, action, logprob, value, torch.tensor(reward), done, 1.0 - done))
            seen, done = torch.tensor(after), torch.tensor(terminated | truncated).float()
            ends += int(done.sum())
        with torch.no_grad():
            following, carry, advantages = agent(seen)[3], 0.0, []
            live = 1.0 - done
            for _, _, _, value, reward, was, _ in reversed(rows):
                delta = reward + gamma * following * live - value
                carry = delta + gamma * trace * live * carry
                advantages.insert(0, carry)
                following, live = value, 1.0 - was
        x, a, old, v, _, _, valid = (torch.cat(column) for column in zip(*rows, strict=True))
        adv = torch.cat(advantages).float()
        for _ in range(epochs):
            _, new, entropy, value = agent(x, a)
            ratio = (new - old).exp()
            gain = torch.min(ratio * adv, ratio.clamp(1 - clip, 1 + clip) * adv)
            loss = (0.5 * (value - adv - v).square() - gain - 0.01 * entropy) * valid
            loss = loss.sum() / valid.sum()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
    return agent, losses, ends


def test_a_cleanrl_style_loop_runs_on_make_vec(phantom):
    envs = gymnasium.make_vec(
        ID, num_envs=4, phantom=phantom, observation="params", reward="shaped"
    )
    torch.manual_seed(0)
    before = ActorCritic(envs).actor.weight.detach().clone()
    torch.manual_seed(0)
    agent, losses, ends = clean_ppo(envs, updates=7)
    assert np.isfinite(losses).all() and ends >= 4  # 224 steps: every row was truncated once
    assert not torch.equal(before, agent.actor.weight)


@pytest.mark.parametrize(
    ("observation", "policy"),
    [("image", "CnnPolicy"), ("params", "MlpPolicy"), ("multimodal", "MultiInputPolicy")],
)
def test_stable_baselines3_ppo_runs_as_it_is(phantom, observation, policy):
    import stable_baselines3
    from stable_baselines3.common.env_checker import check_env

    env = gymnasium.make(ID, phantom=phantom, observation=observation, reward="oracle")
    check_env(env, warn=True)
    small = {"net_arch": [16]}
    if observation != "params":
        small["features_extractor_kwargs"] = (
            {"features_dim": 16} if observation == "image" else {"cnn_output_dim": 16}
        )
    model = stable_baselines3.PPO(
        policy, env, n_steps=16, batch_size=8, n_epochs=1, seed=0, policy_kwargs=small,
        device="cpu",
    )  # fmt: skip
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(32)
    assert model.num_timesteps == 32
    after = model.policy.parameters()
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    seen, _ = env.reset(seed=0)
    action, _ = model.predict(seen, deterministic=True)
    assert env.action_space.contains(np.int64(action))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("client", ["gymnasium", "sb3", "cleanrl", "torchrl"])
def test_the_example_of_the_documentation_runs_on_both_tasks(client, capsys):
    with torch.random.fork_rng():
        exec(compile(example(client), client, "exec"), {})
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["patients" in line[0] for line in said if "SC" in line[0]] == [False, True]
    if client != "gymnasium":
        assert all(int(line[1]) >= STEPS for line in said if "SC" in line[0])
