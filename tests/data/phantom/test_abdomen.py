"""The second organ: sizes within the norms, views that mean something, labels of its own."""

from functools import cache

import pytest
import torch
from scipy import ndimage

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, rotate
from racines_data.load import load
from racines_data.phantom import Phantom, PhantomConfig
from racines_data.phantom import abdomen as organ
from racines_data.phantom.acquisition import AcquisitionConfig, plan_targets
from racines_data.phantom.anatomy import anatomy_views, load_anatomy
from racines_data.phantom.config import BlockConfig
from racines_data.phantom.truth import make_oracle
from racines_data.randomness import sample_seeds
from racines_data.sources.phantom import PhantomSource
from racines_data.store.frames import open_store
from racines_data.validate.run import validate
from racines_data.views import LABELS, organs
from tests.plugins.packages import install
from tests.variants import first_of

VIEWS = ("KLX", "KSX", "GB")
SEEDS = range(8)
STEP = 1.5
"""Spacing of the painted points, mm."""
STONE_SEED = 6


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return Phantom(PhantomConfig(anatomy="abdomen"))


@cache
def painted(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (X, Y, Z) tissues of the block, and the (X, Y, Z, 3) points in mm, organ frame."""
    axes = [torch.arange(low, high, STEP) for low, high in ((-85, 85), (-70, 70), (-135, 0))]
    points = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
    tissue = load_anatomy("abdomen", seed).paint(points.view(-1, 3) * 1e-3)
    return tissue.view(points.shape[:-1]), points


def extents(points: torch.Tensor) -> list[float]:
    """Return the lengths of (N, 3) points along their principal axes, mm, longest first."""
    centred = points - points.mean(0)
    spread = centred @ torch.linalg.svd(centred, full_matrices=False)[2].T
    return (spread.amax(0) - spread.amin(0) + STEP).tolist()


@pytest.mark.parametrize("seed", first_of(SEEDS, 3))
def test_the_kidney_has_the_size_of_an_adults(seed: int) -> None:
    tissue, points = painted(seed)
    kidney = (tissue >= organ.CORTEX) & (tissue <= organ.SINUS)
    length, width, thickness = extents(points[kidney])
    assert 90 <= length <= 120
    assert 40 <= thickness <= width <= 60
    assert 90 <= float(kidney.sum()) * STEP**3 / 1000 <= 200  # ml
    # Depth of each point under the kidney's surface, as a sonographer measures.
    depth = torch.from_numpy(ndimage.distance_transform_edt(kidney.numpy(), STEP))
    cortex = float(depth[tissue == organ.PYRAMID].quantile(0.05))
    assert 5.0 <= cortex <= 10.0
    assert (tissue == organ.SINUS).sum() > 0.05 * kidney.sum()
    assert (tissue == organ.PYRAMID).sum() > 0.05 * kidney.sum()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gallbladder_has_the_size_of_an_adults(seed: int) -> None:
    tissue, points = painted(seed)
    inside = (tissue == organ.BILE) | (tissue == organ.STONE)
    length, width, _ = extents(points[inside])
    assert 60 <= length <= 100
    assert 18 <= width <= 40
    assert 10 <= float(inside.sum()) * STEP**3 / 1000 <= 60  # ml
    # The wall, along a line through the body from side to side.
    body = torch.tensor(organ.NECK) * 0.4 + torch.tensor(organ.FUNDUS) * 0.6
    line = body + torch.arange(-40, 40, 0.05).unsqueeze(1) * torch.tensor([0.0, 1.0, 0.0])
    met = load_anatomy("abdomen", seed).paint(line * 1e-3)
    assert 1.0 <= float((met == organ.GALLBLADDER_WALL).sum()) * 0.05 / 2 <= 3.0


def test_seeds_give_other_abdomens_and_the_same_ones_again() -> None:
    counts = {seed: torch.bincount(painted(seed)[0].flatten(), minlength=12) for seed in (0, 1, 2)}
    assert not torch.equal(counts[0], counts[1]) and not torch.equal(counts[1], counts[2])
    assert torch.equal(counts[1], torch.bincount(painted(1)[0].flatten(), minlength=12))
    stones = [bool((painted(seed)[0] == organ.STONE).any()) for seed in (0, STONE_SEED)]
    assert stones == [False, True]


@pytest.mark.parametrize("seed", SEEDS)
def test_each_view_is_attained_at_its_nominal_pose_and_no_other_is(seed: int) -> None:
    anatomy, config = load_anatomy("abdomen", seed), PhantomConfig()
    oracle = make_oracle(anatomy, BlockConfig().maximum[2], torch.device("cpu"))
    coupling = torch.ones(len(VIEWS), config.probe.beams)
    truth = oracle.judge(oracle.targets, config.probe, coupling)
    assert truth.view.tolist() == [0, 1, 2]
    assert float(truth.grade.min()) >= 9.0
    assert float((truth.membership - torch.eye(3)).abs().max()) < 0.05


def test_the_phantom_reaches_its_views_with_good_contact(phantom: Phantom) -> None:
    poses = [phantom.target(view) for view in VIEWS]
    pose = Pose(*(torch.cat(part) for part in zip(*poses, strict=True)))
    assert bool(phantom.workspace.contains(pose).all())
    truth = phantom.judge(pose)
    assert truth.view.tolist() == [0, 1, 2] and float(truth.grade.min()) >= 9.0
    away = Pose(pose.position + torch.tensor([0.05, 0.0, 0.0]), pose.rotation)
    assert phantom.judge(away).view.tolist() == [3, 3, 3]
    assert (phantom.judge(away).grade == 0).all()


def brightness(phantom: Phantom, view: str, point: torch.Tensor) -> float:
    """Return the mean envelope about a (3,) point of the organ frame, mm, in the view's plane."""
    pose = phantom.target(view)
    offset = point * 1e-3 + torch.tensor(organ.TOP) - pose.position[0]
    x, _, z = rotate(pose.rotation[0].T, offset).tolist()
    probe = phantom.config.probe
    depth, angle = (x * x + z * z) ** 0.5, torch.atan2(torch.tensor(x), torch.tensor(z)).item()
    beam = round((angle / probe.half_angle + 1) / 2 * (probe.beams - 1))
    sample = round(depth / probe.depth * probe.samples)
    envelope = phantom.envelope(pose, sample_seeds(0, 1))[0]
    return float(envelope[beam - 2 : beam + 3, sample - 2 : sample + 3].mean())


def test_the_picture_has_what_sonographers_name_the_organs_by(phantom: Phantom) -> None:
    varied = organ._variation(0)
    axes, centre = organ._kidney_axes(varied.tilt), torch.tensor(organ.KIDNEY)
    sinus = brightness(phantom, "KSX", centre + 4 * axes[1])
    cortex = brightness(phantom, "KSX", centre - 21 * axes[1])
    assert sinus > 1.5 * cortex
    bile = brightness(phantom, "GB", torch.tensor(organ._between(0.7)))
    u, v, w = organ._between(0.6)
    liver = brightness(phantom, "GB", torch.tensor([u, v, w + 35.0]))
    assert bile < 0.4 * liver


def test_a_stone_casts_a_shadow(phantom: Phantom) -> None:
    with_stone = Phantom(PhantomConfig(anatomy="abdomen", anatomy_seed=STONE_SEED))
    lit, dark = (p.envelope(p.target("GB"), sample_seeds(0, 1))[0] for p in (phantom, with_stone))
    deep = slice(round(0.105 / 0.155 * 144), round(0.135 / 0.155 * 144))
    middle = slice(46, 51)  # the view looks straight at where a stone lies
    assert float(dark[middle, deep].mean()) < 0.65 * float(lit[middle, deep].mean())


# --- labels follow the anatomy -------------------------------------------------------------------


def test_the_views_known_without_building_are_the_anatomies_own() -> None:
    for name, views in organs().items():
        anatomy = load_anatomy(name, 0)
        assert tuple(view.name for view in anatomy.views) == views == anatomy_views(name)
        named = {structure.name for structure in anatomy.structures}
        assert all(name in named for view in anatomy.views for name, _ in view.structures)


def test_an_anatomy_may_be_named_by_module_and_function() -> None:
    assert load_anatomy("racines_data.phantom.abdomen:abdomen", 0).name == "abdomen"
    assert anatomy_views("racines_data.phantom.abdomen:abdomen") == VIEWS
    with pytest.raises(RacinesError, match=r"unknown anatomy 'lung'.*abdomen, heart"):
        load_anatomy("lung", 0)
    with pytest.raises(RacinesError, match="has no 'lung'"):
        load_anatomy("racines_data.phantom.abdomen:lung", 0)


def test_sweeps_aim_at_the_views_of_the_anatomy(phantom: Phantom) -> None:
    assert phantom.labels == (*VIEWS, "Random")
    config = AcquisitionConfig(phantom=PhantomConfig(anatomy="abdomen"))
    assert set(plan_targets(20, config)) == {*VIEWS, "Random"}
    assert set(plan_targets(20, AcquisitionConfig())) == set(LABELS)


def test_a_dataset_carries_the_labels_of_its_anatomy(tmp_path) -> None:
    config = AcquisitionConfig(
        frames=96, shortest=6, longest=12, phantom=PhantomConfig(anatomy="abdomen")
    )
    manifest = build(PhantomSource(config), tmp_path / "abdomen", DataConfig(workers=1))
    assert manifest["labels"] == [*VIEWS, "Random"]
    store = open_store(tmp_path / "abdomen")
    assert store.labels == (*VIEWS, "Random") and int(store.views.max()) <= 3
    rows = load(root=tmp_path / "abdomen", split="train")
    assert rows.features["view"].names == rows.features["view_predicted"].names == [*store.labels]
    assert set(rows["target_view"]) <= set(store.labels)
    seen = {store.labels[view] for view in store.views.unique().tolist()}
    assert seen == set(store.labels)
    result = validate(tmp_path / "abdomen")
    broken = [c for c in result.checks if not c.ok and c.name in ("rows", "store", "card")]
    assert not broken


def test_an_entry_point_that_names_other_views_is_refused(tmp_path, monkeypatch) -> None:
    made = "racines_data.phantom.abdomen:abdomen [KLX,GB]"
    install(tmp_path, "their_organs", {"racines.anatomies": {"belly": made}})
    monkeypatch.syspath_prepend(str(tmp_path))
    assert organs()["belly"] == ("KLX", "GB") and next(iter(organs())) == "heart"
    with pytest.raises(RacinesError, match=r"'belly' has the views KLX, KSX, GB.*\[KLX,KSX,GB\]"):
        load_anatomy("belly", 0)
