"""Run by our own interpreter: the real Minari, found last, makes the environment of an export.

MINARI_DATASETS_PATH=EXPORT python minari_recovering.py SITE_PACKAGES_OF_MINARI
"""

import json
import sys

sys.path.append(sys.argv[1])  # behind our own packages: numpy and gymnasium are this interpreter's

import minari  # noqa: E402  # pyright: ignore[reportMissingImports]

(name,) = minari.list_local_datasets()
dataset = minari.load_dataset(name)
env = dataset.recover_environment()
seen, _ = env.reset(seed=3)
spaces, steps = env.observation_space.contains(seen), 0
for action in (0, 1, 2):
    seen, reward, ended, cut, info = env.step(action)
    steps += 1
other = dataset.recover_environment(view="SC")
told = {"spaces": spaces, "steps": steps, "view": other.unwrapped.core.task.view}
told |= {"id": env.spec.id, "reward": env.unwrapped.core.reward.name}
print(json.dumps(told))
