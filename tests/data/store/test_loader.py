from pathlib import Path

import pytest
import torch
from torch.utils.data import DataLoader

from racines_data.store.frames import BatchDataset, FrameStore
from tests import warm


def test_a_loader_serves_the_batches_of_the_store(built: Path):
    store = FrameStore(built)
    dataset = BatchDataset(store, "train", 32, seed=3)
    batches = list(DataLoader(dataset, batch_size=None))
    assert len(batches) == len(dataset) == 4
    for batch, expected in zip(batches, store.batches("train", 32, seed=3), strict=True):
        assert torch.equal(batch.index, expected.index)
        assert torch.equal(batch.images, expected.images)
    second = torch.cat([batch.index for batch in DataLoader(dataset, batch_size=None)])
    first = torch.cat([batch.index for batch in batches])
    assert not torch.equal(first, second) and torch.equal(first.sort()[0], second.sort()[0])


@pytest.mark.slow
def test_workers_share_the_batches(built: Path):
    store = FrameStore(built)
    workers = {"num_workers": 2, "multiprocessing_context": warm.get_context()}
    loader = DataLoader(BatchDataset(store, "train", 8), batch_size=None, **workers)
    rows = torch.cat([batch.index for batch in loader])
    assert torch.equal(rows.sort().values, store.split_indices("train"))
    for batch in loader:
        assert torch.equal(batch.images, store.images[batch.index])


def test_batches_go_to_the_device_asked_for(built: Path):
    batch = next(FrameStore(built).batches("train", 8, seed=0, device="meta"))
    assert {part.device.type for part in batch} == {"meta"} and batch.images.shape == (8, 128, 128)
