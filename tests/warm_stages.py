"""A pipeline's stages as forks of one process whose imports are done; `.ci/run` starts it.

    python -m tests.warm_stages FOLDER      # puts a program `racines` there, says so, and serves

    dvc ──> FOLDER/racines WORDS ──words, folder, environment, streams──> server ──fork──> main()
                     └────────────────────── exit code ────────────────────┘

The libraries take a stage longer to import than the smoke profile's work does. It ends when its
own input does, so that nothing outlives who started it. What a stage cannot tell from a fresh
process: that its imports were quick.
"""

import json
import os
import select
import socket
import sys
from importlib import import_module
from pathlib import Path

PROGRAM = """\
#!{python} -IS
import json, os, socket, sys

server = socket.socket(socket.AF_UNIX)
server.connect({path!r})
told = json.dumps([["racines", *sys.argv[1:]], os.getcwd(), dict(os.environ)])
socket.send_fds(server, [b"-"], [0, 1, 2])
server.sendall(told.encode())
server.shutdown(socket.SHUT_WR)
sys.exit(int(server.recv(16) or b"1"))  # without an answer the server is gone
"""


def run(folder: Path, preload: str) -> None:
    """Import a module and serve; in each fork, run the command."""
    import_module(preload)
    if serve(folder):
        from racines_leaderboard.cli.command import main

        main()


def serve(folder: Path) -> bool:
    """Answer each call of the program with a fork, one after another; say whether this is one."""
    path = folder / "socket"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        program = folder / "racines"
        program.write_text(PROGRAM.format(python=sys.executable, path=str(path)))
        program.chmod(0o755)
        print(program, flush=True)
        while listener in select.select([listener, sys.stdin], [], [])[0]:
            call, _ = listener.accept()
            with call:
                _, streams, _, _ = socket.recv_fds(call, 1, 3)
                if not (child := os.fork()):
                    become(call, streams)
                    return True
                for stream in streams:
                    os.close(stream)
                _, status = os.waitpid(child, 0)
                # A stage that a signal ended has a negative code, which no program can exit with.
                call.sendall(str(os.waitstatus_to_exitcode(status) & 0xFF).encode())
    return False


def become(call: socket.socket, streams: list[int]) -> None:
    """Take the words, folder, environment and streams of who called the program."""
    told = b"".join(iter(lambda: call.recv(1 << 16), b""))
    sys.argv, place, environment = json.loads(told)
    os.chdir(place)
    os.environ.clear()
    os.environ.update(environment)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)


if __name__ == "__main__":
    run(Path(sys.argv[1]), "tests.preloaded")
