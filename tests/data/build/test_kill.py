"""Builds that are killed with SIGKILL, whole process group and all, and run again."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from racines_data.build.dataset import DataConfig, build
from racines_data.files import sha256_file
from racines_data.load import load
from racines_data.manifest import read_manifest
from tests.data.build.test_build import files, staged
from tests.data.fake_source import FakeConfig, FakeSource
from tests.waiting import descendants, until, until_ended

pytestmark = [pytest.mark.slow, pytest.mark.thorough]
MAIN = {"frames": 100, "trajectories": 20}
MANY = {"frames": 72, "trajectories": 24, "sessions": 6, "seed": 5}
PROGRAM = """
import os, signal
from pathlib import Path
import racines_data.build.dataset, racines_data.build.writer
from racines_data.build import DataConfig, build
from tests.data.fake_source import FakeConfig, FakeSource

def die(*_):
    os.killpg(os.getpgrp(), signal.SIGKILL)

{fault}
build(
    FakeSource(FakeConfig(**{main!r})), Path({out!r}), DataConfig(workers={workers}),
    many=FakeSource(FakeConfig(**{many!r})),
)
"""
FAULTS = {
    "shards": """
real, made = racines_data.build.writer.write_parquet, []
def write(path, table):
    made.append(path)
    if len(made) > 5:
        path.write_bytes(b"half")
        die()
    real(path, table)
racines_data.build.writer.write_parquet = write
""",
    "store": """
racines_data.build.writer.write_store = lambda path, *_: (path.write_bytes(b"half"), die())
""",
    "manifest": "racines_data.build.writer._seal = die",
    "swap": """
real = os.replace
os.replace = lambda a, b: die() if Path(b) == Path({out!r}) else real(a, b)
""",
    "after the swap": """
real = os.replace
os.replace = lambda a, b: (real(a, b), die() if Path(b) == Path({out!r}) else None)
""",
}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("undisturbed") / "racines"
    many = FakeSource(FakeConfig(**MANY))
    build(FakeSource(FakeConfig(**MAIN)), root, DataConfig(workers=1), many=many)
    return root


class Work:
    """A build in a folder of its own, that can be killed and run again."""

    def __init__(self, folder: Path):
        self.folder, self.out, self.journal = folder, folder / "racines", folder / "journal"
        self.journal.mkdir()

    def sections(self, halts: dict[str, int]) -> tuple[dict, dict]:
        main, many = (
            {**section, "journal": str(self.journal), "halts_at": halts.get(config)}
            for config, section in (("frames", MAIN), ("multi_phantom", MANY))
        )
        return main, many

    def start(self, fault: str = "", workers: int = 1, **halts: int) -> subprocess.Popen:
        """Start a build; `frames` or `multi_phantom` is the unit at which that config halts."""
        main, many = self.sections(halts)
        fault = fault.replace("{out!r}", repr(str(self.out)))
        text = PROGRAM.format(fault=fault, main=main, many=many, out=str(self.out), workers=workers)
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
        return subprocess.Popen(
            [sys.executable, "-c", text], env=environment, start_new_session=True
        )

    def finish(self) -> dict:
        main, many = (FakeSource(FakeConfig(**section)) for section in self.sections({}))
        return build(main, self.out, DataConfig(workers=1), many=many)

    def made(self) -> int:
        return len(list(self.journal.iterdir()))


@pytest.fixture
def work(tmp_path: Path) -> Iterator[Work]:
    yield Work(tmp_path)


@pytest.mark.parametrize(
    ("config", "wanted", "halts_at"), [("frames", 4, 12), ("multi_phantom", 5, 18)]
)
def test_a_build_killed_half_way_goes_on(
    undisturbed: Path, work: Work, config: str, wanted: int, halts_at: int
):
    """It is killed somewhere between the unit that is waited for and the one at which it halts."""
    process = work.start(workers=2, **{config: halts_at})
    folder = work.folder
    until(lambda: sum(p.parts[-3] == config for p in staged(folder)) >= wanted, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not work.out.exists()
    kept, made = staged(folder), work.made()
    seals = {path.name: path.stat().st_mtime_ns for path in kept}
    assert wanted <= len(kept) < 44 and seals

    manifest = work.finish()
    assert work.made() - made == 44 - len(kept), "a finished unit is not made again"
    assert manifest["digest"] == read_manifest(undisturbed)["digest"]
    assert files(work.out) == files(undisturbed)
    assert staged(folder) == []


def test_workers_end_with_a_parent_that_was_killed(work: Work):
    process = work.start(workers=2, frames=4)
    until(lambda: len(staged(work.folder)) >= 4, process)
    workers = descendants(process)
    assert len(workers) >= 2
    process.kill()
    process.wait()
    until_ended(workers)


@pytest.mark.parametrize("place", FAULTS)
def test_a_build_killed_while_packaging_goes_on(undisturbed: Path, work: Work, place: str):
    before = build(FakeSource(FakeConfig(frames=20, seed=9)), work.out, DataConfig(workers=1))
    process = work.start(FAULTS[place])
    assert process.wait() == -signal.SIGKILL
    assert work.made() == 44, "it died after all units were made"
    shards = {
        path.name: (path.stat().st_mtime_ns, sha256_file(path))
        for path in work.folder.glob(".racines.staging-*/final-*/data/*/*.parquet")
        if path.parent.name != "trajectories"
    }
    if place == "shards":
        assert len(shards) == 5
    elif place != "after the swap":
        assert len(shards) >= 16
    if place == "swap":
        assert not work.out.exists(), "killed between the two renames"
    elif place != "after the swap":
        assert read_manifest(work.out) == before, "the old dataset stays until the new is whole"
        assert len(load(root=work.out, config="trajectories")) == 3

    manifest = work.finish()
    assert work.made() == 44
    assert manifest["digest"] == read_manifest(undisturbed)["digest"]
    assert files(work.out) == files(undisturbed)
    for name, seal in shards.items():
        (path,) = (p for p in work.out.glob(f"data/*/{name}") if sha256_file(p) == seal[1])
        assert path.stat().st_mtime_ns == seal[0], "a finished shard is not written again"
    left = {path.name for path in work.folder.iterdir()}
    assert left - {"cache"} == {"racines", "journal"}, "nothing is left behind"
