"""A finished dataset on a sheet: its sweeps are its own, and what is wrong stands below."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from typer.testing import CliRunner

from racines_data.geometry import parameters_to_pose
from racines_data.store.frames import FrameStore
from racines_data.validate.inspecting import inspect_dataset
from racines_leaderboard.cli.command import app


def test_sweeps_are_the_datasets_own(tiny_root: Path):
    made, store = inspect_dataset(tiny_root), FrameStore(tiny_root)
    assert sorted(each.name for each in made.drafts) == sorted(store.trajectories)
    assert made.frames == sum(len(each.rows) for each in made.drafts) == len(store.images)
    assert made.words() == [] and made.unit == "mm" and len(made.images) == 6
    lengths = [len(each.rows) for each in made.drafts]
    assert lengths == sorted(lengths, reverse=True)
    first = made.drafts[0]
    pose = parameters_to_pose(store.parameters[torch.from_numpy(first.rows)].double())
    assert np.allclose(first.poses[:, :3, 3], pose.position) and np.all(np.diff(first.times) > 0)
    assert np.allclose(first.poses[:, :3, :3], pose.rotation)
    shown = [image for _, image in made.images]
    assert np.array_equal(shown[0], store.images[first.rows[0]])


def test_the_command_draws_and_says_what_is_wrong(tiny_root: Path, tmp_path: Path):
    run, out = CliRunner(), tmp_path / "sheet.png"
    words = ["data", "inspect", str(tiny_root), "--out", str(out)]
    done = run.invoke(app, words)
    assert done.exit_code == 0 and "nothing looks wrong" in done.output
    assert Image.open(io.BytesIO(out.read_bytes())).size[0] > 1000
    copied = tmp_path / "data"
    shutil.copytree(tiny_root, copied)
    card = copied / "README.md"
    card.write_text(card.read_text() + "\nAltered.\n")
    told = run.invoke(app, ["data", "inspect", str(copied), "--out", str(out), "--json"])
    wrong = json.loads(told.stdout)["wrong"]
    assert len(wrong) >= 1 and "README.md" in wrong[0], wrong
    refused = run.invoke(app, [*words, "--allow", "looks-up"])
    assert refused.exit_code == 1 and "a dataset has its own" in str(refused.exception)
