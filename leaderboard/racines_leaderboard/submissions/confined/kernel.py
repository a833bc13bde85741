"""What the Linux kernel takes away from a process for good: nearly all system calls, and all files.

Two mechanisms, neither of which needs a privilege (no_new_privs, prctl(2), goes before both):

- seccomp(2): a filter lists the few calls that computing on bytes in memory takes; every other one
  fails with EPERM. It cannot be taken back, and holds for every thread.
- landlock(7), where the kernel has it: no file, no TCP port, no signal or abstract socket out of
  the process, should a call that leads there ever be let through.

Capabilities are dropped as well (capset(2)), so it holds for root too. Constants are those of
Linux's include/uapi/linux: seccomp.h, bpf_common.h, audit.h, landlock.h, prctl.h, capability.h;
numbers of calls those of arch/x86/entry/syscalls/syscall_64.tbl and asm-generic/unistd.h.
"""

import contextlib
import ctypes
import errno
import os
import signal
import struct
import sys
from typing import Any, NoReturn

try:
    import resource
except ModuleNotFoundError:  # on Windows, which `confine` refuses
    resource: Any = None

PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38
SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC = 1, 1
KILL_PROCESS, ERRNO, ALLOW = 0x80000000, 0x00050000, 0x7FFF0000
LOAD, EQUAL, ANY_BIT, RETURN = 0x20, 0x15, 0x45, 0x06
"""BPF_LD|BPF_W|BPF_ABS, BPF_JMP|BPF_JEQ|BPF_K, BPF_JMP|BPF_JSET|BPF_K, BPF_RET|BPF_K."""
NUMBER, ARCHITECTURE, ARGUMENTS = 0, 4, 16
"""Offsets in `struct seccomp_data`; an argument has 8 bytes, its low word first."""
PROT_EXEC = 4
CAPABILITY_VERSION_3 = 0x20080522

ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
CALLS = {
    "read": (0, 63),
    "write": (1, 64),
    "futex": (202, 98),
    "munmap": (11, 215),
    "madvise": (28, 233),
    "brk": (12, 214),
    "mremap": (25, 216),
    "clock_gettime": (228, 113),
    "gettimeofday": (96, 169),
    "clock_nanosleep": (230, 115),
    "sched_yield": (24, 124),
    "sched_getaffinity": (204, 123),
    "getcpu": (309, 168),
    "getrandom": (318, 278),
    "getpid": (39, 172),
    "gettid": (186, 178),
    "close": (3, 57),
    "rt_sigreturn": (15, 139),
    "restart_syscall": (219, 128),
    "exit": (60, 93),
    "exit_group": (231, 94),
}
"""What is let through whatever its arguments: number on x86_64, on aarch64."""
MMAP, MPROTECT, TGKILL = (9, 222), (10, 226), (234, 131)
"""Let through for memory that is not executable, and for signals to itself: abort(3)."""
SECCOMP, CAPSET = (317, 277), (126, 91)
LANDLOCK_CREATE_RULESET, LANDLOCK_RESTRICT_SELF = 444, 446
FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}
"""How many rights to files Landlock knows, from which version of its interface on."""


class CannotConfineError(Exception):
    """This machine lacks a mechanism, or it did not take hold."""


def confine() -> None:
    """Confine this process, all of its threads, until it ends; descriptors stay as they are.

    Raises:
        CannotConfineError: no Linux on x86_64 or aarch64, no seccomp filters, or what was to be
            forbidden was not. The process may be confined in part then: end it.
    """
    machine = os.uname().machine if hasattr(os, "uname") else "this machine"
    if sys.platform != "linux" or machine not in ARCHITECTURES or sys.maxsize < 2**32:
        raise CannotConfineError(f"{sys.platform} on {machine} has no filter here")
    column = list(ARCHITECTURES).index(machine)
    libc = ctypes.CDLL(None, use_errno=True)
    _no_new_privileges(libc)
    _no_files(libc)
    open_no_more()
    _no_capabilities(libc, CAPSET[column])
    _few_calls(libc, SECCOMP[column], calls_filter(machine, os.getpid()))
    _try_the_doors()


def open_no_more() -> None:
    """Set the limits that every POSIX system has: no further descriptors, and no processes.

    Files of 0, not of 3: a place that close(2) frees cannot be taken again. Root may undo them.
    """
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))


def end_with(parent: int) -> None:
    """End this process when the thread that started it ends; at once, if `parent` is gone."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


def calls_filter(machine: str, pid: int) -> bytes:
    """Return the BPF program, 8 bytes an instruction, of the calls that process `pid` may make."""
    column = list(ARCHITECTURES).index(machine)
    refuse, allow = _step(RETURN, ERRNO | errno.EPERM), _step(RETURN, ALLOW)
    # Numbers mean nothing under another architecture: 32-bit calls of a 64-bit kernel.
    program = [
        _step(LOAD, ARCHITECTURE),
        _step(EQUAL, ARCHITECTURES[machine], 1, 0),
        _step(RETURN, KILL_PROCESS),
        _step(LOAD, NUMBER),
    ]
    for numbers in CALLS.values():
        program += [_step(EQUAL, numbers[column], 0, 1), allow]
    executable, itself = _step(ANY_BIT, PROT_EXEC, 0, 1), _step(EQUAL, pid, 1, 0)
    for numbers, argument, test in (
        (MMAP, 2, executable),
        (MPROTECT, 2, executable),
        (TGKILL, 0, itself),
    ):
        program += [_step(EQUAL, numbers[column], 0, 4), _step(LOAD, ARGUMENTS + 8 * argument)]
        program += [test, refuse, allow]
    return b"".join([*program, refuse])


def _step(code: int, value: int, met: int = 0, unmet: int = 0) -> bytes:
    """Return a `struct sock_filter`; `met` and `unmet` are how many steps are left out then."""
    return struct.pack("<HBBI", code, met, unmet, value)


def _no_new_privileges(libc: ctypes.CDLL) -> None:
    if libc.prctl(PR_SET_NO_NEW_PRIVS, ctypes.c_ulong(1), 0, 0, 0):
        _failed("no_new_privs")


def _no_files(libc: ctypes.CDLL) -> None:
    """Apply a Landlock ruleset that allows nothing; does nothing where the kernel has none."""
    version = libc.syscall(ctypes.c_long(LANDLOCK_CREATE_RULESET), None, ctypes.c_size_t(0), 1)
    if version < 1:
        return
    files = (1 << max(count for since, count in FILE_RIGHTS.items() if since <= version)) - 1
    network = 0b11 if version >= 4 else 0  # to bind and to connect, TCP
    scope = 0b11 if version >= 6 else 0  # abstract sockets, signals
    # struct landlock_ruleset_attr: what it lacked in earlier versions is 0, and is taken so.
    rules = ctypes.create_string_buffer(struct.pack("<QQQ", files, network, scope), 24)
    size = ctypes.c_size_t(24 if version >= 6 else 16 if version >= 4 else 8)
    ruleset = libc.syscall(ctypes.c_long(LANDLOCK_CREATE_RULESET), rules, size, 0)
    if ruleset < 0 or libc.syscall(ctypes.c_long(LANDLOCK_RESTRICT_SELF), ruleset, 0):
        _failed("Landlock")
    os.close(ruleset)


def _no_capabilities(libc: ctypes.CDLL, number: int) -> None:
    head = ctypes.create_string_buffer(struct.pack("<Ii", CAPABILITY_VERSION_3, 0), 8)
    if libc.syscall(ctypes.c_long(number), head, ctypes.create_string_buffer(24)):
        _failed("dropping capabilities")


def _few_calls(libc: ctypes.CDLL, number: int, program: bytes) -> None:
    steps = ctypes.create_string_buffer(program, len(program))
    head = struct.pack("@HP", len(program) // 8, ctypes.addressof(steps))  # struct sock_fprog
    given = ctypes.create_string_buffer(head, len(head))
    if libc.syscall(
        ctypes.c_long(number), SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC, given
    ):
        _failed("a seccomp filter")


def _try_the_doors() -> None:
    """Check that it took hold: an emulated kernel may accept a filter and not apply it."""
    for what, attempt in {"a file": lambda: os.open("/", os.O_RDONLY), "a pipe": os.pipe}.items():
        try:
            attempt()
        except OSError as error:
            if error.errno == errno.EPERM:
                continue
        raise CannotConfineError(f"the filter was taken, and {what} could be opened all the same")


def _failed(what: str) -> NoReturn:
    raise CannotConfineError(f"{what}: {os.strerror(ctypes.get_errno())}")
