import dataclasses

import pytest
import torch
from torchmetrics.functional.image import structural_similarity_index_measure as ssim

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, euler_to_matrix, matrix_to_euler, pose_to_parameters
from racines_data.imaging import ImageSource
from racines_data.phantom import Phantom, PhantomConfig, acoustics, shared_phantom
from racines_data.phantom.heart import heart
from racines_data.phantom.volume import bake
from racines_data.randomness import normal, sample_seeds
from racines_data.views import RANDOM_LABEL, VIEWS

SURFACE = 0.065


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return shared_phantom()


@pytest.fixture(scope="module")
def gel() -> Phantom:
    """The block without a heart."""
    phantom = Phantom()
    empty = dataclasses.replace(
        heart(), paint=lambda points: torch.zeros(len(points), dtype=torch.int64)
    )
    phantom._volume = bake(empty, phantom.config.block)
    return phantom


def targets(phantom: Phantom) -> Pose:
    poses = [phantom.target(view) for view in VIEWS]
    return Pose(torch.cat([p.position for p in poses]), torch.cat([p.rotation for p in poses]))


def moved(pose: Pose, millimetres: tuple[float, float, float]) -> Pose:
    return Pose(pose.position + torch.tensor(millimetres) * 1e-3, pose.rotation)


def similarity(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(ssim(a[None].float(), b[None].float(), data_range=255.0))


def test_homogeneous_gel_has_rayleigh_speckle(gel: Phantom) -> None:
    draw = normal(sample_seeds(0, 12), 3)
    position = torch.tensor([0.49, 0.01, SURFACE - 0.006]) + draw * torch.tensor([0.02, 0.02, 0.0])
    rotation = euler_to_matrix(torch.tensor([[torch.pi, 0.0, 0.0]])).expand(12, 3, 3)
    envelope = gel.envelope(Pose(position, rotation), torch.arange(12))
    # Mid-sector and mid-depth, where the beam is inside the block and the noise is far below.
    patch = envelope[:, 24:72, 30:90]
    normalised = patch / patch.mean((0, 1))  # takes out what changes with depth
    assert float(normalised.mean() / normalised.std()) == pytest.approx(1.91, abs=0.15)


def test_it_is_an_image_source(phantom: Phantom) -> None:
    assert isinstance(phantom, ImageSource)
    images = phantom.generate(pose_to_parameters(targets(phantom)), 0)
    assert images.dtype == torch.uint8
    assert images.shape == (5, 128, 128)
    assert (images.flatten(1).max(1).values > 150).all()


def test_same_seed_same_bytes_and_batch_independent(phantom: Phantom) -> None:
    parameters = pose_to_parameters(targets(phantom)).repeat(15, 1)
    seeds = sample_seeds(4, len(parameters))
    together = phantom.generate(parameters, seeds)
    assert torch.equal(together, phantom.generate(parameters, seeds))
    alone = torch.cat(
        [phantom.generate(parameters[i : i + 1], seeds[i : i + 1]) for i in range(70, 75)]
    )
    assert torch.equal(together[70:], alone)


def test_the_same_pose_differs_by_electronic_noise_only(phantom: Phantom) -> None:
    pose = phantom.target("A4C")
    a, b = (phantom.render(pose, torch.tensor([seed])).float()[0] for seed in (1, 2))
    assert not torch.equal(a, b)
    assert similarity(a[None], b[None]) > 0.9
    bright = (a > 120) & (b > 120)  # tissue far above the noise hardly changes
    assert (a - b)[bright].abs().mean() < 3.0


def test_similarity_falls_smoothly_as_the_probe_moves(phantom: Phantom) -> None:
    pose = phantom.target("A4C")
    start = phantom.render(pose, torch.tensor([1]))
    scores = [
        similarity(phantom.render(moved(pose, (mm, 0, 0)), torch.tensor([2])), start)
        for mm in (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
    ]
    drops = [a - b for a, b in zip(scores, scores[1:], strict=False)]
    assert all(drop > -0.01 for drop in drops)
    assert drops[0] < 0.06, "a quarter of a millimetre must not change the picture wholesale"
    assert scores[-1] < scores[0] - 0.15


def test_every_view_is_attained_at_its_target(phantom: Phantom) -> None:
    truth = phantom.truth(pose_to_parameters(targets(phantom)))
    assert truth.view.tolist() == [0, 1, 2, 3, 4]
    assert (truth.grade > 9.0).all()
    assert (truth.membership.diagonal() > 0.99).all()
    assert phantom.workspace.contains(targets(phantom)).all()


@pytest.mark.parametrize("view", VIEWS)
def test_grade_falls_and_the_view_is_lost_out_of_the_plane(phantom: Phantom, view: str) -> None:
    pose = phantom.target(view)
    normal_ = pose.rotation[0, :, 1]
    grades = []
    for mm in (0.0, 4.0, 8.0, 40.0):
        shifted = Pose(pose.position + normal_ * mm * 1e-3, pose.rotation)
        truth = phantom.judge(shifted)
        grades.append(float(truth.view_grade[0, VIEWS.index(view)]))
    assert grades == sorted(grades, reverse=True)
    assert grades[0] > 9
    assert grades[-1] == 0
    assert int(truth.view[0]) != VIEWS.index(view)


def test_the_right_plane_from_another_window_is_not_the_view(
    phantom: Phantom, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slide the probe 28 mm along the surface within the subcostal plane."""
    pose = phantom.target("SC")
    normal_ = pose.rotation[0, :, 1]
    along = torch.linalg.cross(normal_, torch.tensor([0.0, 0.0, 1.0]))
    position = pose.position + 0.028 * along / along.norm() * torch.tensor([[-1.0], [1.0]])
    slid = Pose(position, pose.rotation.expand(2, 3, 3))
    sc = VIEWS.index("SC")
    assert not (phantom.judge(slid).view == sc).any()
    oracle = type(phantom._oracle)
    monkeypatch.setattr(oracle, "_window", lambda self, pose: torch.ones(2, 5))
    assert (phantom.judge(slid).view == sc).any(), "all structures are in the picture"


def test_a_mirrored_display_is_no_standard_view(phantom: Phantom) -> None:
    pose = phantom.target("A4C")
    mirrored = Pose(pose.position, pose.rotation * torch.tensor([-1.0, -1.0, 1.0]))
    assert int(phantom.judge(mirrored).view) == RANDOM_LABEL


def test_no_contact_no_image(phantom: Phantom) -> None:
    pose = phantom.target("PSMV")
    lifted = moved(pose, (0, 0, 20))
    pair = Pose(*(torch.cat([a, b]) for a, b in zip(pose, lifted, strict=True)))
    touching, away = phantom.render(pair, torch.tensor([0, 0])).float()
    # What is left is noise, which the scanner's gain lifts with depth: no edge of the heart shows.
    assert away[40:].mean() < 0.5 * touching[40:].mean()
    assert away[40:].max() < 0.4 * touching[40:].max()
    assert away[:8, 56:72].mean() > 20, "the face still rings"
    assert float(phantom.judge(lifted).grade) == 0.0
    assert (phantom.coupling(lifted) < 0.05).all()
    felt = phantom.wrench(lifted)[0] - torch.tensor(phantom.config.contact.offset)
    assert felt[:3].norm() < 3.0


def test_shadow_under_a_lifted_edge(phantom: Phantom) -> None:
    pose = phantom.target("PSMV")
    angles = matrix_to_euler(pose.rotation) + torch.tensor([0.0, 0.6, 0.0])
    tilted = Pose(pose.position + torch.tensor([0, 0, 0.005]), euler_to_matrix(angles))
    coupling = phantom.coupling(tilted)[0]
    assert float((coupling[:20].mean() - coupling[-20:].mean()).abs()) > 0.2


def test_normal_force_grows_with_indentation_and_friction_opposes_motion(phantom: Phantom) -> None:
    down = euler_to_matrix(torch.tensor([[torch.pi, 0.0, 0.0]]))

    def press(depth: float) -> Pose:
        return Pose(torch.tensor([[0.49, 0.01, SURFACE - depth]]), down)

    forces = [float(phantom.wrench(press(d))[0, 2]) for d in (0.0, 0.002, 0.004, 0.008)]
    assert forces == sorted(forces, reverse=True)
    assert -20 < forces[-1] < -8
    velocity = torch.tensor([[0.02, 0.0, 0.0, 0.0, 0.0, 0.0]])
    sliding = phantom.wrench(press(0.006), velocity)[0]
    assert float(sliding[0]) < -3.0  # looking down with yaw 0 the probe's x is the base's x
    drag = sliding - phantom.wrench(press(0.006))[0]
    assert float(drag[4]) == pytest.approx(0.19 * float(drag[0]), rel=0.05)


def test_specular_echo_is_strongest_head_on(phantom: Phantom) -> None:
    """The block's far wall and the posterior pericardium brighten when hit at right angles."""
    pose = phantom.target("PSMV")
    image = phantom.render(pose, torch.tensor([0]))[0].float()
    # In a short axis the wall is hit head-on below the cavity and grazed at its sides.
    rows, columns = torch.meshgrid(torch.arange(128), torch.arange(128), indexing="ij")
    bright = image > 225
    assert bright.any()
    assert (columns[bright].float() - 64).abs().median() < 30


def test_attenuation_shadows_what_lies_behind_the_block_wall(phantom: Phantom) -> None:
    edge = Pose(
        torch.tensor([[0.572, 0.01, 0.059]]), euler_to_matrix(torch.tensor([[torch.pi, 0.0, 0.0]]))
    )
    image = phantom.render(edge, torch.tensor([0]))[0].float()
    left, right = image[60:90, 30:60].mean(), image[60:90, 70:100].mean()
    assert min(left, right) < 0.55 * max(left, right)  # a veil of multiple scattering fills it


def test_scatterers_are_fixed_in_the_block(phantom: Phantom) -> None:
    again = Phantom(PhantomConfig())
    pose = targets(phantom)
    seeds = sample_seeds(0, 5)
    assert torch.equal(phantom.render(pose, seeds), again.render(pose, seeds))


def test_other_seeds_give_other_hearts() -> None:
    other = Phantom(PhantomConfig(anatomy_seed=3))
    pose = targets(other)
    assert (other.judge(pose).view == torch.arange(5)).all()
    canonical = targets(shared_phantom())
    assert (pose.position - canonical.position).norm(dim=1).max() > 0.002


def test_unknown_names_are_refused(phantom: Phantom) -> None:
    with pytest.raises(RacinesError, match="unknown view 'A2C'"):
        phantom.target("A2C")
    with pytest.raises(RacinesError, match="unknown anatomy 'kidney'.*heart"):
        Phantom(PhantomConfig(anatomy="kidney"))
    with pytest.raises(RacinesError, match="not finite"):
        phantom.generate(torch.full((1, 12), float("nan")), 0)


@pytest.mark.parametrize("sigma", [0.3, 0.557, 4.0, 20.0])
def test_a_band_alone_gives_the_dense_products_bits(sigma: float) -> None:
    for size in (144, 100):
        field = normal(sample_seeds(3, 4), 96 * size).view(4, 96, size)
        matrix = acoustics.averaging(size, sigma, 3).T.contiguous()
        dense = torch.bmm(field, matrix.expand(4, -1, -1))
        assert torch.equal(acoustics.banded(field, acoustics.strips_of(matrix)), dense)
