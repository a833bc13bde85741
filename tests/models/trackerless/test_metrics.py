"""Motion and its errors, against what a hand computes."""

import math

import pytest
import torch

from racines_data.geometry import Pose, axis_angle_to_matrix, parameters_to_pose
from racines_data.patients import Pool
from racines_models.trackerless.landmarks import Landmarks, landmarks
from racines_models.trackerless.metrics import METRICS, PIXELS, errors, pixel_errors
from racines_models.trackerless.motion import (
    Motion,
    chained,
    from_vectors,
    matrices,
    relative,
    steps,
    to_vectors,
)
from racines_models.trackerless.planes import pixel_of, sector_plane, stated_plane
from tests.models.trackerless.sweeping import sweep_parameters

PIXEL = 1.5
EYE = torch.eye(4, dtype=torch.float64)


def marks(*places: tuple[int, int, int]) -> Landmarks:
    return Landmarks(*torch.tensor(places).T)


MARKS = marks((1, 10, 20), (2, 100, 64), (3, 0, 127))


def shifted(*shifts: tuple[float, float, float]) -> Motion:
    """The motion of pure shifts from frame to frame, m."""
    vectors = torch.tensor(shifts, dtype=torch.float64)
    return steps(torch.cat([vectors, torch.zeros_like(vectors)], 1))


def test_poses_make_the_motion_that_leads_back_to_them():
    pose = parameters_to_pose(sweep_parameters(3).double())
    motion = relative(pose)
    assert torch.equal(motion.to_first[0], EYE) and torch.equal(motion.to_previous[0], EYE)
    world = matrices(pose.rotation, pose.position)
    assert torch.allclose(world[0] @ motion.to_first, world, atol=1e-12)
    assert torch.allclose(world[:-1] @ motion.to_previous[1:], world[1:], atol=1e-12)
    assert torch.allclose(chained(motion.to_previous).to_first, motion.to_first, atol=1e-12)
    vectors = to_vectors(motion.to_previous)
    assert torch.allclose(from_vectors(vectors), motion.to_previous, atol=1e-9)
    assert torch.allclose(steps(vectors[1:]).to_first, motion.to_first, atol=1e-9)


def test_steps_are_composed_in_the_frame_that_they_turned_to():
    """A quarter turn about the beam, then 10 mm to the image's right: out of the first plane."""
    quarter = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2], dtype=torch.float64)
    right = torch.tensor([0.01, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    found = steps(torch.stack([quarter, right])).to_first[2]
    expected = torch.tensor([[0, -1, 0, 0], [1, 0, 0, 0.01], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    assert torch.allclose(found, expected.double(), atol=1e-12)


def test_the_truth_has_no_error():
    motion = relative(parameters_to_pose(sweep_parameters(5).double()))
    told = errors(motion, motion, sector_plane(PIXEL), MARKS)
    assert told == dict.fromkeys(METRICS, 0.0)


def test_pure_shifts_give_exact_numbers():
    """3, 4 and 0 mm a step, wrongly taken for rest: 5 mm a step, 5, 10 and 15 mm in all."""
    true = shifted(*[(0.003, 0.004, 0.0)] * 3)
    rest = shifted(*[(0.0, 0.0, 0.0)] * 3)
    told = errors(rest, true, sector_plane(PIXEL), MARKS)
    assert told["lpe"] == pytest.approx(5.0, abs=1e-12)
    assert told["lle"] == pytest.approx(5.0, abs=1e-12)
    assert told["gpe"] == pytest.approx(10.0, abs=1e-12)
    assert told["gle"] == pytest.approx(10.0, abs=1e-12)
    assert told["step_mm"] == pytest.approx(5.0) and told["drift_mm"] == pytest.approx(15.0)
    assert told["step_deg"] == told["drift_deg"] == 0.0
    uneven = errors(rest, true, sector_plane(PIXEL), marks((3, 1, 1), (3, 2, 2), (1, 3, 3)))
    assert uneven["gle"] == pytest.approx((15 + 15 + 5) / 3)


def test_a_turn_moves_a_pixel_by_its_distance_from_the_axis():
    """About the beam's axis by θ: 2 sin(θ/2) · |x|, whatever the depth."""
    angle = 0.3
    true = steps(torch.tensor([[0.0, 0, 0, 0, 0, angle]], dtype=torch.float64))
    off = (true.to_first - EYE)[1:, :3]
    found = pixel_errors(off, sector_plane(PIXEL))[0]
    x = ((torch.arange(128, dtype=torch.float64) - 63.5) * PIXEL).abs()
    expected = (2 * math.sin(angle / 2) * x).expand(128, 128)
    assert torch.allclose(found, expected, atol=1e-9)
    told = errors(steps(torch.zeros(1, 6)), true, sector_plane(PIXEL), marks((1, 7, 0)))
    assert told["gpe"] == pytest.approx(float(expected.mean()))
    assert told["gle"] == pytest.approx(2 * math.sin(angle / 2) * 63.5 * PIXEL)
    assert told["drift_deg"] == pytest.approx(math.degrees(angle))
    about_y = steps(torch.tensor([[0.0, 0, 0, 0, angle, 0]], dtype=torch.float64))
    deep = errors(steps(torch.zeros(1, 6)), about_y, sector_plane(PIXEL), marks((1, 127, 63)))
    far = math.hypot(0.5 * PIXEL, 127.5 * PIXEL)
    assert deep["gle"] == pytest.approx(2 * math.sin(angle / 2) * far)


def test_errors_of_a_frame_are_its_own():
    pose = parameters_to_pose(sweep_parameters(7).double())
    off = (relative(pose).to_first - EYE)[:, :3]
    whole = pixel_errors(off, sector_plane(PIXEL))
    alone = torch.cat([pixel_errors(off[i : i + 1], sector_plane(PIXEL)) for i in range(len(off))])
    assert torch.equal(whole, alone)


def test_a_plane_lies_where_a_calibration_says():
    """Distances do not hang on whose frame they are told in: the marker's, or the image's."""
    rotation = axis_angle_to_matrix(torch.tensor([0.4, -0.2, 0.9], dtype=torch.float64))
    shift = torch.tensor([11.0, 50.0, -7.0], dtype=torch.float64)
    usual = sector_plane(0.6)
    origin = rotation @ usual.origin + shift
    numbers = torch.cat([origin, rotation @ usual.across, rotation @ usual.down])
    plane = stated_plane(numbers.tolist(), "here")
    image = relative(parameters_to_pose(sweep_parameters(9).double()))
    calibration = matrices(rotation, shift * 1e-3)
    back = torch.linalg.inv(calibration)
    marker = Motion(*(calibration @ each @ back for each in image))
    rest = steps(torch.zeros(7, 6))
    one, other = (errors(rest, *pair, MARKS) for pair in ((image, usual), (marker, plane)))
    assert [one[key] for key in PIXELS] == pytest.approx([other[key] for key in PIXELS])


def test_what_is_not_known_is_not_told():
    motion = relative(parameters_to_pose(sweep_parameters(5).double()))
    rest = steps(torch.zeros(7, 6))
    assert set(errors(rest, motion, None, MARKS)) == set(METRICS) - set(PIXELS)
    unscaled = errors(rest, motion, sector_plane(PIXEL), MARKS, metric=False)
    assert set(unscaled) == {"drift_deg", "step_deg"}


def test_landmarks_are_corners_spread_over_the_frames_but_the_first():
    images = torch.zeros(9, 128, 128, dtype=torch.uint8)
    for frame in range(9):
        images[frame, 40 + frame : 60 + frame, 30:70] = 200
    found = landmarks(images, 20)
    assert found.frame.min() == 1 and found.frame.max() == 8 and len(found.frame) == 20
    assert found.frame.bincount(minlength=9)[1:].min() >= 2
    edges = torch.stack([40 + found.frame, 59 + found.frame], 1)
    assert ((found.row.unsqueeze(1) - edges).abs().min(1).values <= 3).all()
    assert ((found.column.unsqueeze(1) - torch.tensor([30, 69])).abs().min(1).values <= 3).all()
    pairs = set(zip(*(each.tolist() for each in found), strict=True))
    assert len(pairs) == 20, "no place stands twice"
    blank = landmarks(torch.zeros(4, 128, 128, dtype=torch.uint8), 3)
    assert blank.row.tolist() == blank.column.tolist() == [64, 64, 64]


def test_a_patients_pixels_are_those_of_the_pool():
    seeds = [1, 10_003, 20_007]
    told = Pool(seeds).pixel_size(torch.arange(3)).tolist()
    assert [pixel_of(seed) for seed in seeds] == pytest.approx(told, rel=1e-9)


def test_poses_far_from_the_base_lose_nothing():
    pose = parameters_to_pose(sweep_parameters(11).double())
    moved = Pose(pose.position + 100.0, pose.rotation)
    assert torch.allclose(relative(moved).to_first, relative(pose).to_first, atol=1e-11)
