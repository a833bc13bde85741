"""The oracle by hand: a probe at the origin that looks along z, and structures where they suit."""

import math

import pytest
import torch
from torch import Tensor

from racines_data.geometry import Pose, axis_angle_to_matrix
from racines_data.phantom.config import ProbeConfig
from racines_data.phantom.heart import heart
from racines_data.phantom.truth import Oracle, Truth, make_oracle

PROBE = ProbeConfig()
HERE = Pose(torch.zeros(1, 3), torch.eye(3)[None])
AHEAD = (0.0, 0.0, 0.08)
HALF_SEEN = (0.0, 0.006, 0.08)  # 0.6 radii out of the plane: exp(-1/2)


def oracle(*centres: tuple[float, float, float]) -> Oracle:
    """One view, of structures of 1 cm that weigh alike, from where the probe stands."""
    count = len(centres)
    return Oracle(
        torch.tensor(centres), torch.full((count,), 0.01), torch.full((1, count), 1 / count), HERE
    )


def judged(*centres: tuple[float, float, float], coupling: float | Tensor = 1.0) -> Truth:
    beams = torch.as_tensor(coupling).expand(1, PROBE.beams)
    return oracle(*centres).judge(HERE, PROBE, beams)


def sigmoid(x: float) -> float:
    return 1 / (1 + math.exp(-x))


def at(angle: float, radius: float) -> tuple[float, float, float]:
    return radius * math.sin(angle), 0.0, radius * math.cos(angle)


@pytest.mark.parametrize(
    ("centre", "expected"),
    [
        (AHEAD, 1.0),
        (HALF_SEEN, math.exp(-0.5)),
        (at(0.0, PROBE.depth), 0.5),
        (at(0.0, PROBE.depth + 0.01), sigmoid(-5.0)),
        (at(PROBE.half_angle, 0.08), 0.5),
        (at(-PROBE.half_angle, 0.08), 0.5),
        (at(PROBE.half_angle + 0.1, 0.08), sigmoid(-4.0)),
    ],
)
def test_a_structure_is_seen_in_the_plane_the_sector_and_the_depth(centre, expected):
    assert judged(centre).visibility.item() == pytest.approx(expected, abs=1e-4)


def test_a_structure_is_seen_as_well_as_its_own_beam_is_coupled():
    coupling = torch.zeros(PROBE.beams)
    beam = round((0.5 * PROBE.half_angle / PROBE.half_angle + 1) / 2 * (PROBE.beams - 1))
    coupling[beam] = 0.25
    seen = judged(at(0.34, 0.08), at(-0.34, 0.08), coupling=coupling).visibility
    assert seen[0].tolist() == pytest.approx([0.5, 0.0], abs=1e-4)


def test_one_lost_structure_spoils_the_view():
    complete = math.sqrt(math.exp(-0.5))  # a geometric mean
    truth = judged(AHEAD, HALF_SEEN)
    assert truth.view_grade.item() == pytest.approx(10 * (complete - 0.5) / 0.45, abs=1e-3)
    assert truth.membership.item() == pytest.approx(sigmoid((complete - 0.6) / 0.035), abs=1e-3)
    lost = judged(AHEAD, (0.0, 0.05, 0.08))
    assert lost.view.item() == 1 and lost.grade.item() == lost.view_grade.item() == 0.0
    rows = Pose(torch.zeros(3, 3), torch.eye(3).expand(3, 3, 3))
    many = oracle((0.0, 0.05, 0.08)).judge(rows, PROBE, torch.ones(3, PROBE.beams))
    assert many.view.tolist() == [1, 1, 1], "Random comes after the views, however many poses"


@pytest.mark.parametrize("coupling", [0.64, 0.49, 0.36])
def test_poor_contact_lowers_grade_and_membership(coupling):
    truth, seen = judged(AHEAD, coupling=coupling), math.sqrt(coupling)
    grade = 10 * (seen - 0.5) / 0.45 * coupling
    attained = sigmoid((seen - 0.6) / 0.035) * sigmoid((coupling - 0.35) / 0.04)
    assert truth.clarity.item() == pytest.approx(coupling)
    assert truth.view_grade.item() == pytest.approx(grade, abs=1e-3)
    assert truth.membership.item() == pytest.approx(attained, abs=1e-3)
    assert truth.view.item() == (0 if attained > 0.5 else 1)
    assert truth.grade.item() == pytest.approx(grade if attained > 0.5 else 0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("roll", "expected"), [(0.0, 1.0), (0.26, 1.0), (0.48, 0.5), (0.59, 0.15625), (0.70, 0.0)]
)
def test_a_picture_may_be_turned_in_its_plane_so_far(roll, expected):
    for angle in (roll, -roll):
        turned = HERE.rotation @ axis_angle_to_matrix(torch.tensor([[0.0, angle, 0.0]]))
        display = oracle(AHEAD)._display(Pose(HERE.position, turned))
        assert display.item() == pytest.approx(expected, abs=1e-4)


def test_a_mirrored_picture_is_no_standard_display():
    mirrored = axis_angle_to_matrix(torch.tensor([[0.0, 0.0, math.pi]]))
    assert oracle(AHEAD)._display(Pose(HERE.position, mirrored)).item() == 0.0


@pytest.mark.parametrize(
    ("away", "expected"), [(0.0, 1.0), (0.015, 1.0), (0.025, 0.5), (0.030, 0.15625), (0.035, 0.0)]
)
def test_a_view_is_had_near_its_window(away, expected):
    place = torch.tensor([[0.6 * away, -0.8 * away, 0.02]])  # the height does not count
    window = oracle(AHEAD)._window(Pose(place, HERE.rotation))
    assert window.item() == pytest.approx(expected, abs=1e-4)


def test_display_and_window_count_in_the_score():
    shifted = Pose(torch.tensor([[0.0, 0.025, 0.0]]), HERE.rotation)
    turned = axis_angle_to_matrix(torch.tensor([[0.0, 0.48, 0.0]]))
    moved = oracle(AHEAD)._replace(centres=torch.tensor([[0.0, 0.025, 0.08]]))
    for pose in (shifted, Pose(shifted.position, turned)):
        truth = moved.judge(pose, PROBE, torch.ones(1, PROBE.beams))
        assert truth.visibility.item() > 0.9 and truth.membership.item() < 0.1
    rolled = oracle(AHEAD).judge(Pose(HERE.position, turned), PROBE, torch.ones(1, PROBE.beams))
    assert rolled.visibility.item() > 0.9 and rolled.membership.item() < 0.1


def test_targets_stand_on_the_skin_and_look_at_their_focus():
    anatomy, surface = heart(), 0.065
    built = make_oracle(anatomy, surface, torch.device("cpu"))
    axes, origin = torch.tensor(anatomy.axes), torch.tensor(anatomy.origin)
    assert torch.allclose(built.weights.sum(1), torch.ones(len(anatomy.views)))
    for view, position, rotation in zip(anatomy.views, *built.targets, strict=True):
        assert position[2].item() == pytest.approx(surface - view.indentation, abs=1e-6)
        assert torch.allclose(rotation.T @ rotation, torch.eye(3), atol=1e-5)
        assert torch.linalg.det(rotation).item() == pytest.approx(1.0, abs=1e-5)
        ray = torch.tensor(view.focus) @ axes + origin - position
        lateral, elevation, axial = (rotation.T @ ray).tolist()
        assert axial > 0.0 and (lateral, elevation) == pytest.approx((0.0, 0.0), abs=1e-6)
        normal = torch.nn.functional.normalize(torch.tensor(view.normal) @ axes, dim=0)
        assert torch.allclose(rotation[:, 1], normal, atol=1e-5)
        assert float(rotation[:, 2] @ (torch.tensor(view.beam) @ axes)) > 0.0
