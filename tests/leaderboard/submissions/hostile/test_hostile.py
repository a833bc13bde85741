"""Children that have been taken over: what the kernel refuses them, as root and as another user.

The attacks are Python of the child's own process, which can do what code injected by a flaw in a
parser could. Each is tried with the doors closed and, where any machine allows it, with the doors
open, where it has to succeed: an attack that fails by itself would show nothing.
"""

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from tests.leaderboard.submissions.hostile.attacks import ALL, FREE
from tests.leaderboard.submissions.hostile.child import NOBODY, Hostile

REPOSITORY = Path(__file__).parents[4]
USERS = {"root": None, "nobody": NOBODY} if os.geteuid() == 0 else {"user": None}
REFUSED = {"thread": "RuntimeError", "more memory": "ValueError", "more files": "ValueError"}
"""What Python makes of the refusal, where that is no errno."""


@pytest.fixture(scope="module")
def places():
    """Give a folder that every user may write to, and a file and a link in it."""
    folder = Path(tempfile.mkdtemp(prefix="hostile-"))
    folder.chmod(0o777)
    (folder / "victim").write_text("whole")
    (folder / "victim").chmod(0o666)
    (folder / "empty").mkdir()
    (folder / "to-etc").symlink_to("/etc/passwd")
    yield folder
    shutil.rmtree(folder)


def names(folder: Path) -> dict[str, object]:
    victim, parent = str(folder / "victim"), os.getpid()
    places = {"folder": str(folder), "victim": victim, "repository": str(REPOSITORY)}
    return places | {"parent": parent, "group": os.getpgid(parent)}


def state(folder: Path) -> list[tuple[str, bytes]]:
    """Return what lies in a folder, with the content of its files."""
    files = sorted(folder.iterdir())
    return [(f.name, f.read_bytes() if f.is_file() else b"") for f in files]


@pytest.fixture(scope="module", params=USERS)
def child(request, places):
    child = Hostile(user=USERS[request.param], **names(places))
    yield child
    child.close()


@pytest.mark.parametrize("attack", ALL)
def test_is_refused(child, places, attack):
    before = state(places)
    assert child.does(ALL[attack]) == REFUSED.get(attack, "EPERM")
    assert state(places) == before


@pytest.fixture(scope="module")
def free():
    """Give a child whose doors stay open, and a folder of its own."""
    folder = Path(tempfile.mkdtemp(prefix="hostile-"))
    child = Hostile(doors=False, **names(folder))
    yield child, folder
    child.close()
    shutil.rmtree(folder)


@pytest.mark.parametrize("attack", FREE)
def test_would_succeed_with_the_doors_open(free, attack):
    child, folder = free
    for entry in folder.iterdir():
        entry.rmdir() if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    (folder / "victim").write_text("whole")
    (folder / "empty").mkdir()
    (folder / "to-etc").symlink_to("/etc/passwd")
    assert child.does(FREE[attack]) == "done"
