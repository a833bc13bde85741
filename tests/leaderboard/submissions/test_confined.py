"""The confined child: the same bytes as in this process, and an end to whatever does not end."""

import pickle
from dataclasses import replace
from multiprocessing.connection import Pipe

import numpy as np
import psutil
import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.agents.protocol import Agent
from racines_envs.worlds.making import make_core
from racines_leaderboard.submissions.confined import child as wire
from racines_leaderboard.submissions.confined.session import (
    Child,
    ConfinedGenerator,
    ConfinedPolicyAgent,
    ConfinedSession,
    Limits,
    rehearse,
)
from racines_models.exchange.onnx.generator import OnnxGenerator
from tests.envs.fakes import FakePhantom
from tests.leaderboard.graphs import harmful, sound_generator, sound_policy
from tests.models.conftest import random_parameters
from tests.waiting import PATIENCE, until

SMALL = Limits(memory=2**30, open_seconds=int(PATIENCE), call_seconds=int(PATIENCE))


def children() -> set[int]:
    """Return the processes that this one has started and not collected."""
    return {child.pid for child in psutil.Process().children()}


@pytest.fixture(autouse=True)
def no_child_is_left():
    before = children()
    yield
    until(lambda: not children() - before)


def test_images_are_the_same_bytes(tmp_path):
    path = sound_generator(tmp_path / "mine.onnx")
    parameters, seeds = random_parameters(21, 0), torch.arange(21) * 3
    here, there = OnnxGenerator(path), ConfinedGenerator(path, SMALL)
    drawn = here.generate(parameters, seeds)
    assert drawn.float().std() > 5 and not torch.equal(drawn[0], drawn[1])
    assert torch.equal(there.generate(parameters, seeds), drawn)
    assert (there.name, there.sha256) == (here.name, here.sha256)


def test_actions_are_the_same(tmp_path):
    path = sound_policy(tmp_path / "policy.onnx")
    core = make_core(
        "SC", 30, observation="params", reward="oracle", phantom=FakePhantom()
    )  # fmt: skip
    seen, seeds = core.reset(seed=0), core.decision_seeds()
    here, there = OnnxPolicyAgent(path), ConfinedPolicyAgent(path, SMALL)
    assert isinstance(there, Agent)
    assert torch.equal(there.logits(seen), here.logits(seen))
    assert torch.equal(there.act(seen, seeds), here.act(seen, seeds))
    assert len(set(here.act(seen, seeds).tolist())) > 1


@pytest.mark.parametrize(
    ("how", "limits", "message"),
    [
        ("loop", replace(SMALL, call_seconds=1), "took more than 1 s"),
        ("grow", SMALL, "memory limit is 1,024 MiB"),
        ("claim", SMALL, "memory limit is 1,024 MiB"),
    ],
)
def test_what_loops_or_allocates_without_end_is_ended(tmp_path, how, limits, message):
    generator = ConfinedGenerator(harmful(tmp_path / "harm.onnx", how), limits)
    with pytest.raises(RacinesError, match=rf"harm\.onnx: .*{message}"):
        generator.generate(random_parameters(3, 0), 0)
    with pytest.raises(RacinesError, match="harm.onnx"):
        generator.generate(random_parameters(3, 0), 0)


def test_the_child_can_open_nothing(tmp_path):
    """What a graph could do with code of its own: asked of the child's Python itself."""
    tried = {
        f"open({str(tmp_path / 'owned')!r}, 'w')": "Operation not permitted",
        "open('/etc/passwd').read()": "Operation not permitted",
        "__import__('socket').socket()": "Operation not permitted",
        "__import__('os').pipe()": "Operation not permitted",
        "bytearray(2**31)": "memory limit",
        "__import__('os').abort()": "died .SIGABRT.",
        "__import__('os').write(1, b'x' * 100)": "is no message",
    }
    for code, message in tried.items():
        with pytest.raises(RacinesError, match=f"x.onnx: .*{message}"):
            _Coded(code)
    assert not list(tmp_path.iterdir())


class _Coded(Child):
    """A child whose graph library has been replaced by a line of Python."""

    def __init__(self, code: str, limits: Limits = SMALL):
        import racines_leaderboard.submissions.confined.session as confined

        patched = (
            "import racines_leaderboard.submissions.confined.child as c; "
            f"c.MODES['session'] = lambda: lambda content: eval({code!r}) or bytes; c.main()"
        )
        start, confined.START = confined.START, confined.START.split("from rac")[0] + patched
        try:
            super().__init__("session", b"x", "x.onnx", limits)
        finally:
            confined.START = start


def test_what_is_no_file_is_refused():
    for kind in ("onnx", "parquet"):
        with pytest.raises(RacinesError, match="x: refused"):
            rehearse(kind, b"nothing at all", "x", SMALL)
    with pytest.raises(RacinesError, match="x: refused"):
        ConfinedSession(b"nothing at all", "x", limits=SMALL)


def tensors(header: bytes, size: int = 0) -> bytes:
    return len(header).to_bytes(8, "little") + header + bytes(size)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x01",
        (2**60).to_bytes(8, "little") + b"{}",
        tensors(b'{"a": {"dtype": "F32", "shape": [%d], "data_offsets": [0, 8]}}' % 2**60, 8),
        tensors(b'{"a": {"dtype": "F32", "shape": [%d, 4], "data_offsets": [0, 0]}}' % 2**62),
        tensors(b'{"a": {"dtype": "F64", "shape": [1], "data_offsets": [0, 8]}}', 8),
        tensors(b'{"a": {"dtype": "BF16", "shape": [1], "data_offsets": [0, 2]}}', 2),
        tensors(b'{"a": {"dtype": "OBJECT", "shape": [1], "data_offsets": [0, 8]}}', 8),
        wire.pack_arrays({"a": np.zeros(3, np.float32)}) + b"x",
    ],
)
def test_answers_that_lie_are_refused(payload):
    with pytest.raises(wire.WireError):
        wire.unpack_arrays(payload)


def test_the_wire_carries_arrays_and_nothing_else():
    turned = np.arange(6, dtype=np.float32).reshape(3, 2).T
    arrays = {"a": turned, "b": np.zeros((0, 4), np.uint8), "c": np.array(2.0, np.float32)}
    back = wire.unpack_arrays(wire.pack_arrays(arrays))
    assert all(np.array_equal(back[key], arrays[key]) for key in arrays)
    assert [back[key].shape for key in "abc"] == [(2, 3), (0, 4), ()]
    with pytest.raises(wire.WireError, match="object"):
        wire.pack_arrays({"a": np.array([object()])})


def test_messages_come_whole_and_bounded():
    ours, theirs = Pipe(duplex=False)
    for payload in (b"x" * 10, pickle.dumps(print), b"x" * 11):
        wire.say(theirs, wire.ANSWER, payload)
    assert wire.hear(ours, 10) == (wire.ANSWER, b"x" * 10)
    assert wire.hear(ours) == (wire.ANSWER, pickle.dumps(print))
    with pytest.raises(OSError):
        wire.hear(ours, 10)
    assert ours.closed


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (b"\0\0\0\1A\0\0\0\xffx", "took more than 2 s"),
        (b"\0\0\0\1A\x7f\0\0\0", "no message of at most 67,108,864 bytes"),
        (b"\0\0\0\1A\xff\xff\xff\xff" + b"\x7f" * 8, "no message of at most"),
        (b"\0\0\0\1Z\0\0\0\0", "refused"),
        (b"\0\0\0\0\0\0\0\0", "refused"),
    ],
)
def test_a_child_that_breaks_off_or_claims_too_much_is_ended(written, message):
    """It opens well, and then answers with bytes of its own and is silent."""
    words = f"__import__('os').write(1, {written!r}) and __import__('time').sleep(600)"
    child = _Coded(f"(lambda payload: {words})", replace(SMALL, call_seconds=2))
    with pytest.raises(RacinesError, match=f"x.onnx: .*{message}"):
        child.ask(wire.RUN, b"")
    with pytest.raises(RacinesError, match="x.onnx: its process was stopped before"):
        child.ask(wire.RUN, b"")
