"""The audit of leaks: half a trajectory planted in a held-out one is found, whatever it wears."""

import dataclasses
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.geometry import matrix_to_euler
from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.model import shared_phantom
from racines_data.schema import SPLITS, Trajectory
from racines_data.sources.base import Unit
from racines_data.store.frames import FrameStore, open_store
from racines_data.validate.leaks import (
    BESIDE_LIMIT,
    COPIES_LIMIT,
    LIKENESS,
    SweepLeak,
    check_leaks,
    find_leaks,
    leaks_json,
)
from racines_data.validate.run import validate
from tests.data.fake_source import FakeConfig, FakeSource


def noisy(images: Tensor, level: float) -> Tensor:
    noise = level * torch.randn(images.shape, generator=torch.Generator().manual_seed(1))
    return (images + noise).round().clamp(0, 255).to(torch.uint8)


def encoded(images: Tensor, quality: int) -> Tensor:
    made = []
    for image in images.numpy():
        file = io.BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=quality)
        made.append(np.asarray(Image.open(file)))
    return torch.from_numpy(np.stack(made))


def scaled(images: Tensor, gain: float, gamma: float = 1.0) -> Tensor:
    return (255 * gain * (images / 255) ** gamma).clamp(0, 255).to(torch.uint8)


DISGUISES: dict[str, Callable[[Tensor], Tensor]] = {
    "none": lambda images: images,
    "JPEG of quality 75": lambda images: encoded(images, 75),
    "JPEG of quality 50": lambda images: encoded(images, 50),
    "noise of 3 gray levels": lambda images: noisy(images, 3),
    "noise of 8 gray levels": lambda images: noisy(images, 8),
    "mirrored": lambda images: images.flip(2),
    "mirrored, encoded and noisy": lambda images: noisy(encoded(images.flip(2), 75), 2),
    "half as bright": lambda images: scaled(images, 0.5),
    "gamma 0.8": lambda images: scaled(images, 1.0, 0.8),
    "backwards": lambda images: images.flip(0),
    "later by a third": lambda images: images.roll(len(images) // 3, 0),
    "every other frame, twice": lambda images: images[::2].repeat_interleave(2, 0)[: len(images)],
}


@pytest.fixture
def store(tiny_root: Path) -> FrameStore:
    """A dataset of the phantom; what a test writes into it stays with the test."""
    return open_store(tiny_root)


def sweeps_of(store: FrameStore, split: str) -> list[Tensor]:
    """Return the rows of each trajectory of a split, longest first."""
    rows = store.split_indices(split)
    index = store.trajectory_index[rows]
    return sorted((rows[index == each] for each in index.unique()), key=len, reverse=True)


def planted(store: FrameStore, disguise: Callable[[Tensor], Tensor], split="test") -> str:
    """Put frames of one training sweep into half of a held-out one; return the latter's name."""
    source, victim = sweeps_of(store, "train")[0], sweeps_of(store, split)[0]
    half = victim[: len(victim) // 2]
    store.images[half] = disguise(store.images[source[: len(half)]].clone())
    return store.trajectories[int(store.trajectory_index[victim[0]])]


def of(found: list[SweepLeak], name: str) -> SweepLeak:
    return next(sweep for sweep in found if sweep.trajectory == name)


def test_a_dataset_of_the_phantom_has_no_leak(store: FrameStore):
    found = find_leaks(store)
    assert [sweep.split for sweep in found] == ["validation"] * 5 + ["test"] * 5
    assert sum(sweep.frames for sweep in found) == len(store) - store.bounds("train")[1]
    assert not any(sweep.leaks or sweep.exact for sweep in found)
    assert "none of 10 held-out trajectories leaks" in check_leaks(found)
    assert leaks_json(found)["leaking"] == []


@pytest.mark.parametrize("name", DISGUISES)
@pytest.mark.parametrize("split", ["validation", "test"])
def test_half_a_planted_trajectory_is_found(store: FrameStore, name: str, split: str):
    clean = find_leaks(store)
    victim = planted(store, DISGUISES[name], split)
    found = find_leaks(store)
    assert of(found, victim).leaks and not of(clean, victim).leaks
    source = store.trajectories[int(store.trajectory_index[sweeps_of(store, "train")[0][0]])]
    assert of(found, victim).source == source or of(found, victim).from_source < 0.5
    assert [sweep.trajectory for sweep in found if sweep.leaks] == [victim]
    with pytest.raises(RacinesError, match=f"trajectory {victim} of {split} leaks"):
        check_leaks(found)


def test_validation_planted_in_test_is_found(store: FrameStore):
    source, victim = sweeps_of(store, "validation")[0], sweeps_of(store, "test")[0]
    half = victim[: min(len(victim) // 2, len(source))]
    store.images[half] = noisy(store.images[source[: len(half)]].clone(), 3)
    assert [sweep.split for sweep in find_leaks(store) if sweep.leaks] == ["test"]


def test_one_exact_or_mirrored_frame_is_enough(store: FrameStore):
    for turn in (False, True):
        source, victim = sweeps_of(store, "train")[0], sweeps_of(store, "test")[0]
        image = store.images[source[3]].clone()
        store.images[victim[2]] = image.flip(1) if turn else image
        (leak,) = (sweep for sweep in find_leaks(store) if sweep.leaks)
        assert leak.exact == 1 and (leak.mirrored > 0) >= turn


def test_a_sweep_whose_every_other_frame_is_in_training_is_found():
    """No frame is a copy: the probe moved between them. Frames 0, 2, … train and 1, 3, … test."""
    store = scanned([(0.0, 0, "train"), (0.02, 1, "train"), (0.0, 2, "train")])
    rows = sweeps_of(store, "train")
    there = {0: rows[0][::2], 1: rows[1], 2: rows[0][1::2]}
    order = torch.cat([there[0], there[1], there[2]])
    store.images = store.images[order]
    store.trajectory_index = torch.repeat_interleave(torch.tensor([len(r) for r in there.values()]))
    ends = [len(there[0]) + len(there[1]), len(order)]
    store._splits = {"train": [0, ends[0]], "validation": [ends[0]] * 2, "test": ends}
    (leak,) = find_leaks(store)
    assert leak.beside > BESIDE_LIMIT and leak.exact == 0 and leak.copies < 1


def scanned(sweeps: list[tuple[float, int, str]], step: float = 0.0005) -> FrameStore:
    """Scan the same line by several sweeps: (offset across, m; seed of the noise; split) each."""
    phantom, count = shared_phantom(PhantomConfig()), 24
    pose = phantom.target("A4C")
    line = torch.zeros(count, 12)
    line[:, 6:9] = pose.position
    line[:, 9:] = matrix_to_euler(pose.rotation)
    line[:, 6] += step * (torch.arange(count) - count / 2)
    store = FrameStore.__new__(FrameStore)
    images = []
    for across, seed, _ in sweeps:
        moved = line.clone()
        moved[:, 7] += across
        images.append(phantom.generate(moved, torch.arange(count) + 1000 * seed))
    store.images = torch.cat(images)
    store.trajectory_index = torch.arange(len(sweeps)).repeat_interleave(count)
    store.trajectories = [f"sweep-{index}" for index in range(len(sweeps))]
    splits = [split for *_, split in sweeps]
    edges = {name: [splits.index(name) * count if name in splits else 0] * 2 for name in SPLITS}
    for name in splits:
        edges[name] = [edges[name][0], edges[name][1] + count]
    store._splits = edges
    return store


@pytest.mark.parametrize("across", [0.002, 0.001])
def test_a_still_heart_scanned_along_a_near_line_is_no_leak(across: float):
    """Similar, and no leak: the anatomy is the same, and the speckle another's."""
    found = find_leaks(
        scanned([(0.0, 0, "train"), (across, 1, "validation"), (-across, 2, "test")])
    )
    assert [sweep.leaks for sweep in found] == [False, False]
    assert all(sweep.likeness > 0.5 for sweep in found), "they are similar"
    assert all(sweep.copies == 0 for sweep in found)


def test_noise_that_resembles_nothing_is_no_leak(built: Path):
    found = find_leaks(open_store(built))
    assert len(found) == 10 and not any(sweep.leaks for sweep in found)
    assert max(sweep.likeness for sweep in found) < 0.5


def test_frames_without_a_neighbour_or_without_train_are_no_fault(store: FrameStore):
    store.trajectory_index = torch.arange(len(store))
    store.trajectories = [f"{row}" for row in range(len(store))]
    assert all(sweep.beside == 0 for sweep in find_leaks(store))
    store._splits["train"] = [0, 0]
    assert find_leaks(store) == [] and "not told" in check_leaks([])


def test_a_blank_frame_is_like_nothing(store: FrameStore):
    store.images[:] = 7
    assert all(sweep.likeness == 0 and not sweep.leaks for sweep in find_leaks(store))


def test_limits_are_passed_only_beyond_them():
    sweep = SweepLeak("a", "test", 100, 0, COPIES_LIMIT, BESIDE_LIMIT, 0.0, LIKENESS, "b", 1.0)
    assert not sweep.leaks
    for change in ({"exact": 1}, {"copies": COPIES_LIMIT + 0.01}, {"beside": BESIDE_LIMIT + 0.01}):
        assert dataclasses.replace(sweep, **change).leaks


class CopyingSource(FakeSource):
    """Trajectories 2k and 2k + 1 hold the same pictures, each with noise of its own."""

    def produce(self, unit: Unit) -> Trajectory:
        number = int(unit.id[1:])
        pair = dataclasses.replace(unit, id=f"t{number - number % 2:03d}")
        images = torch.from_numpy(super().produce(pair).images)
        noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(number))
        made = (images + 3 * noise).round().clamp(0, 255).to(torch.uint8)
        return dataclasses.replace(super().produce(unit), images=made.numpy())


def test_validate_fails_on_a_leak_without_one_equal_frame(tmp_path: Path):
    build(CopyingSource(FakeConfig()), tmp_path / "racines", DataConfig(workers=1))
    result = validate(tmp_path / "racines")
    faults = {check.name: check.detail for check in result.checks if not check.ok}
    assert "leaks: 100% of its 10 frames are copies (0 exact)" in faults["leaks"]
    assert "copies" not in faults and not result.ok
    assert result.figures["frames"]["leaks"]["leaking"]
