"""Other people's learners on the tasks: as they are, and as docs/clients.md shows them.

The libraries that are not beside us in one environment: `make test-clients`.
"""

import gymnasium
import numpy as np
import pytest
import torch

from tests.clients.examples import STEPS, example

ID = "racines_envs:racines/SC-v0"


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
        exec(compile(example(client), client, "exec"), names := {})
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["patients" in line[0] for line in said if "SC" in line[0]] == [False, True]
    if client != "gymnasium":
        assert all(int(line[1]) >= STEPS for line in said if "SC" in line[0])
    if client == "cleanrl":
        assert torch.isfinite(names["loss"]).all() and 0 < names["live"].mean() <= 1
