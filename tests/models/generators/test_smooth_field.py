"""A smooth scene field: which voxels are neighbours, and that what nobody saw is filled."""

import dataclasses

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.generators.scene_field import SceneField
from racines_models.networks.scene_field.field import ROWS, VoxelField, lay_out, neighbours
from racines_models.protocol import Run
from tests.models.generators.test_scene_field import TINY, field_of_a_ramp

SLOPE = torch.tensor([1.0, -2.0, 0.5])
VOXEL = 2.0


def test_the_next_voxel_differs_by_the_slope_or_is_the_voxel_itself():
    field, points = field_of_a_ramp(VOXEL)
    near = neighbours(lay_out(points.T.contiguous(), VOXEL, 1.0))
    values, own = field.values.detach(), torch.arange(len(near))
    for axis in range(3):
        apart = (values[near[:, axis]] - values)[:, 0]
        itself = near[:, axis] == own
        assert torch.all(apart[itself] == 0)
        torch.testing.assert_close(
            apart[~itself], (SLOPE[axis] * VOXEL).expand(int((~itself).sum())), atol=1e-3, rtol=0.0
        )
        assert itself[:ROWS].all(), "the shared brick has no place, hence no neighbours"
        across = near[:, axis] // ROWS != own // ROWS
        assert across.any(), "bricks are joined"
    wanted = sum(
        float(((SLOPE[k] * VOXEL) ** 2 * (near[:, k] != own).float()).mean()) for k in range(3)
    )
    assert float(field.roughness(near).detach()) == pytest.approx(wanted / 3, rel=1e-4)


def test_bricks_between_two_are_laid_where_asked_for():
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.rand(200, 3, generator=generator) * 15.0 + torch.tensor([x, 0.0, 0.0])
                   for x in (0.0, 160.0))  # fmt: skip
    both = torch.cat([left, right])
    apart, whole = lay_out(both, VOXEL, 1.0), lay_out(both, VOXEL, 1.0, between=True)
    assert whole.rows > apart.rows
    assert torch.equal(whole.table > 0, (whole.table > 0) | (apart.table > 0))
    along = (whole.table > 0).any(2).any(1)
    assert along[1:].sum() >= 160 // (8 * VOXEL), "no brick is left out on the way"
    assert not (apart.table > 0).any(2).any(1)[4:8].any()


def test_what_lies_between_is_filled_from_its_surroundings():
    line = torch.rand(500, 3, generator=torch.Generator().manual_seed(1)) * 60.0
    layout = lay_out(line, VOXEL, 1.0, between=True)
    torch.manual_seed(0)
    field, near = VoxelField(layout, VOXEL, 1, 0.5), neighbours(layout)
    ends = torch.cat([line[line[:, 0] < 20], line[line[:, 0] > 40]]).T.contiguous()
    between = line[(line[:, 0] > 26) & (line[:, 0] < 34)].T.contiguous()
    adam = torch.optim.Adam(field.parameters(), lr=0.05)
    wanted = (ends[0] > 30).float()
    for _ in range(300):
        loss = (field(ends)[:, 0] - wanted).square().mean() + 3.0 * field.roughness(near)
        adam.zero_grad()
        loss.backward()
        adam.step()
    found = field(between)[:, 0].detach()
    assert 0.2 < float(found.mean()) < 0.8
    assert float(found.std()) < 0.25, "the random start is gone"


def test_a_smooth_scene_is_trained_and_differs(store, tmp_path):
    drawn = []
    for name, smoothness in (("rough", 0.0), ("smooth", 30.0)):
        generator = SceneField(dataclasses.replace(TINY, smoothness=smoothness))
        generator.fit(store, Run(tmp_path / name, device="cpu", progress=False))
        drawn.append(generator.generate(store.parameters[:4], 0))
        again = SceneField.load(tmp_path / name).generate(store.parameters[:4], 0)
        assert torch.equal(again, drawn[-1])
    assert not torch.equal(*drawn)
    with pytest.raises(RacinesError, match="smoothness are 0 or more"):
        dataclasses.replace(TINY, smoothness=-1.0)
