"""The device against the CPU: canonical frames, the oracle's truth, and the rewards of episodes."""

import tempfile
from pathlib import Path
from typing import Any

import torch

from racines_data.geometry import parameters_to_pose
from racines_data.patients import Pool
from racines_data.phantom import Phantom
from racines_data.validate.canonical import compare
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.task.actions import ACTIONS
from racines_envs.worlds.making import make_core
from racines_leaderboard.determinism.processors import POSES, SCENES, read_record
from tests.benchmarks.gpu.sizes import Sizes

FIRST = 10_000
"""Seed of the first validation patient."""


def correctness(device: str, sizes: Sizes) -> dict[str, Any]:
    """Return greatest differences; `levels` and `reward` are those of all that was compared.

    Of the phantom, a sample on the edge of two voxels may fall on either side, as between any two
    processors; pixels more than one gray level apart are counted. Patients lie on a grid of
    integers, where that cannot be.
    """
    scenes, truth = _phantoms(device, sizes)
    scenes |= _patients(device, sizes)
    episodes = {reward: _episodes(device, sizes, reward) for reward in ("oracle", "shaped")}
    hearts = [scenes[name]["levels"] for name in ("patients", "beating") if name in scenes]
    blocks = [each for name, each in scenes.items() if name in SCENES]
    return {
        "levels": max(each["levels"] for each in scenes.values()),
        "patients_levels": max(hearts) if hearts else None,
        "phantom_share": sum(x["beyond_one"] for x in blocks) / sum(x["pixels"] for x in blocks),
        "holds": all(each["holds"] for each in scenes.values()),
        "reward": max(each["reward"] for each in episodes.values()),
        "scenes": scenes,
        "truth": truth,
        "graph": _graphs(device),
        "episodes": episodes,
    }


def _difference(here: torch.Tensor, there: torch.Tensor) -> dict[str, Any]:
    found = compare(here.numpy(), there.cpu().numpy())
    return {
        "levels": found.levels,
        "pixels": found.pixels,
        "differing": found.differing,
        "beyond_one": found.beyond,
        "holds": found.holds,
    }


def _phantoms(device: str, sizes: Sizes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Compare frames of the phantoms that processors are compared by, and the oracle's truth."""
    parameters = torch.from_numpy(read_record().parameters).split(POSES)
    frames, worst = {}, {"membership": 0.0, "grade": 0.0, "views_apart": 0}
    for number, (name, config) in enumerate(list(SCENES.items())[: sizes.scenes]):
        rows = parameters[number][: sizes.poses]
        seeds = torch.arange(len(rows)) + POSES * number
        one, other = Phantom(config), Phantom(config, device)
        moved = other.generate(rows.to(device), seeds.to(device))
        frames[name] = _difference(one.generate(rows, seeds), moved)
        pose = parameters_to_pose(rows)
        here = one.judge(pose)
        there = other.judge(type(pose)(*(part.to(device) for part in pose)))
        for key in ("membership", "grade"):
            apart = (getattr(here, key) - getattr(there, key).cpu()).abs().max()
            worst[key] = max(worst[key], float(apart))
        worst["views_apart"] += int((here.view != there.view.cpu()).sum())
    return frames, worst


def _patients(device: str, sizes: Sizes) -> dict[str, Any]:
    """Compare frames of patients at their nominal poses, still and beating."""
    frames: dict[str, Any] = {}
    if not sizes.hearts:
        return frames
    patients = range(FIRST, FIRST + sizes.hearts)
    rows = torch.arange(sizes.hearts).repeat_interleave(5)
    each, seeds = torch.arange(len(rows)), torch.arange(len(rows))
    for name in ("patients", "beating"):
        one, other = (Pool(patients, place, name == "beating") for place in ("cpu", device))
        targets = one.targets(rows)
        pose = type(targets)(*(part[each, each % 5] for part in targets))
        phase = (each[:, None] * torch.tensor([0.13, 0.29])) % 1.0 if name == "beating" else None
        there = other.render(
            type(pose)(*(part.to(device) for part in pose)),
            rows.to(device),
            None if phase is None else phase.double().to(device),
            seeds.to(device),
        )
        here = one.render(pose, rows, None if phase is None else phase.double(), seeds)
        frames[name] = _difference(here, there)
    return frames


def _graphs(device: str) -> dict[str, float] | None:
    """Return how far weights lie apart that PPO learned by a captured graph and step by step."""
    if not device.startswith("cuda"):
        return None
    learned = []
    for graph in (True, False):
        config = PPOConfig(
            observation="params", envs=64, update_every=512, frames=2048, minibatch=128, epochs=4,
            validate_every=1 << 40, validation_starts=1, device=device, cuda_graph=graph,
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            agent = PPOAgent.train(config, Path(folder), progress=False)
        learned.append(torch.cat([x.detach().flatten().cpu() for x in agent.actor.parameters()]))
    fresh = torch.cat([x.flatten() for x in _fresh(device)])
    return {
        "apart": float((learned[0] - learned[1]).abs().max()),
        "moved": float((learned[1] - fresh).abs().max()),
    }


def _fresh(device: str) -> list[torch.Tensor]:
    """Return the weights of an actor that has yet to learn, as a training of seed 0 draws them."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        actor = make_actor(PPOConfig(observation="params", device=device))
    return [each.detach() for each in actor.parameters()]


def _episodes(device: str, sizes: Sizes, reward: str) -> dict[str, Any]:
    """Play the same actions on both devices; rows that part once stay apart."""
    draw = torch.Generator().manual_seed(0)
    actions = torch.randint(len(ACTIONS), (sizes.steps, sizes.rows), generator=draw)
    told = []
    for place in ("cpu", device):
        core = make_core("SC", sizes.rows, observation="params", reward=reward, device=place)
        core.reset(0)
        steps = [core.step(action.to(place)) for action in actions]
        rewards = torch.stack([step.reward for step in steps]).cpu()
        ends = torch.stack([step.terminated | step.truncated for step in steps]).cpu()
        told.append((rewards, ends, core.state.position.cpu()))
    (rewards, ends, places), (others, their_ends, their_places) = told
    return {
        "reward": float((rewards - others).abs().max()),
        "rows_apart": int(((rewards - others).abs() > 1e-3).any(0).sum()),
        "ends_apart": int((ends != their_ends).sum()),
        "position_m": float((places - their_places).abs().max()),
        "rows": sizes.rows,
        "steps": sizes.steps,
    }
