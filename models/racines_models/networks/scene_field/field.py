"""A voxel field: learned numbers at points of space, kept only where beams go.

Bricks of 8 x 8 x 8 voxels are allocated where the training frames look (a sparse grid, as in
Fridovich-Keil et al., Plenoxels: Radiance Fields without Neural Networks, 2022); everything else
shares one brick. A point between voxels is interpolated in the tetrahedron of the lattice around
it (Kuhn's subdivision of the cube): four voxels to fetch instead of eight.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import embedding_bag

SIDE = 8
"""Voxels along an edge of a brick."""
ROWS = SIDE**3


class Layout(NamedTuple):
    """Where the bricks of a field lie."""

    origin: Tensor
    """(3,) corner of the grid, mm."""
    table: Tensor
    """(X, Y, Z) int32: the first row of each brick; 0 is the shared one."""
    rows: int


def lay_out(points: Tensor, voxel: float, coverage: float, between: bool = False) -> Layout:
    """Allocate bricks where (N, 3) points, mm, lie: the most visited, until they hold a share.

    `voxel` is the edge of a voxel, mm; `coverage` the share of the points, in (0, 1]. With
    `between`, bricks that lie between two such along an axis are allocated too.
    """
    edge = SIDE * voxel
    origin = points.min(0).values - edge
    shape = ((points.max(0).values - origin) / edge).floor().long() + 2
    brick = ((points - origin) / edge).long()
    flat = (brick[:, 0] * shape[1] + brick[:, 1]) * shape[2] + brick[:, 2]
    hits = torch.bincount(flat, minlength=int(shape.prod()))
    order = torch.sort(hits, descending=True, stable=True)
    before = order.values.cumsum(0) - order.values
    kept = order.indices[(before < coverage * len(points)) & (order.values > 0)].sort().values
    if between:
        kept = _with_between(kept, shape)
    table = torch.zeros(len(hits), dtype=torch.int32)
    table[kept] = torch.arange(1, len(kept) + 1, dtype=torch.int32) * ROWS
    return Layout(origin, table.view(*shape.tolist()), (len(kept) + 1) * ROWS)


def _with_between(kept: Tensor, shape: Tensor) -> Tensor:
    """Return the flat places of bricks of a grid, and of those between two along an axis."""
    hit = torch.zeros(int(shape.prod()), dtype=torch.int32)
    hit[kept] = 1
    hit = hit.view(*shape.tolist())
    inside = hit.bool()
    for axis in range(3):
        before, after = hit.cummax(axis).values, hit.flip(axis).cummax(axis).values.flip(axis)
        inside = inside | (before & after).bool()
    return inside.flatten().nonzero().squeeze(1)


def neighbours(layout: Layout) -> Tensor:
    """Return the (rows, 3) int64 rows of the next voxel along each axis; its own where none is."""
    table = layout.table
    near = torch.arange(layout.rows).unsqueeze(1).repeat(1, 3)
    place = torch.arange(ROWS)
    inner = torch.stack([place // SIDE**2, place // SIDE % SIDE, place % SIDE], -1)
    for axis in range(3):
        step = SIDE ** (2 - axis)
        ends = inner[:, axis] == SIDE - 1
        ahead = torch.zeros_like(table)
        count = table.shape[axis] - 1
        ahead.narrow(axis, 0, count).copy_(table.narrow(axis, 1, count))
        first, beyond = table[table > 0].long(), ahead[table > 0].long()
        own = first.unsqueeze(1) + place
        across = beyond.unsqueeze(1) + place - (SIDE - 1) * step
        across = torch.where(beyond.unsqueeze(1) > 0, across, own)
        near[own.flatten(), axis] = torch.where(ends, across, own + step).flatten()
    return near


class VoxelField(nn.Module):
    """(N, 3) points, mm, to (N, channels) learned numbers, linear between voxels."""

    origin: Tensor
    table: Tensor
    codes: Tensor | None = None
    scales: Tensor | None = None

    def __init__(self, layout: Layout, voxel: float, channels: int, spread: float):
        """Start from normal numbers with the deviation `spread`."""
        super().__init__()
        self.voxel = voxel
        self.register_buffer("origin", layout.origin)
        self.register_buffer("table", layout.table)
        self.values = nn.Parameter(torch.randn(layout.rows, channels) * spread)

    def roughness(self, near: Tensor) -> Tensor:
        """Return the mean squared difference to the (rows, 3) `neighbours`, over numbers."""
        steps = [(self.values - self.values[rows]).square().mean() for rows in near.unbind(1)]
        return torch.stack(steps).mean()

    @torch.no_grad()
    def quantise(self) -> None:
        """Round to eight bits a number, with a scale for each brick and channel."""
        bricks = self.values.view(-1, ROWS, self.values.shape[1])
        self.scales = (bricks.abs().amax(1, keepdim=True) / 127.0).clamp_min(1e-8)
        self.codes = (bricks / self.scales).round().to(torch.int8)
        bricks.copy_(self.codes * self.scales)

    def packed(self) -> dict[str, Tensor]:
        """Return what `unpack` takes back: eight bits a number once it is quantised."""
        place = {"origin": self.origin, "table": self.table}
        if self.codes is None or self.scales is None:
            return place | {"values": self.values.detach()}
        return place | {"codes": self.codes, "scales": self.scales}

    @torch.no_grad()
    def unpack(self, packed: dict[str, Tensor]) -> None:
        """Take back the numbers of a field of the same layout."""
        if "values" in packed:
            self.values.copy_(packed["values"])
            return
        self.codes, self.scales = packed["codes"], packed["scales"]
        self.values.copy_((self.codes * self.scales).view_as(self.values))

    def forward(self, points: Tensor, picks: Tensor | None = None, live: int = 0) -> Tensor:
        """Return the (N, channels) numbers at (3, N) points, mm, in the base frame.

        With `picks`, (N,) uniform in [0, 1), the gradient of a point goes to one of its four
        voxels, drawn by their weights: right on average, and a quarter of the work. So many points
        as are `live`, the first ones, get a gradient of their own.
        """
        if torch.compiler.is_exporting():
            return self._plainly(points)
        with torch.no_grad():
            rows, weights = self._corners(self._place(points))
        if live:
            place = self._place(points[:, :live])
            moved = _weights(place - place.detach().to(torch.int32))
            weights = torch.cat([moved, weights[live:]])
        return _Fetch.apply(self.values, rows, weights, picks, live)  # pyright: ignore

    def _plainly(self, points: Tensor) -> Tensor:
        """Return what `forward` returns in operators of ONNX: int64 indices, codes as stored."""
        place = self._place(points)
        low = place.to(torch.int64)
        rest = place - low
        strides, inner = self._strides(low)
        table = self.table.view(-1).to(torch.int64)
        total = torch.zeros_like(rest[0]).unsqueeze(1)
        for up, weight in zip(_steps(*rest), _weights(rest).unbind(1), strict=True):
            at = low + (up.to(torch.int64) if isinstance(up, Tensor) else int(up))
            rows = table[((at // SIDE) * strides).sum(0)] + ((at % SIDE) * inner).sum(0)
            total = total + self._values(rows) * weight.unsqueeze(1)
        return total

    def _values(self, rows: Tensor) -> Tensor:
        if self.codes is None or self.scales is None:
            return self.values[rows]
        codes = self.codes.flatten(0, 1)[rows].to(torch.float32)
        return codes * self.scales.flatten(0, 1)[rows // ROWS]

    def _place(self, points: Tensor) -> Tensor:
        """Return (3, N) coordinates in voxels, inside the grid."""
        last = points.new_tensor(self.table.shape).mul_(SIDE).sub_(1.01).unsqueeze(1)
        place = (points - self.origin.unsqueeze(1)) * (1.0 / self.voxel)
        return torch.minimum(place.clamp(min=0.0), last)

    def _strides(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Return (3, 1) what a step along each axis adds: to a brick's place, and to a row."""
        _, deep, wide = self.table.shape
        strides = like.new_tensor([deep * wide, wide, 1]).unsqueeze(1)
        return strides, like.new_tensor([SIDE * SIDE, SIDE, 1]).unsqueeze(1)

    def _corners(self, place: Tensor) -> tuple[Tensor, Tensor]:
        """Return (N, 4) int32 rows and weights of the voxels around (3, N) places."""
        low = place.to(torch.int32)
        rest = place - low
        strides, inner = self._strides(low)
        ends = low, low + 1
        bricks = [(end >> 3) * strides for end in ends]
        voxels = [(end & 7) * inner for end in ends]
        rows = []
        for up in _steps(*rest):
            brick, voxel = (
                parts[up] if isinstance(up, bool) else torch.where(up, parts[1], parts[0])
                for parts in (bricks, voxels)
            )
            first = self.table.view(-1).index_select(0, brick.sum(0, dtype=torch.int32))
            rows.append(first.add_(voxel.sum(0, dtype=torch.int32)))
        return torch.stack(rows, -1), _weights(rest)


def _weights(rest: Tensor) -> Tensor:
    """Return (N, 4) weights of the tetrahedron's corners from (3, N) fractions of a voxel."""
    x, y, z = rest
    first = torch.maximum(x, torch.maximum(y, z))
    third = torch.minimum(x, torch.minimum(y, z))
    second = x + y + z - first - third
    return torch.stack([1.0 - first, first - second, second - third, third], -1)


def _steps(x: Tensor, y: Tensor, z: Tensor) -> tuple[Any, ...]:
    """Return which axes have been stepped along at each of the tetrahedron's four corners."""
    far_x = (x >= y) & (x >= z)
    far_y = ~far_x & (y >= z)
    near_z = (z <= x) & (z <= y)
    near_y = ~near_z & (y <= x)
    one = torch.stack([far_x, far_y, ~(far_x | far_y)])
    two = torch.stack([near_z | near_y, ~near_y, ~near_z])
    return False, one, two, True


class _Fetch(torch.autograd.Function):
    """Weighted sums of four rows; the backward pass adds into a dense gradient without a sort."""

    @staticmethod
    def forward(
        ctx: Any, values: Tensor, rows: Tensor, weights: Tensor, picks: Any, live: int
    ) -> Tensor:
        ctx.save_for_backward(values, rows, weights, picks)
        ctx.live = live
        return embedding_bag(rows, values, mode="sum", per_sample_weights=weights)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        values, rows, weights, picks = ctx.saved_tensors
        grad, slope = grads[0], None
        if ctx.live:
            slope = torch.zeros_like(weights)
            for corner, row in enumerate(rows[: ctx.live].unbind(1)):
                slope[: ctx.live, corner] = (values[row] * grad[: ctx.live]).sum(1)
        total = torch.zeros_like(values)
        if picks is None:
            for row, weight in zip(rows.unbind(1), weights.unbind(1), strict=True):
                total.index_add_(0, row, grad * weight.unsqueeze(1))
        else:
            passed = weights.cumsum(1)[:, :3] < picks.unsqueeze(1)
            chosen = rows.gather(1, passed.sum(1, keepdim=True)).squeeze(1)
            total.index_add_(0, chosen, grad)
        return total, None, slope, None, None
