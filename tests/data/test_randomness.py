import torch

from racines_data.randomness import derive, normal, sample_seeds, uniform


def test_draws_do_not_depend_on_the_batch() -> None:
    seeds = sample_seeds(3, 50)
    together = normal(seeds, 33, stream=2)
    alone = torch.cat([normal(seeds[i : i + 1], 33, stream=2) for i in range(50)])
    assert torch.equal(together, alone)


def test_moments_and_independence() -> None:
    draw = normal(sample_seeds(0, 64), 4096)
    assert abs(draw.mean()) < 0.01
    assert abs(draw.std() - 1) < 0.01
    u = uniform(sample_seeds(0, 64), 4096)
    assert u.min() >= 0
    assert u.max() < 1
    assert abs(u.mean() - 0.5) < 0.005
    neighbours = torch.corrcoef(torch.stack([draw[:-1].flatten(), draw[1:].flatten()]))[0, 1]
    assert abs(neighbours) < 0.01


def test_streams_and_keys_differ() -> None:
    seeds = sample_seeds(0, 4)
    assert not torch.equal(normal(seeds, 8, 0), normal(seeds, 8, 1))
    assert len(derive(seeds, torch.arange(4)).unique()) == 4
    assert len(sample_seeds(0, 1000).unique()) == 1000


def test_given_seeds_are_used_as_they_are() -> None:
    seeds = torch.tensor([5, 6, 7])
    assert torch.equal(sample_seeds(seeds, 3), seeds)


def test_an_integer_derives_what_it_derives_as_a_tensor() -> None:
    seeds = sample_seeds(0, 100)
    for key in (0, 1, 11, -1, 2**31, 2**63 - 1, -(2**63), *sample_seeds(1, 500).tolist()):
        assert torch.equal(derive(seeds, key, 7), derive(seeds, torch.tensor(key), 7)), key
