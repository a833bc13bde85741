"""Run by the lerobot environment: what a checkpoint's `select_action` does at given observations.

python lerobot_acting.py CHECKPOINT SEEN.npz OUT.npy

Written for `n_action_steps=1`: each observation is a fresh look.
"""

import sys

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs import preprocess_observation
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

checkpoint, seen, out = sys.argv[1:]
config = PreTrainedConfig.from_pretrained(checkpoint)
assert config.n_action_steps == 1
policy = get_policy_class(config.type).from_pretrained(checkpoint, config=config).eval()
before, after = make_pre_post_processors(config, checkpoint)
actions = []
with np.load(seen) as given:
    for image, params in zip(given["image"], given["params"], strict=True):
        pixels = np.repeat(image[None, ..., None], 3, -1)
        observation = {"pixels": {"ultrasound": pixels}, "agent_pos": params[None]}
        with torch.inference_mode():
            action = policy.select_action(before(preprocess_observation(observation)))
        actions.append(after(action).numpy()[0])
np.save(out, np.stack(actions))
