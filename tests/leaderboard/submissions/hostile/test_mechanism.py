"""The mechanism itself: what its filter lets through, whom it holds, and where there is none."""

import errno
import os
import re
import shutil
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

import racines_leaderboard.submissions.confined.session as confined
from racines_data.errors import RacinesError
from racines_leaderboard.audit import run
from racines_leaderboard.board import recompute
from racines_leaderboard.cli.command import app
from racines_leaderboard.submissions.confined import kernel
from racines_leaderboard.submissions.confined.session import ConfinedGenerator, rehearse
from racines_models.exchange.onnx.generator import OnnxGenerator
from tests.leaderboard.conftest import artefact, write_submission
from tests.leaderboard.graphs import sound_generator
from tests.leaderboard.submissions.hostile import conftest
from tests.leaderboard.submissions.hostile.child import NOBODY, ROOMY, Hostile
from tests.models.conftest import random_parameters

MACHINES = list(kernel.ARCHITECTURES)
REFUSE, I386 = kernel.ERRNO | errno.EPERM, 0x40000003


def answer(program: bytes, architecture: int, number: int, *arguments: int) -> int:
    """Return what a BPF program makes of a system call: an interpreter of its own."""
    words = [*arguments, *[0] * (6 - len(arguments))]
    data = struct.pack("<iIQ6Q", number, architecture, 0, *words)
    steps, at, held = list(struct.iter_unpack("<HBBI", program)), 0, 0
    while True:
        code, met, unmet, value = steps[at]
        at += 1
        if code == 0x20:
            (held,) = struct.unpack_from("<I", data, value)
        elif code == 0x15:
            at += met if held == value else unmet
        elif code == 0x45:
            at += met if held & value else unmet
        else:
            assert code == 0x06
            return value


@pytest.mark.parametrize("machine", MACHINES)
def test_the_filter_lets_through_its_list_and_nothing_else(machine):
    """On both architectures, whichever this machine has."""
    column, native = MACHINES.index(machine), kernel.ARCHITECTURES[machine]
    program = kernel.calls_filter(machine, 4711)
    listed = {numbers[column] for numbers in kernel.CALLS.values()}
    assert len(listed) == len(kernel.CALLS)
    page = (Path(__file__).parents[4] / "docs/submit.md").read_text()
    assert f"{len(kernel.CALLS) + 3}<!--/n--> system calls" in page
    for number in range(-1, 1000):
        free = answer(program, native, number, 1, 1, 4, 1, 1, 1)
        assert free == (kernel.ALLOW if number in listed else REFUSE), number
        assert answer(program, I386, number) == kernel.KILL_PROCESS
        assert answer(program, native, number | 0x40000000) == REFUSE or number < 0
    for numbers in (kernel.MMAP, kernel.MPROTECT):
        for protection in range(16):
            wanted = REFUSE if protection & 4 else kernel.ALLOW
            assert answer(program, native, numbers[column], 0, 4096, protection) == wanted
    kill = kernel.TGKILL[column]
    assert answer(program, native, kill, 4711, 4711, 6) == kernel.ALLOW
    assert answer(program, native, kill, 4712, 4711, 6) == REFUSE


@pytest.mark.parametrize(
    ("machine", "header"),
    [("x86_64", "x86_64-linux-gnu/asm/unistd_64.h"), ("aarch64", "asm-generic/unistd.h")],
)
def test_numbers_are_those_of_the_known_tables(machine, header):
    """A number of another call would open a door unseen: compared with a list of its own."""
    forbidden = {
        "x86_64": {2: "open", 56: "clone", 59: "execve", 62: "kill", 41: "socket", 101: "ptrace"}
        | {16: "ioctl", 72: "fcntl", 157: "prctl", 257: "openat", 317: "seccomp", 33: "dup2"},
        "aarch64": {56: "openat", 220: "clone", 221: "execve", 129: "kill", 198: "socket"}
        | {117: "ptrace", 29: "ioctl", 25: "fcntl", 167: "prctl", 277: "seccomp", 35: "unlinkat"},
    }[machine]
    column = MACHINES.index(machine)
    calls = dict(kernel.CALLS) | {"mmap": kernel.MMAP, "mprotect": kernel.MPROTECT}
    calls |= {"tgkill": kernel.TGKILL}
    assert not {numbers[column] for numbers in calls.values()} & set(forbidden)
    path = Path("/usr/include") / header
    if path.is_file():  # where the kernel's headers are, by name
        table = dict(re.findall(r"__NR(?:3264)?_(\w+)\s+(\d+)", path.read_text()))
        named = {name: int(table[name]) for name in calls}
        assert named == {name: numbers[column] for name, numbers in calls.items()}


def test_threads_that_were_there_before_are_held_too():
    """One that a library started while it was loaded."""
    waits = """
def before():
    global go, came, said
    go, came, said = threading.Event(), threading.Event(), []
    def wait():
        go.wait()
        said.append(attack(b"open('/etc/passwd').read()"))
        came.set()
    threading.Thread(target=wait, daemon=True).start()
"""
    child = Hostile(before=waits)
    asked = "go.set(); came.wait(); done(0 if said == [b'EPERM'] else None)"
    assert child.does(asked) == "done"
    child.close()


def test_descriptors_that_libraries_left_open_are_closed():
    left = "def before():\n    global left\n    left = os.open('/etc/passwd', os.O_RDONLY)"
    child = Hostile(before=left)
    assert child.does("os.read(left, 10)") == "EBADF"
    child.close()


def test_calls_of_another_architecture_end_it():
    """Prepared while it was free: machine code that calls by the numbers of 32 bits."""
    if os.uname().machine != "x86_64":
        return  # AArch64 has no such gate; the filter's first step is tested for both above
    code = """
def before():
    global page, gate
    page = mmap.mmap(-1, 4096, prot=7)
    page.write(bytes.fromhex('53b814000000cd805bc3'))
    gate = ctypes.CFUNCTYPE(ctypes.c_int)(ctypes.addressof(ctypes.c_char.from_buffer(page)))
"""
    assert re.search(r"died \(SIG(SYS|SEGV)\)", Hostile(before=code).does("gate()"))
    child = Hostile()
    assert child.does("call(0x40000000 + 39)") == "EPERM"
    child.close()


def test_as_another_user_images_are_the_same(tmp_path, monkeypatch):
    become = (
        "import os; import racines_leaderboard.submissions.confined.child as c; "
        "was = dict(c.MODES); "
        "down = lambda: os.geteuid() == 0 and "
        f"(os.setgroups([]), os.setgid({NOBODY}), os.setuid({NOBODY})); "
        "c.MODES.update({name: (lambda mode: lambda: (mode(), down())[0])(mode) "
        "for name, mode in was.items()}); c.main()"
    )
    path = sound_generator(tmp_path / "mine.onnx")
    parameters, seeds = random_parameters(9, 0), torch.arange(9)
    drawn = OnnxGenerator(path).generate(parameters, seeds)
    monkeypatch.setattr(confined, "START", confined.START.split("from rac")[0] + become)
    assert torch.equal(ConfinedGenerator(path, ROOMY).generate(parameters, seeds), drawn)


ABSENT = {
    "another processor": "kernel.ARCHITECTURES = {'riscv64': 1}",
    "another system": "kernel.sys = type('sys', (), {'platform': 'darwin', 'maxsize': 2**63})",
    # An outer filter, as a container may have: seccomp(2) is not implemented (ENOSYS).
    "no filters": "libc.prctl(38, ctypes.c_ulong(1), 0, 0, 0); s = kernel._step; "
    "n = kernel.SECCOMP[COLUMN]; kernel._few_calls(libc, n, b''.join([s(0x20, 0), "
    "s(0x15, n, 0, 1), s(6, 0x50000 | 38), s(6, 0x7fff0000)]))",
    "no dropping of capabilities": "libc.prctl(38, ctypes.c_ulong(1), 0, 0, 0); s = kernel._step; "
    "n = kernel.CAPSET[COLUMN]; kernel._few_calls(libc, kernel.SECCOMP[COLUMN], b''.join("
    "[s(0x20, 0), s(0x15, n, 0, 1), s(6, 0x50000 | 1), s(6, 0x7fff0000)]))",
    "a filter that is taken and not applied": "kernel._few_calls = lambda *_: None",
    "a ruleset that is refused": "libc.prctl(38, ctypes.c_ulong(1), 0, 0, 0); s = kernel._step; "
    "kernel._few_calls(libc, kernel.SECCOMP[COLUMN], b''.join([s(0x20, 0), "
    "s(0x15, 446, 0, 1), s(6, 0x50000 | 1), s(6, 0x7fff0000)]))",
}


@pytest.mark.parametrize("what", ABSENT)
def test_where_it_cannot_confine_it_refuses_unless_told(what):
    before = "import racines_leaderboard.submissions.confined.kernel as kernel\n"
    before += f"def before():\n    {ABSENT[what]}"
    with pytest.raises(RacinesError, match=r"x\.onnx: nothing here can confine .*--unconfined"):
        Hostile(before=before)
    child = Hostile(replace(ROOMY, unconfined=True), before=before)
    assert child.does("pass") == "done"
    # The limits that remain: no descriptor, not in the place of a closed one either.
    assert child.does("os.close(2); os.open('/etc/passwd', os.O_RDONLY)") in ("EMFILE", "EPERM")
    child.close()


def test_without_landlock_the_filter_alone_holds():
    before = "import racines_leaderboard.submissions.confined.kernel as kernel\n"
    before += "def before():\n    kernel._no_files = lambda libc: None"
    child = Hostile(before=before)
    assert child.does("os.close(2); os.open('/etc/passwd', os.O_RDONLY)") == "EPERM"
    child.close()


def test_where_it_can_confine_unconfined_changes_nothing():
    child = Hostile(replace(ROOMY, unconfined=True))
    assert child.does("os.close(2); os.open('/etc/passwd', os.O_RDONLY)") == "EPERM"
    child.close()


def test_landlock_alone_denies_files():
    """The second wall, seen without the first: in a process of its own, with no filter."""
    code = (
        "import ctypes, os; from racines_leaderboard.submissions.confined import kernel as k; "
        "libc = ctypes.CDLL(None, use_errno=True); open('/etc/passwd').close(); "
        "k._no_new_privileges(libc); k._no_files(libc); "
        "there = libc.syscall(ctypes.c_long(444), None, ctypes.c_size_t(0), 1) >= 1\n"
        "try: open('/etc/passwd'); print(not there)\n"
        "except PermissionError: print(there)"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "True"


def test_submit_takes_a_graph_there_only_if_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    path = sound_generator(tmp_path / "in/mine.onnx")
    write_submission(tmp_path / "in", artefact("generator", path), name="mine")
    without = "import racines_leaderboard.submissions.confined.kernel as k; k.ARCHITECTURES = {}"
    start = confined.START.replace("from rac", f"{without}; from rac", 1)
    monkeypatch.setattr(confined, "START", start)
    refused = CliRunner().invoke(app, ["submit", "in", "--check"])
    assert isinstance(refused.exception, RacinesError)
    assert "--unconfined" in str(refused.exception)
    taken = CliRunner().invoke(app, ["submit", "in", "--check", "--unconfined"])
    assert taken.exit_code == 0, taken.output


@pytest.mark.parametrize("words", [["leaderboard", "--recompute", "x"], ["audit", "x"]])
def test_the_other_commands_pass_the_option_on(words, monkeypatch):
    given = []

    def stop(limits):
        given.append(limits.unconfined)
        raise RacinesError("seen")

    found = Path("results/board/generators/x.json")
    monkeypatch.setattr(recompute, "find", lambda *_: found)
    monkeypatch.setattr(recompute, "recompute", lambda folder, ground, *_: stop(ground.limits))
    monkeypatch.setattr(run, "find_records", lambda *_: [found])
    monkeypatch.setattr(run, "audit", lambda path, bench, quick: stop(bench.places.limits))
    for more in ([], ["--unconfined"]):
        assert str(CliRunner().invoke(app, [*words, *more]).exception) == "seen"
    assert given == [False, True]


def test_what_is_no_graph_is_refused_by_a_confined_parser():
    with pytest.raises(RacinesError, match="x: refused"):
        rehearse("onnx", b"\x08\x07" * 1000, "x", ROOMY)


def test_no_librarys_thread_runs_beside_a_graph(tmp_path):
    """One that may open no socket, and tells its makers that it is used, would end the process."""
    path = sound_generator(tmp_path / "a.onnx")
    session = confined.ConfinedSession(path.read_bytes(), "a.onnx")
    assert len(os.listdir(f"/proc/{session._child._process.pid}/task")) == 1


def test_what_the_parent_has_open_the_child_has_not(tmp_path):
    with (tmp_path / "open").open("w") as file:
        os.set_inheritable(file.fileno(), True)
        child = Hostile()
        assert child.does(f"os.write({file.fileno()}, b'x')") == "EBADF"
        child.close()


@pytest.mark.parametrize(("must", "code"), [("1", 1), ("0", 0)])
def test_a_test_that_skips_here_fails_where_it_must_run(tmp_path, must, code):
    shutil.copy(conftest.__file__, tmp_path / "conftest.py")
    lines = "import pytest\n@pytest.mark.skip\ndef test_a(): pass\n"
    (tmp_path / "test_marked.py").write_text(lines)
    whole = "import pytest\npytest.skip('x', allow_module_level=True)"
    (tmp_path / "test_whole.py").write_text(whole)
    (tmp_path / "test_sound.py").write_text("def test_b(): pass")
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull]
    words += ["--rootdir", str(tmp_path)]
    for name, expected in (("marked", code), ("whole", 2 * code), ("sound", 0)):
        files = [str(tmp_path / f"test_{each}.py") for each in (name, "sound")]
        told = os.environ | {conftest.MUST_RUN: must, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        ran = subprocess.run([*words, *files], env=told, capture_output=True, text=True)
        assert ran.returncode == expected, ran.stdout
    checks = (Path(__file__).parents[4] / ".ci/run").read_text()
    assert f"export {conftest.MUST_RUN}=1" in checks
