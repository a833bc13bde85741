"""Children that never end, take what they can, or say too much: each ends, and nothing is left."""

import os
import re
import signal
import subprocess
import sys
from dataclasses import replace

import psutil
import pytest

from racines_data.errors import RacinesError
from racines_leaderboard.submissions.confined import child as wire
from tests.leaderboard.submissions.hostile.child import ROOMY, Hostile
from tests.waiting import PATIENCE, until

BRIEF = replace(ROOMY, call_seconds=1)
MIB = 2**20


@pytest.mark.parametrize(
    ("attack", "limits", "told"),
    [
        ("while True: pass", BRIEF, "took more than 1 s"),
        ("time.sleep(1e6)", BRIEF, "took more than 1 s"),
        ("call((202, 98), (ctypes.c_int * 1)(), 0, 0, None)", BRIEF, "took more than 1 s"),
        (
            "call((234, 131), os.getpid(), threading.get_native_id(), signal.SIGSTOP)",
            BRIEF,
            "took more than 1 s",
        ),
        ("while True: os.write(2, bytes(65536))", BRIEF, "took more than 1 s"),
        ("while True: os.write(1, bytes(65536))", ROOMY, "refused"),
        ("while True: os.write(1, b'x' * 65536)", ROOMY, "no message of at most 67,108,864 bytes"),
        ("raise MemoryError", ROOMY, "MemoryError"),
        ("bytearray(2**31)", ROOMY, "MemoryError"),
        ("mmap.mmap(-1, 2**31)", ROOMY, "ENOMEM"),
        pytest.param(
            "kept = [bytearray(2**20) for _ in range(2**20)]",
            ROOMY,
            "MemoryError",
            marks=pytest.mark.thorough,
        ),
        ("os.abort()", ROOMY, r"died \(SIGABRT\)"),
        ("ctypes.string_at(0)", ROOMY, r"died \(SIGSEGV\)"),
        ("os._exit(0)", ROOMY, r"died \(exit code 0\)"),
        ("os.close(0); os.close(1); time.sleep(1e6)", ROOMY, "it closed the wire"),
    ],
)
def test_it_ends(attack, limits, told):
    child = Hostile(limits)
    process = child._process
    assert re.search(told, child.does(attack))
    child.close()
    assert process.poll() is not None


def test_the_memory_of_all_it_asks_for_is_bounded():
    """Piece by piece and touched, so that each byte is there."""
    child = Hostile(before="kept = []")
    assert child.does("while True: kept.append(b'x' * 2**20)") == "MemoryError"
    held = psutil.Process(child._process.pid).memory_info().rss
    child.close()
    assert 100 * MIB < held < ROOMY.memory


def test_an_answer_of_countless_arrays_is_refused():
    """Two bytes an array on the wire would be hundreds here."""
    one = b'"%d":{"dtype":"F32","shape":[0],"data_offsets":[0,0]}'
    header = b"{" + b",".join(one % i for i in range(30_000)) + b"}"
    header += b" " * (-len(header) % 8)
    with pytest.raises(wire.WireError, match="header takes more than"):
        wire.unpack_arrays(len(header).to_bytes(8, "little") + header)


def test_what_it_says_is_one_printable_line():
    child = Hostile()
    said = child.does("child.say(child.Connection(1, readable=False), b'X', b'E\\x1b[2J\\n\\r#')")
    assert said == "x.onnx: refused:  [2J  #"


def test_it_cannot_talk_its_user_into_leaving_it_unconfined():
    """The same words are believed before it has seen a byte of the stranger's, and not after."""
    words = "child.say(child.Connection(1, readable=False), b'X', b'Kno filter')"
    said = Hostile().does(words)
    assert said == "x.onnx: refused: no filter"


ORPHAN = """
import os, threading
from tests.leaderboard.submissions.hostile.child import Hostile, ROOMY
from dataclasses import replace
def work():
    child = Hostile(replace(ROOMY, call_seconds=1 if {elsewhere} else 3600))
    os.write(1, b"%d\\n" % child._process.pid)
    child._allow_cpu(child.limits.call_seconds)
    child._asks.send_bytes(b"R")
    child._asks.send_bytes({attack!r}.encode())
    os.write(1, b"asked\\n")
    threading.Event().wait()
thread = threading.Thread(target=work)
thread.start() if {elsewhere} else work()
"""


@pytest.mark.parametrize(
    ("attack", "elsewhere"),
    [
        ("time.sleep(1e6)", False),
        ("while True: pass", True),
        pytest.param("while True: pass", False, marks=pytest.mark.thorough),
    ],
)
def test_nothing_outlives_a_parent_that_is_killed(attack, elsewhere):
    """By the signal of its death; started by another thread, by the CPU's limit."""
    code = ORPHAN.format(attack=attack, elsewhere=elsewhere)
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=os.environ)
    assert parent.stdout is not None
    child = psutil.Process(int(parent.stdout.readline()))
    assert parent.stdout.readline() == b"asked\n"
    parent.send_signal(signal.SIGKILL)
    parent.wait(PATIENCE)
    parent.stdout.close()
    until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)


def test_a_child_is_gone_with_its_object():
    child = Hostile()
    process = child._process
    child.close()
    assert process.poll() == -signal.SIGKILL
    with pytest.raises(RacinesError, match="stopped before"):
        child.ask(wire.RUN, b"")
