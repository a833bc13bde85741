"""Recorded episodes: what is written, how often, and that it can be run again."""

import json

import gymnasium
import numpy as np
import pytest
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_envs.agents.planner import PlannerAgent
from racines_envs.recordings.episodes import (
    SCHEMA,
    EpisodeRecorder,
    read_recording,
    record_rollout,
    replay,
)
from racines_envs.task.rewards import RewardConfig
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core

ID = "racines_envs:racines/SC-v0"


def make(phantom, folder, reward="oracle", **more):
    env = gymnasium.make(
        ID, phantom=phantom, observation="params", reward=reward, render_mode="rgb_array"
    )
    return EpisodeRecorder(env, folder, **more)


def one_row(phantom, **more):
    settings = {"observation": "params", "reward": "oracle"} | more
    return make_core("SC", 1, phantom=phantom, **settings)


def run(env, count, seed=4):
    env.reset(seed=seed)
    for step in range(count):
        *_, ended, cut, _ = env.step((5 * step) % 13)
        if ended or cut:
            break
    env.close()


def test_a_line_a_step_with_what_the_environment_said(phantom, tmp_path):
    env = make(phantom, tmp_path, video=False)
    env.reset(seed=4)
    said = [env.step(np.int64(action)) for action in (2, 12)]
    env.close()
    assert [path.name for path in env.written] == ["episode_0000.jsonl"]
    header, *steps = map(json.loads, (tmp_path / "episode_0000.jsonl").read_text().splitlines())
    assert header["schema"] == SCHEMA and header["task"]["view"] == "SC"
    assert header["reset_seed"] == 4 and header["reward"] == "oracle" and header["code"]
    assert [line["step"] for line in steps] == [0, 1, 2]
    assert [line["action"] for line in steps] == [None, "+y", "idle"]
    for line, (_, reward, ended, cut, info) in zip(steps[1:], said, strict=True):
        assert line["reward"] == pytest.approx(reward) and info.items() <= line["info"].items()
        assert line["terminated"] == ended and line["truncated"] == cut
    core = env.unwrapped.core
    assert steps[-1]["position"] == core.state.position[0].tolist()
    assert steps[-1]["wrench"] == core.state.wrench[0].tolist()
    assert not list(tmp_path.glob("*.gif"))


def test_a_video_has_a_frame_a_step(phantom, tmp_path):
    run(make(phantom, tmp_path), 3)
    with Image.open(tmp_path / "episode_0000.gif") as video:
        assert video.n_frames == 4 and video.size == (960, 540)


def test_no_more_than_the_maximum(phantom, tmp_path):
    env = make(phantom, tmp_path, maximum=2, video=False)
    for _ in range(4):
        env.reset()
        env.step(0)
    env.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["episode_0000.jsonl", "episode_0001.jsonl"]
    # The first, left by a reset, is written as far as it came.
    assert len(read_recording(tmp_path / names[0]).steps) == 2


def test_a_whole_episode_is_written_at_its_end(phantom, tmp_path):
    env = make(phantom, tmp_path, video=False)
    env.reset(seed=0)
    ended = False
    while not ended:
        assert not env.written
        *_, terminated, truncated, _ = env.step(12)
        ended = terminated or truncated
    assert len(env.written) == 1
    assert read_recording(env.written[0]).steps[-1]["truncated"]


@pytest.mark.parametrize("reward", ["oracle", "shaped"])
def test_a_recording_replays_pose_for_pose(phantom, tmp_path, reward):
    run(make(phantom, tmp_path, reward, video=False), 60)
    done = replay(tmp_path / "episode_0000.jsonl", one_row(phantom, reward=reward))
    assert done.steps == 60 and done.position_error == 0.0 and done.rotation_error == 0.0


def test_a_changed_recording_does_not_replay(phantom, tmp_path):
    run(make(phantom, tmp_path, video=False), 10)
    path = tmp_path / "episode_0000.jsonl"
    lines = path.read_text().splitlines()
    record = json.loads(lines[4])
    record["position"][0] += 1e-4
    path.write_text("\n".join([*lines[:4], json.dumps(record), *lines[5:]]))
    with pytest.raises(RacinesError, match="step 3 does not repeat"):
        replay(path, one_row(phantom))


def test_unreadable_recordings_say_why(phantom, tmp_path):
    run(make(phantom, tmp_path, video=False), 3)
    good = (tmp_path / "episode_0000.jsonl").read_text()
    for text, word in (
        (good[:-20], "no JSON"),
        (good.replace(SCHEMA, "other/1"), "schema"),
        (
            good.replace("idle", "jump").replace("+y", "jump").replace("-z", "jump"),
            "unknown action",
        ),
        (good.splitlines()[0], "ends before"),
    ):
        path = tmp_path / "bad.jsonl"
        path.write_text(text)
        with pytest.raises(RacinesError, match=word):
            read_recording(path)
    with pytest.raises(RacinesError, match="no such recording"):
        read_recording(tmp_path / "absent.jsonl")
    with pytest.raises(RacinesError, match="stand-in"):
        replay(tmp_path / "episode_0000.jsonl")


def test_on_the_phantom_it_replays_from_the_file_alone(real_phantom, tmp_path):
    core = make_core(
        "PL", 3, phantom=real_phantom, observation="params", reward="shaped",
        rewards=RewardConfig(step=-0.3),
    )  # fmt: skip
    seeds = torch.tensor([5, 6, 7])
    written = record_rollout(core, PlannerAgent(), seeds, tmp_path, maximum=2, video=False)
    assert [path.name for path in written] == ["episode_0000.jsonl", "episode_0001.jsonl"]
    for path, seed in zip(written, (5, 6), strict=True):
        recording = read_recording(path)
        assert recording.header["agent"] == "planner" and recording.header["reset_seed"] == seed
        last = recording.steps[-1]
        assert last["terminated"] or last["truncated"]
        done = replay(path)
        assert done.steps == len(recording.steps) - 1
        assert max(done.position_error, done.rotation_error) < 1e-6
        assert done.reward_error is not None and done.reward_error < 1e-3


def test_forces_from_elsewhere_need_their_environment(real_phantom, tmp_path):
    class Weak:
        def wrench(self, pose):
            return torch.zeros(len(pose.position), 6)

    def core():
        return make_core(
            "PL", 1, phantom=real_phantom, observation="params", reward="oracle", forces=Weak()
        )

    seeds = torch.tensor([5])
    (path,) = record_rollout(core(), PlannerAgent(), seeds, tmp_path, video=False)
    with pytest.raises(RacinesError, match="forces of Weak"):
        replay(path)
    assert replay(path, core()).position_error == 0.0


def test_only_our_environments_are_recorded(tmp_path):
    with pytest.raises(RacinesError, match="cannot be recorded"):
        EpisodeRecorder(gymnasium.make("CartPole-v1"), tmp_path)


def test_a_second_recording_overwrites_nothing(phantom, tmp_path):
    core = make_core("SC", 2, observation="params", reward="oracle", phantom=phantom)
    first = record_rollout(core, PlannerAgent(), evaluation_seeds(2), tmp_path, video=False)
    before = [path.read_bytes() for path in first]
    second = record_rollout(core, PlannerAgent(), evaluation_seeds(2), tmp_path, video=False)
    assert not set(first) & set(second) and len(second) == 2
    assert [path.read_bytes() for path in first] == before
