"""The pattern search: it finds the top of a hill, on a lattice, whatever is refused."""

import torch

from racines_envs.agents.servo.search import LOOKS, ORDER, Search
from racines_envs.task.actions import IDLE


def climb(start, floor=-9.0, noise=0.0, margin=0.05, steps=150):
    """Search from (N, 6) whole steps off the top; return where and when each row came to rest."""
    place, draw = start.clone().float(), torch.Generator().manual_seed(0)
    count = len(place)
    search = Search(count, torch.device("cpu"), margin)
    moved, idles = torch.ones(count, dtype=torch.bool), torch.zeros(count, dtype=torch.int64)
    rested = torch.full((count,), -1)
    for step in range(steps):
        worth = 1.0 - 0.1 * place.square().sum(1) + noise * torch.randn(count, generator=draw)
        action = search.act(worth, moved, torch.full((count,), step == 0))
        idles = torch.where(action == IDLE, idles + 1, 0)
        rested = torch.where((idles == 3) & (rested < 0), step, rested)
        move = torch.zeros(count, 6)
        going = (action != IDLE) & (rested < 0)
        move[going, (action // 2)[going]] = (1.0 - 2.0 * (action % 2))[going]
        refused = (place + move)[:, 2] < floor
        place = torch.where(refused[:, None], place, place + move)
        moved = (going & ~refused) | (action == IDLE)
    return place, rested


def test_it_ends_at_the_top_and_idles_there():
    place, rested = climb(
        torch.tensor([[0, 0, 0, 0, 0, 0], [2, -1, 0, 0, 1, -2], [0, 0, 0, 3, 0, 0]])
    )
    assert torch.equal(place, torch.zeros(3, 6)) and bool((rested > 0).all())
    assert int(rested[0]) == LOOKS + len(ORDER) * (LOOKS + 1) + 1, "two looks a try, and back"


def test_it_does_not_idle_three_times_before_all_is_tried():
    _, rested = climb(torch.tensor([[1, 1, 1, 1, 1, 1]]), steps=40)
    assert int(rested[0]) < 0


def test_a_refused_step_is_left_out():
    place, rested = climb(torch.tensor([[0, 0, 2, 0, 0, 1]]), floor=2.0)
    assert place[0].tolist() == [0, 0, 2, 0, 0, 0] and int(rested[0]) > 0


def test_noise_below_the_margin_moves_nothing():
    place, rested = climb(torch.zeros(20, 6), noise=0.03, margin=0.1)
    assert torch.equal(place, torch.zeros(20, 6)) and bool((rested > 0).all())


def test_rows_are_independent_and_forgotten():
    starts = torch.tensor([[2, -1, 0, 0, 1, -2], [0, 1, 0, 0, 0, 0]])
    both, alone = climb(starts), climb(starts[1:])
    assert torch.equal(both[0][1:], alone[0]) and torch.equal(both[1][1:], alone[1])
    search = Search(2, torch.device("cpu"), 0.0)
    search.act(torch.zeros(2), torch.ones(2, dtype=torch.bool), torch.ones(2, dtype=torch.bool))
    search.forget(torch.tensor([True, False]))
    assert search.searching.tolist() == [False, True]
