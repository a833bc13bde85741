"""Scouts: a function of patient and seed alone, with poses where their strata say."""

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, parameters_to_pose, pose_keys
from racines_data.patients import Pool
from racines_data.patients.scouts import (
    FRAMES,
    POSES,
    STRATA,
    check_asked,
    nearest,
    plan,
    scout,
    strata_names,
    strata_of,
)
from racines_data.patients.splits import seeds_of
from racines_data.store.asked import AskedStore
from racines_data.store.hearts import hearts_of
from racines_data.store.scouts import ScoutsConfig, lying
from tests.data.patients.conftest import SEEDS


@pytest.fixture(scope="module")
def still(own_cache):
    return Pool(SEEDS)


@pytest.fixture(scope="module")
def scouted(still):
    return scout(still, 0)


def test_a_patients_scout_is_their_own(still, scouted):
    """Alone, or among others in another order: the same bytes; another seed: another sweep."""
    alone = scout(Pool([SEEDS[1]]), 0)
    for name, column in scouted._asdict().items():
        assert torch.equal(column[1:2], getattr(alone, name)), name
    assert not torch.equal(plan(still, 1, 1)[0], scouted.parameters[1])
    assert not torch.equal(scouted.parameters[0], scouted.parameters[1])


def test_poses_lie_in_their_strata_and_show_the_heart(still, scouted):
    share = POSES // len(strata_names())
    wanted = torch.arange(POSES) // share
    for row in range(len(SEEDS)):
        assert torch.equal(strata_of(scouted.distances[row]), wanted)
        away = nearest(scouted.asked[row], scouted.parameters[row]) * 1e3
        assert torch.equal(away, scouted.distances[row]) and float(away.max()) < STRATA[-1]
    poses = parameters_to_pose(scouted.asked.flatten(0, 1).double())
    rows = torch.arange(len(SEEDS)).repeat_interleave(POSES)
    truth = still.judge(poses, rows)
    assert bool((truth.visibility.amax(1) > 0.29).all()) and bool((truth.clarity > 0.34).all())
    assert bool((still.wrench(poses)[:, 2] >= -20.01).all())


def test_a_scout_is_a_sweep_over_the_heart(still, scouted):
    """It moves on at an even pace, passes near every view, and sees most of the heart."""
    assert scouted.images.shape == (len(SEEDS), FRAMES, 128, 128)
    for row in range(len(SEEDS)):
        pose = parameters_to_pose(scouted.parameters[row])
        step = (pose.position[1:] - pose.position[:-1]).norm(dim=1)
        assert float(step.median()) < 0.01 and float(step.sum()) > 0.1
        targets = Pose(*(x[0] for x in still.targets(torch.tensor([row]))))
        passed = pose_keys(pose, 0.07)
        pace = passed.diff(dim=0).norm(dim=1)
        assert float(pace.max()) < min(0.04, 4.0 * float(pace.median()))
        keys = pose_keys(targets, 0.07), passed
        assert float(torch.cdist(*keys).amin(1).max()) < 0.03
        rows = torch.full((FRAMES,), row)
        seen = still.judge(Pose(*(x.double() for x in pose)), rows).visibility.amax(0)
        assert float((seen > 0.5).float().mean()) > 0.8


def test_seen_again_differs_by_noise_alone(scouted):
    again = (scouted.again.float() - scouted.truth.float()).abs().mean()
    others = (scouted.truth.roll(1, 1).float() - scouted.truth.float()).abs().mean()
    assert 0.0 < float(again) < 0.5 * float(others)
    assert 0 < int(scouted.masks.max()) < 20


def test_poses_of_another_patient_are_refused(scouted):
    check_asked(SEEDS[0], scouted.parameters[0], scouted.asked[0])
    with pytest.raises(RacinesError, match=r"patient 10000: pose \d+ lies .* of another patient"):
        check_asked(SEEDS[0], scouted.parameters[0], scouted.asked[1])


def test_a_damaged_file_of_what_is_asked_is_named(own_cache, tmp_path):
    AskedStore("validation", SEEDS[:1], 0, tmp_path)
    (path,) = tmp_path.glob("*.safetensors")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(RacinesError, match=rf"{path.name}: damaged .* made anew"):
        AskedStore("validation", SEEDS[:1], 0, tmp_path)


def test_hearts_that_beat_have_no_scout(pool):
    with pytest.raises(RacinesError, match="still hearts"):
        plan(pool, 0, 0)


def test_what_is_asked_is_a_store(still, scouted, tmp_path):
    asked = AskedStore("validation", SEEDS[:2], 0, tmp_path)
    assert len(asked) == 2 * POSES and asked.units(torch.tensor([0, POSES])).tolist() == [
        *SEEDS[:2]
    ]
    assert torch.equal(asked.images, scouted.truth[:2].flatten(0, 1))
    assert torch.equal(asked.scouts, scouted.images[:2])
    place = still.hearts[1].placement
    found = hearts_of(asked, torch.tensor([POSES]))
    torch.testing.assert_close(found.axes[0], place.axes)
    torch.testing.assert_close(found.origin[0], place.origin)
    again = AskedStore("validation", SEEDS[:2], 0, tmp_path)  # from the folder
    assert torch.equal(again.images, asked.images) and again.digest == asked.digest
    assert AskedStore("validation", SEEDS[:1], 0, tmp_path).digest != asked.digest
    with pytest.raises(RacinesError, match="seed 10000 is a patient of validation"):
        AskedStore("test", SEEDS[:1], 0)
    with pytest.raises(RacinesError, match="split 'test' has 1 to 140"):
        AskedStore("test", 141, 0)


def test_a_heart_lies_as_others_of_its_split():
    here = lying(3, 4)
    assert [each.form for each in here] == [here[0].form] * 4
    assert len({each.place for each in here}) == 4
    assert ScoutsConfig(train=(4, 7)).seeds("train") == (4, 7)
    with pytest.raises(RacinesError, match=f"{len(seeds_of('train')) + 1}: the split has"):
        ScoutsConfig(train=len(seeds_of("train")) + 1).seeds("train")


def test_a_distance_counts_shifts_and_turns():
    parameters = torch.zeros(2, 12)
    parameters[1, 6], parameters[1, 11] = 0.003, 0.1
    pose = parameters_to_pose(parameters)
    turn = float(geodesic(pose.rotation[:1], pose.rotation[1:]))
    wanted = (0.003**2 + (0.07 * 2.0 * torch.sin(torch.tensor(turn / 2.0))) ** 2) ** 0.5
    assert abs(float(nearest(parameters[:1], parameters[1:])) - float(wanted)) < 1e-6
