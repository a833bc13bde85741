import torch

from racines_data.store.frames import BatchMemory


def test_memory_serves_again_once_nobody_holds_it():
    memory = BatchMemory()
    first = memory.get(3, 4)
    assert first.shape == (3, 2048) and first.dtype == torch.int64
    place = first.data_ptr()
    del first
    assert memory.get(4, 4).data_ptr() == place


def test_a_view_of_a_batch_keeps_its_memory():
    memory = BatchMemory()
    taken = memory.get(4, 4)
    part = taken.view(torch.uint8)[1:2]
    place = taken.data_ptr()
    del taken
    held = [memory.get(4, 4) for _ in range(8)]
    assert place not in {each.data_ptr() for each in held}
    array = part.numpy()
    del part
    assert memory.get(4, 4).data_ptr() != place
    assert array.shape == (1, 16384)


def test_no_more_arrays_are_kept_than_allowed():
    memory = BatchMemory(most=2)
    held = [memory.get(4, 4) for _ in range(5)]
    assert len({each.data_ptr() for each in held}) == 5
    assert len(memory._arrays) == 2
    del held
    assert memory.get(2, 2).shape == (2, 2048), "another batch size gets memory of its own"
