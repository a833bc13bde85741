"""Run by the lerobot environment: open an export with the real library, dump what it hands out.

python lerobot_reader.py EXPORT OUT.npz
"""

import json
import sys

import numpy as np
import torch
from lerobot.datasets.compute_stats import RunningQuantileStats
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torchvision.transforms import v2

root, out = sys.argv[1:]
dataset = LeRobotDataset("racines/export", root=root)
items = [dataset[index] for index in range(len(dataset))]
image = dataset.meta.image_keys[0]
episodes = dataset.meta.episodes

some = LeRobotDataset("racines/export", root=root, episodes=[1, 3])
coloured = LeRobotDataset("racines/export", root=root, image_transforms=v2.RGB())
step = 1 / dataset.fps
windows = LeRobotDataset(
    "racines/export", root=root, delta_timestamps={"action": [0, step], image: [-step, 0]}
)
loader = torch.utils.data.DataLoader(windows, batch_size=8, shuffle=False)
batch = next(iter(loader))
again = RunningQuantileStats()
again.update(np.stack([item["observation.state"].numpy() for item in items]))

np.savez(
    out,
    images=torch.stack([item[image] for item in items]).numpy(),
    states=torch.stack([item["observation.state"] for item in items]).numpy(),
    actions=torch.stack([item["action"] for item in items]).numpy(),
    views=np.array([int(item["view"]) for item in items]),
    grades=np.array([float(item["grade"]) for item in items], np.float32),
    timestamps=np.array([float(item["timestamp"]) for item in items]),
    frame_index=np.array([int(item["frame_index"]) for item in items]),
    episode_index=np.array([int(item["episode_index"]) for item in items]),
    bounds=np.array([[e["dataset_from_index"], e["dataset_to_index"]] for e in episodes]),
    some=np.array([int(some[index]["index"]) for index in range(len(some))]),
    coloured=coloured[0][image].numpy(),
    window_actions=batch["action"].numpy(),
    window_images=batch[image].numpy(),
    window_padded=batch["action_is_pad"].numpy(),
    library_std=again.get_statistics()["std"],
    library_mean=again.get_statistics()["mean"],
    stats_std=dataset.meta.stats["observation.state"]["std"],
    stats_mean=dataset.meta.stats["observation.state"]["mean"],
    about=json.dumps(
        {
            "fps": dataset.fps,
            "splits": dataset.meta.info["splits"],
            "tasks": [item["task"] for item in items],
            "trajectories": list(episodes["trajectory"]),
            "names": dataset.meta.names["observation.state"],
            "files": [str(dataset.meta.get_data_file_path(i)) for i in range(len(episodes))],
        }
    ),
)
