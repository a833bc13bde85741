import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from racines_data import RacinesError, open_store
from racines_data.store.frames import FrameStore
from tests.data.fake_source import FakeSource


@pytest.fixture
def store(built: Path) -> FrameStore:
    return open_store(built)


def test_rows_are_those_of_the_source(store: FrameStore):
    source = FakeSource()
    for unit in source.plan():
        made = source.produce(unit)
        rows = (store.trajectory_index == store.trajectories.index(unit.id)).nonzero()[:, 0]
        assert np.array_equal(store.images[rows].numpy(), made.images)
        assert np.array_equal(store.parameters[rows].numpy(), made.parameters, equal_nan=True)
        assert np.array_equal(store.views[rows].numpy(), made.views)
        assert np.array_equal(store.grades[rows].numpy(), made.grades, equal_nan=True)
        assert np.array_equal(store.timestamps[rows].numpy(), made.timestamps)
        assert store.frame[rows].tolist() == list(range(len(made)))
        assert store.target_views[store.trajectories.index(unit.id)] == unit.target_view


def test_types(store: FrameStore):
    assert store.images.shape == (200, 128, 128) and store.images.dtype == torch.uint8
    assert store.parameters.shape == (200, 12) and store.parameters.dtype == torch.float32
    assert store.views.dtype == store.trajectory_index.dtype == torch.int64
    assert store.manifest["source"] == "phantom" and len(store.manifest["digest"]) == 64


def test_splits_share_no_trajectory(store: FrameStore):
    splits = [store.split_indices(name) for name in ("train", "validation", "test")]
    assert torch.equal(torch.cat(splits), torch.arange(200))
    owners = [set(store.trajectory_index[rows].tolist()) for rows in splits]
    assert not (owners[0] & owners[1] or owners[0] & owners[2] or owners[1] & owners[2])


def test_batches_cover_a_split_once(store: FrameStore):
    batches = list(store.batches("train", 32, seed=0))
    index = torch.cat([batch.index for batch in batches])
    assert torch.equal(index.sort().values, store.split_indices("train"))
    assert [len(batch.images) for batch in batches] == [32, 32, 32, 4]
    assert not torch.equal(index, store.split_indices("train"))
    for batch in batches:
        assert torch.equal(batch.images, store.images[batch.index])
        assert torch.equal(batch.views, store.views[batch.index])
        assert torch.equal(
            batch.parameters.nan_to_num(), store.parameters[batch.index].nan_to_num()
        )


def test_order_depends_on_the_seed_alone(store: FrameStore):
    def order(seed: int, **options) -> list[int]:
        return torch.cat([b.index for b in store.batches("train", 7, seed, **options)]).tolist()

    torch.manual_seed(1)
    first = order(0)
    torch.manual_seed(2)
    assert order(0) == first != order(1)
    assert order(0, shuffle=False) == store.split_indices("train").tolist()
    assert len(order(0, drop_last=True)) == 98


def test_images_are_mapped_not_copied(store: FrameStore):
    assert store.images.is_contiguous()
    smaps = Path("/proc/self/smaps").read_text(encoding="utf-8")
    assert str(store.root.resolve() / "store" / "frames.arrow") in smaps


def test_writing_to_a_tensor_leaves_the_file(built: Path, store: FrameStore):
    before = store.images[0].clone()
    store.images[0] = 255 - before
    assert torch.equal(open_store(built).images[0], before)


def test_other_parameters_leave_the_store_as_it_was(store: FrameStore):
    doubled = store.with_parameters(store.parameters * 2.0)
    rows = torch.tensor([2, 0])
    assert torch.equal(doubled.take(rows).parameters, store.take(rows).parameters * 2.0)
    assert torch.equal(doubled.take(rows).images, store.take(rows).images)
    with pytest.raises(TypeError, match="parameters were replaced"):
        pickle.dumps(doubled)
    assert pickle.loads(pickle.dumps(store)).root == store.root


def test_bad_requests(store: FrameStore, tmp_path: Path):
    with pytest.raises(RacinesError, match="unknown split 'dev'"):
        store.split_indices("dev")
    with pytest.raises(RacinesError, match="batch_size 0"):
        next(store.batches("train", 0, seed=0))
    with pytest.raises(RacinesError, match="no dataset here"):
        open_store(tmp_path)


@pytest.mark.parametrize("damage", ["truncated", "altered", "missing"])
def test_a_damaged_store_is_named(built: Path, tmp_path: Path, damage: str):
    root = tmp_path / "racines"
    shutil.copytree(built, root)
    path = root / "store" / "frames.arrow"
    content = path.read_bytes()
    path.unlink()
    if damage != "missing":
        altered = content[:1000000] + b"\x01\x02" + content[1000002:]
        path.write_bytes(content[: len(content) // 2] if damage == "truncated" else altered)
    with pytest.raises(RacinesError, match="frames.arrow: .*(damaged|missing).*rebuild it"):
        open_store(root)
