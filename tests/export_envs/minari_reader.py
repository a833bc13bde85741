"""Run by the Minari environment: open an export with the real library, dump what it hands out.

MINARI_DATASETS_PATH=EXPORT python minari_reader.py OUT.npz
"""

import json
import sys

import minari
import numpy as np

arrays: dict[str, np.ndarray] = {}
about: dict[str, dict] = {}
for name in minari.list_local_datasets():
    dataset = minari.load_dataset(name)
    about[name] = {
        "episodes": dataset.total_episodes,
        "steps": dataset.total_steps,
        "observation_space": str(dataset.observation_space),
        "action_space": str(dataset.action_space),
        "about": list(dataset.storage.get_episode_metadata(range(dataset.total_episodes))),
        "in_space": True,
        "sampled": len(dataset.sample_episodes(1)),
    }
    for episode in dataset.iterate_episodes():
        key = f"{name}/{episode.id}"
        first = {part: values[0] for part, values in episode.observations.items()}
        about[name]["in_space"] &= dataset.observation_space.contains(first)
        about[name]["in_space"] &= dataset.action_space.contains(episode.actions[0])
        arrays[f"{key}/images"] = episode.observations["image"]
        arrays[f"{key}/params"] = episode.observations["params"]
        arrays[f"{key}/actions"] = episode.actions
        arrays[f"{key}/rewards"] = episode.rewards
        arrays[f"{key}/terminations"] = episode.terminations
        arrays[f"{key}/truncations"] = episode.truncations
        arrays |= {f"{key}/infos/{part}": values for part, values in episode.infos.items()}
np.savez(sys.argv[1], about=json.dumps(about), **arrays)
