import math

import pytest
import torch

from racines_data import geometry
from racines_data.errors import RacinesError
from racines_data.imaging import check_images, check_parameters


def angles(count: int = 500) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    u = torch.rand((count, 3), generator=generator, dtype=torch.float64) * 2 - 1
    return u * torch.tensor([math.pi, math.pi / 2 - 0.01, math.pi])


def test_euler_round_trip_keeps_the_rotation() -> None:
    rotation = geometry.euler_to_matrix(angles())
    again = geometry.euler_to_matrix(geometry.matrix_to_euler(rotation))
    assert (rotation - again).abs().max() < 1e-9
    assert (geometry.matrix_to_euler(rotation) - angles()).abs().max() < 1e-7


def test_euler_is_extrinsic_xyz() -> None:
    turned = geometry.euler_to_matrix(torch.tensor([[0.3, 0.5, 0.7]], dtype=torch.float64))[0]
    parts = [
        geometry.axis_angle_to_matrix(v) for v in torch.diag(torch.tensor([0.3, 0.5, 0.7])).double()
    ]
    assert torch.allclose(turned, parts[2] @ parts[1] @ parts[0])


def test_a_probe_that_looks_down_has_rotation_x_of_pi() -> None:
    down = geometry.euler_to_matrix(torch.tensor([[math.pi, 0.0, 0.4]]))[0]
    assert torch.allclose(down[:, 2], torch.tensor([0.0, 0.0, -1.0]), atol=1e-6)


def test_geodesic_is_exact_for_small_and_large_angles() -> None:
    eye = torch.eye(3, dtype=torch.float64)
    for angle in (1e-7, 1e-3, 1.0, 3.0):
        turned = geometry.axis_angle_to_matrix(torch.tensor([0.0, angle, 0.0], dtype=torch.float64))
        assert geometry.geodesic(eye, turned) == pytest.approx(angle, rel=1e-6)


def test_orthonormalise_repairs_drift_and_leaves_rotations_alone() -> None:
    rotation = geometry.euler_to_matrix(angles(20))
    assert (geometry.orthonormalise(rotation) - rotation).abs().max() < 1e-12
    fixed = geometry.orthonormalise(rotation * 1.01 + 0.001)
    eye = torch.eye(3, dtype=torch.float64).expand(20, 3, 3)
    assert torch.allclose(fixed @ fixed.transpose(1, 2), eye, atol=1e-12)
    assert (torch.linalg.det(fixed) > 0).all()


def test_six_dimensional_rotation_is_continuous_where_euler_jumps() -> None:
    near = torch.tensor([[math.pi - 1e-4, 0.1, 0.2], [-math.pi + 1e-4, 0.1, 0.2]])
    a, b = geometry.rotation_6d(geometry.euler_to_matrix(near))
    assert (a - b).abs().max() < 1e-3


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (torch.zeros(3, 11), "shape"),
        (torch.zeros(3, 12, dtype=torch.int64), "int64"),
        (torch.tensor([[0.0] * 6 + [float("nan")] + [0.0] * 5]), "position_x of row 0"),
    ],
)
def test_bad_parameters_are_named(parameters: torch.Tensor, message: str) -> None:
    with pytest.raises(RacinesError, match=message):
        check_parameters(parameters)


def test_missing_force_is_allowed_unless_asked_for() -> None:
    parameters = torch.zeros(2, 12)
    parameters[:, 0] = float("nan")
    check_parameters(parameters)
    with pytest.raises(RacinesError, match="force_x"):
        check_parameters(parameters, need_force=True)


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (torch.zeros(2, 128, 128), "float32"),
        (torch.zeros(2, 64, 64, dtype=torch.uint8), "shape"),
        (torch.ones(2, 128, 128, dtype=torch.uint8), "0-1"),
        (torch.full((2, 128, 128), 9, dtype=torch.uint8), "constant"),
    ],
)
def test_bad_images_are_refused(images: torch.Tensor, message: str) -> None:
    with pytest.raises(RacinesError, match=message):
        check_images(images)
