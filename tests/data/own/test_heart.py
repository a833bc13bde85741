"""A heart of one's own among the patients: it moves as its surfaces do, and lies as they lie."""

import copy
import json
import shutil
from pathlib import Path

import pytest
import torch

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.own import OwnPool, from_mesh
from racines_data.own.heart import open_heart
from racines_data.patients.labels import LABELS
from racines_data.patients.pool import Pool
from racines_data.patients.volume import BOX, LOW, VOXEL
from racines_data.sources.patients import BeatingSource
from racines_data.views import VIEWS

pytest.importorskip("trimesh", reason="needs racines[anatomy]")
organs = pytest.importorskip("tests.data.own.organs")


@pytest.fixture(scope="module")
def pool(small_heart: Path) -> OwnPool:
    return OwnPool(str(small_heart), [10_000, 10_003], beating=True)


def test_its_cavities_shrink_as_its_surfaces_do(small_heart: Path, pool: OwnPool):
    told = json.loads((small_heart / "phantom.json").read_text())["heart"]
    assert told["phases"] == 4 and told["end_systole"] == 2
    emptied = 1.0 - organs.SQUEEZE[2] ** 2
    lv, measures = told["volumes"]["LV"], pool.measures(0)
    assert 1.0 - lv[2] / lv[0] == pytest.approx(emptied, abs=0.001)
    assert measures.ejection_fraction == pytest.approx(emptied, abs=0.03)
    assert measures.volumes["lv"][0] == pytest.approx(lv[0], rel=0.02)
    assert measures.right_ejection_fraction == pytest.approx(emptied, abs=0.04)


def test_the_map_back_goes_by_the_vertices_and_can_be_inverted(small_heart: Path):
    own = open_heart(str(small_heart))
    told = own.told["heart"]["warp"]
    assert told["vertex_mean_mm"] < 0.4 and told["jacobian_least"] > 0.3
    assert own.warp is not None
    corner, size = torch.tensor(LOW).double(), BOX * torch.tensor(VOXEL).double()
    points = (corner + torch.rand(1, 400, 3, dtype=torch.float64) * size).expand(5, -1, -1)
    moment = torch.tensor([0.0, 0.7, 2.0, 2.5, 3.9], dtype=torch.float64)
    there = own.warp.now(own.warp.before(points, moment), moment)
    assert float((there - points).norm(dim=-1).max()) < 0.05
    assert torch.equal(own.warp.before(points[:1], moment[:1]), points[:1])  # the first phase
    late = own.warp.before(points[:1], moment.new_tensor([3.999999]))
    assert float((late - points[:1]).norm(dim=-1).max()) < 1e-3  # the last goes on to the first


def test_it_is_seen_over_the_beat_and_a_view_that_it_lacks_never(pool: OwnPool):
    assert pool.shown == ("A4C",)
    rows = torch.arange(2)
    targets = pool.targets(rows)
    for number, view in enumerate(VIEWS):
        pose = Pose(targets.position[:, number], targets.rotation[:, number])
        over = pool.judge_beat(pose, rows, (0.0, 0.2, 0.5))
        shown = over.membership[..., number]
        assert bool((shown > 0.9).all() if view == "A4C" else (shown < 0.01).all()), view
    pose = Pose(targets.position[:, 0], targets.rotation[:, 0])
    full, empty = (pool.mask(pose, rows, torch.tensor([[p, 0.0]] * 2)) for p in (0.0, 0.35))
    cavity = LABELS.index("LV")
    assert bool(((empty == cavity).sum((1, 2)) < 0.9 * (full == cavity).sum((1, 2))).all())
    images = pool.render(pose, rows, torch.tensor([[0.1, 0.0]] * 2))
    assert images.dtype == torch.uint8 and bool((images.float().std((1, 2)) > 10.0).all())


def test_a_row_hangs_on_its_own_patient_alone(small_heart: Path, pool: OwnPool):
    alone = OwnPool(str(small_heart), [10_003], beating=True)
    rows, phase = torch.ones(1, dtype=torch.int64), torch.tensor([[0.2, 0.3]])
    pose = Pose(*(part[:, 0] for part in pool.targets(rows)))
    first = pool.render(pose, rows, phase, rows)
    assert torch.equal(first, alone.render(pose, rows * 0, phase, rows))
    assert pool.hearts[1].placement.axes.equal(
        Pool([10_003], beating=True).hearts[0].placement.axes
    )


def test_it_makes_a_dataset_that_says_what_it_is(built: Path, small_heart: Path, tmp_path: Path):
    shutil.copytree(built, tmp_path / "racines")
    settings = {"test": [20_003], "frames_per_sweep": 2, "phantom": str(small_heart)}
    manifest = build(
        BeatingSource.from_config(settings), tmp_path / "racines", DataConfig(workers=1)
    )
    digest = json.loads((small_heart / "phantom.json").read_text())["digest"]
    recipe = manifest["recipe"]["settings"]
    assert recipe["own"]["digest"] == digest
    assert "phantom" not in recipe["settings"]  # by content, wherever it lies
    assert "no atria were outlined" in manifest["card"]["collection"]
    usual = BeatingSource.from_config({"test": [20_003]})
    assert "own" not in usual.recipe() and "phantom" not in usual.recipe()["settings"]
    with pytest.raises(RacinesError, match="phantom 'nothing': no such folder"):
        BeatingSource.from_config(settings | {"phantom": "nothing"})


@pytest.mark.parametrize(
    ("at", "value", "told"),
    [
        ("heart", {"base": "mitral valve", "apex": "LA", "right": "tricuspid valve"},
         r"heart\.apex: landmark 'LA': give it by at or rim"),
        ("heart", None, "files of several phases, and no section heart"),
        ("heart", {"base": "mitral valve", "apex": "tip"}, r"heart\.right: needed, and left out"),
        ("units", "cm", r"spans .* mm with units: cm"),
        ("parts.LV.structure", "left half", r"parts\.LV\.structure: 'left half' is no structure"),
    ],
)  # fmt: skip
def test_a_heart_that_does_not_fit_is_refused(at: str, value: object, told: str, tmp_path: Path):
    values = copy.deepcopy(organs.HEART)
    *path, last = at.split(".")
    node = values
    for name in path:
        node = node[name]
    node[last] = value
    sheet = organs.write_sheet(tmp_path / "heart.yaml", values)
    with pytest.raises(RacinesError, match=told):
        from_mesh(organs.write_heart(tmp_path / "meshes"), sheet, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_phases_that_do_not_go_together_are_refused(tmp_path: Path):
    meshes = organs.write_heart(tmp_path / "meshes")
    sheet = organs.write_sheet(tmp_path / "heart.yaml", organs.HEART)
    (meshes / "left_02.ply").rename(tmp_path / "left_02.ply")
    with pytest.raises(RacinesError, match="phase 2 is missing among 0 to 3"):
        from_mesh(meshes, sheet, tmp_path / "out")
    (meshes / "left_03.ply").unlink()
    with pytest.raises(RacinesError, match="unlike numbers of phases: .*LV 2"):
        from_mesh(meshes, sheet, tmp_path / "out")
    (meshes / "left_02.ply").write_bytes((meshes / "right_02.ply").read_bytes())
    with pytest.raises(
        RacinesError, match=r"left_02\.ply: .* the phases of a part need the same faces"
    ):
        from_mesh(meshes, sheet, tmp_path / "out")
