"""A confined child whose graph library has been taken over: it runs what Python it is sent."""

from typing import Any

import racines_leaderboard.submissions.confined.session as confined
from racines_data.errors import RacinesError
from racines_leaderboard.submissions.confined import child as wire
from racines_leaderboard.submissions.confined.session import Child, Limits
from tests.waiting import PATIENCE

NOBODY = 65534
ROOMY = Limits(memory=2**30, open_seconds=int(PATIENCE), call_seconds=int(PATIENCE))

TAKEN_OVER = """
import ctypes, errno, fcntl, mmap, os, resource, select
import signal, socket, struct, sys, threading, time
import racines_leaderboard.submissions.confined.child as child

libc = ctypes.CDLL(None, use_errno=True)
COLUMN = ("x86_64", "aarch64").index(os.uname().machine)

def done(result):
    if result is None or result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result

def call(numbers, *words):
    number = numbers[COLUMN] if isinstance(numbers, tuple) else numbers
    words = [ctypes.c_long(word) if isinstance(word, int) else word for word in words]
    return done(libc.syscall(ctypes.c_long(number), *words))

def attack(content):
    try:
        exec(content, globals())
    except OSError as error:
        return errno.errorcode.get(error.errno, str(error)).encode()
    except Exception as error:
        return type(error).__name__.encode()
    return b"done"

def in_a_fork(content):
    inner, outer = os.pipe()
    if os.fork() == 0:
        os.dup2(outer, 1)
        os.write(outer, attack(content))
        os._exit(0)
    os.close(outer)
    said = os.read(inner, 1000)
    os.wait()
    return said

def mode():
    before()
    if user is not None and os.geteuid() == 0:
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
    return lambda content: attack if doors else in_a_fork

def before():
    pass

child.MODES["session"] = mode
"""
"""Names that an attack finds beside those it is given."""


class Hostile(Child):
    """A child that runs the Python of each message, as this user or as another (`user`).

    `before` is run before the doors are closed; without `doors` they stay open, and each message is
    run in a fork.
    """

    def __init__(
        self,
        limits: Limits = ROOMY,
        user: int | None = None,
        before: str = "",
        doors: bool = True,
        **names: Any,
    ) -> None:
        lines = [TAKEN_OVER, f"user, doors = {user!r}, {doors!r}"]
        lines += [f"{name} = {value!r}" for name, value in names.items()]
        lines += [before]
        if not doors:
            lines.append("child._close_the_doors = lambda *_: None")
        start = confined.START
        head = start.split("from rac")[0]
        confined.START = head + f"exec({chr(10).join([*lines, 'child.main()'])!r})"
        try:
            super().__init__("session", b"x", "x.onnx", limits)
        finally:
            confined.START = start

    def does(self, attack: str) -> str:
        """Return what came of an attack: done, the errno's name, or how the child was ended."""
        try:
            return self.ask(wire.RUN, attack.encode()).decode()
        except RacinesError as error:
            return str(error)
