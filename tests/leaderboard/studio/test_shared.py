"""What is shared: made once, given up oldest first, and failures are not kept."""

import threading

import pytest

from racines_leaderboard.studio.parts import Shared


def test_many_who_ask_at_once_wait_for_one():
    shared, made, begin = Shared[object](4), [], threading.Barrier(8)
    got = []

    def make():
        made.append(1)
        return object()

    def ask():
        begin.wait()
        got.append(shared.get("a", make))

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1 and len({id(value) for value in got}) == 1 and len(got) == 8


def test_the_one_that_was_asked_for_longest_ago_goes_first():
    shared = Shared[str](2)
    for key in ("a", "b", "a", "c"):
        shared.get(key, lambda key=key: f"first {key}")
    assert len(shared) == 2
    assert shared.get("a", lambda: "second a") == "first a"
    assert shared.get("b", lambda: "second b") == "second b"


def test_a_failure_is_not_kept():
    shared = Shared[int](1)
    with pytest.raises(ZeroDivisionError):
        shared.get("a", lambda: 1 // 0)
    assert shared.get("a", lambda: 7) == 7
