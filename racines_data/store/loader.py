"""The training store for those who bring a loop built on `torch.utils.data.DataLoader`."""

from collections.abc import Iterator

from torch.utils.data import IterableDataset, get_worker_info

from racines_data.store.frames import Batch, FrameStore


class BatchDataset(IterableDataset[Batch]):
    """One shuffled pass over a split in batches; every pass has an order of its own.

    Give it to a loader that does not batch again: `DataLoader(dataset, batch_size=None)`. The store
    alone serves batches faster than worker processes can hand them over; with workers, each takes
    its share of the batches.
    """

    def __init__(self, store: FrameStore, split: str, batch_size: int, seed: int = 0) -> None:
        """Serve `split` from `store`; `seed` and the number of the pass decide the order."""
        self.store, self.split, self.batch_size, self.seed = store, split, batch_size, seed
        self.epoch = 0
        """Number of the next pass; with worker processes, set it before each."""

    def __iter__(self) -> Iterator[Batch]:
        order, self.epoch = self.seed + self.epoch, self.epoch + 1
        worker = get_worker_info()
        number, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        rows = self.store.order(self.split, order)
        for place, start in enumerate(range(0, len(rows), self.batch_size)):
            if place % workers == number:
                yield self.store.take(rows[start : start + self.batch_size])

    def __len__(self) -> int:
        start, stop = self.store.bounds(self.split)
        return -(-(stop - start) // self.batch_size)
